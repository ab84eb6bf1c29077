"""Corners that are not believed: what is dead, covered, mirrored, bent, off by a square, or no corner at all."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from core.errors import DegenerateGeometry
from core.simulation import Light, Scene
from core.targets.subpixel.refinement import refine_corners
from tests.support.simulation.renders import render_levels
from tests.support.targets.refined_corners import normalised, refine_scene, rms, to_8_bit

Take = Callable[..., tuple[Scene, np.ndarray]]


@pytest.mark.parametrize("share", [0.0005, 0.005])
def test_dead_and_hot_pixels_are_rejected(take: Take, share: float) -> None:
    scene, image = take(9, 6, seed=2)
    rng = np.random.default_rng(3)
    stray = image.copy()
    struck = rng.random(image.shape) < share
    stray[struck] = rng.choice([0, 255], struck.sum())
    clean, struck_by = refine_scene(scene, image), refine_scene(scene, stray)
    assert struck_by.trusted.all()
    assert rms(struck_by.points_px - scene.points_px) < 1.1 * rms(clean.points_px - scene.points_px) + 1e-3


def test_wrong_colours_are_not_believed(take: Take) -> None:
    scene, image = take(9, 6, seed=2)
    grid = scene.grid_points
    refined = refine_corners(image, grid.column, grid.row, grid.points_px, origin_is_black=False)
    assert not refined.trusted.any()
    assert np.isinf(refined.standard_uncertainty_px).all()
    np.testing.assert_array_equal(refined.points_px, grid.points_px)


def test_covered_corners_are_not_believed_and_spoil_no_other(take: Take) -> None:
    scene, image = take(9, 6, seed=2, tilt_deg=10.0)
    points = scene.points_px
    covered = image.copy()
    for k in (12, 40):  # blots over the corner itself
        cv2.circle(covered, tuple(np.rint(points[k]).astype(int).tolist()), 9, 128, -1, cv2.LINE_AA)
    a, b = (np.rint(points[k] + (5.0, 3.0)).astype(int).tolist() for k in (18, 26))
    cv2.line(covered, a, b, 60, 5, cv2.LINE_AA)  # a cable along a row of corners, and over them
    refined = refine_scene(scene, covered)
    assert not refined.trusted[[12, 40]].any()
    error = np.linalg.norm(refined.points_px - points, axis=1)[refined.trusted]
    assert np.all(error < 6.0 * refined.standard_uncertainty_px[refined.trusted])
    away = np.delete(np.arange(54), [12, 40, *range(18, 27)])
    assert refined.trusted[away].mean() > 0.9


def test_noise_behind_a_smooth_cover_is_no_corner(take: Take) -> None:
    """Noise has some place that suits the model, and does so well enough in one of a dozen to look like a corner."""
    scene, image = take(9, 6, seed=2, tilt_deg=10.0)
    points = scene.points_px
    hidden = [10, 16, 37, 43]
    half = int(0.8 * np.linalg.norm(points[1] - points[0]))
    levels = 100.0 + 0.12 * (image - 128.0)
    for u, v in np.rint(points[hidden]).astype(int):
        levels[v - half : v + half, u - half : u + half] = 90.0
    away = np.linalg.norm(points[:, None] - points[hidden], axis=2).min(axis=1) > 1.9 * half
    trusted = np.array([refine_scene(scene, to_8_bit(levels, 15.0, seed)).trusted for seed in range(12)])
    assert not trusted[:, hidden].any()
    assert trusted[:, away].mean() > 0.8


@pytest.mark.parametrize(
    ("peak_levels", "seeds"),
    [
        (200.0, range(2)),
        *(pytest.param(peak, range(6), marks=pytest.mark.slow) for peak in (80.0, 200.0, 500.0)),
    ],
)
def test_lamps_mirrored_in_the_board_are_in_the_uncertainty(
    take: Take, peak_levels: float, seeds: range
) -> None:
    """Broad light added, cut off at 255 where it is strong: its slopes are known by the corners alone, and badly."""
    errors, trusted, size = [], 0, 0
    for seed in seeds:
        scene, _ = take(14, 10, seed, 20.0 + 5.0 * seed, 180.0, light=Light())
        points, rng = scene.points_px, np.random.default_rng(seed)
        at, spread = (
            points[rng.integers(len(points))],
            rng.uniform(0.08, 0.3, 2) * np.ptp(points, axis=0).max(),
        )
        u, v = (np.exp(-0.5 * ((np.arange(n) - at[k]) / spread[k]) ** 2) for k, n in enumerate((1000, 800)))
        refined = refine_scene(
            scene, to_8_bit(render_levels(scene) + peak_levels * np.outer(v, u), 4.0, seed)
        )
        errors.append(normalised(refined, scene))
        trusted, size = trusted + int(refined.trusted.sum()), size + len(points)
    error = np.concatenate(errors)
    assert trusted > 0.6 * size  # the others are burnt out
    assert rms(error) < 2.2  # at 200 levels 4.5, were the slopes taken for certain
    assert np.mean(np.abs(error) > 6.0) < 0.04


@pytest.mark.parametrize(
    "seed", [2, pytest.param(3, marks=pytest.mark.slow), pytest.param(5, marks=pytest.mark.slow)]
)
def test_bends_of_an_outline_are_no_crossings(take: Take, seed: int) -> None:
    """Where one of the four squares is missing, the one opposite still has its corner there."""
    scene, image = take(9, 6, seed=seed, tilt_deg=25.0, noise_levels=1.0)
    points = scene.points_px.reshape(6, 9, 2)
    black = np.rint(points[[2, 2, 3, 3], [4, 5, 5, 4]]).astype(np.int32)
    covered = cv2.dilate(cv2.fillConvexPoly(np.zeros_like(image), black, 1), np.ones((7, 7), np.uint8))
    u, v = np.rint(points[2:4, 5:7].mean(axis=(0, 1))).astype(int)  # in the white one next to it
    refined = refine_scene(scene, np.where(covered == 1, image[v, u], image))
    trusted = refined.trusted.reshape(6, 9)
    assert not trusted[2:4, 4:6].any()
    assert trusted.sum() == 50


def test_the_edge_of_a_reflex_is_noticed(take: Take) -> None:
    scene, image = take(9, 6, seed=2, tilt_deg=10.0)
    points = scene.points_px
    u = 0.5 * (points[3, 0] + points[4, 0]) - 20.0
    lit = image.astype(np.float64)
    lit[:, int(u) :] = 0.4 * lit[:, int(u) :] + 140.0
    refined = refine_scene(scene, to_8_bit(lit))
    error = np.linalg.norm(refined.points_px - points, axis=1)[refined.trusted]
    assert np.all(error < 6.0 * refined.standard_uncertainty_px[refined.trusted])
    assert refined.trusted.mean() > 0.6


def test_far_starts_and_missing_ones(take: Take) -> None:
    scene, image = take(9, 6, seed=2)
    grid = scene.grid_points
    start = grid.points_px + np.random.default_rng(1).uniform(-1.2, 1.2, grid.points_px.shape)
    start[7] += 15.0
    start[20] = np.nan
    refined = refine_corners(image, grid.column, grid.row, start, origin_is_black=True)
    assert not refined.trusted[[7, 20]].any()
    others = np.delete(np.arange(54), [7, 20])
    assert refined.trusted[others].all()
    assert rms(normalised(refined, scene)) == pytest.approx(1.0, abs=0.25)


def test_no_corner_takes_its_neighbours_place(take: Take) -> None:
    """Small squares: a start well on the way to the diagonal neighbour, of the same colours, leads to that."""
    scene, image = take(9, 6, seed=2, tilt_deg=0.0)
    size = 7.0 / float(np.min(np.linalg.norm(np.diff(scene.points_px.reshape(6, 9, 2), axis=1), axis=2)))
    small = cv2.resize(image, None, fx=size, fy=size, interpolation=cv2.INTER_AREA)
    points = (scene.points_px + 0.5) * [
        small.shape[1] / image.shape[1],
        small.shape[0] / image.shape[0],
    ] - 0.5
    grid = scene.grid_points
    for share in (0.5, 0.7, 0.8, 0.9):
        start = points.copy()
        start[22] += share * (points[32] - points[22])
        refined = refine_corners(small, grid.column, grid.row, start, origin_is_black=True)
        error = np.linalg.norm(refined.points_px - points, axis=1)
        assert refined.trusted.sum() > 40
        assert error[refined.trusted].max() < 0.5


def test_too_few_points_are_refused(take: Take) -> None:
    scene, image = take(9, 6, seed=2)
    grid = scene.grid_points
    for chosen in (np.arange(3), np.arange(9)):  # three; a line
        with pytest.raises(DegenerateGeometry):
            refine_corners(
                image,
                grid.column[chosen],
                grid.row[chosen],
                grid.points_px[chosen],
                origin_is_black=True,
            )


@pytest.mark.parametrize("seed", range(6))
def test_images_without_corners_give_none(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape = (int(rng.integers(20, 200)), int(rng.integers(20, 200)))
    image = rng.integers(0, 256, shape, dtype=np.uint8) if seed % 2 else np.full(shape, 90, np.uint8)
    row, column = (a.ravel() for a in np.mgrid[0:5, 0:6])
    start = np.stack([column, row], axis=1) * rng.uniform(2.0, 40.0) + rng.uniform(-30.0, 30.0, 2)
    refined = refine_corners(image, column, row, start, origin_is_black=True)
    assert refined.trusted.sum() <= 3
    assert np.isfinite(refined.points_px).all()
