"""Refined corners against rendered truth: how far off, and how well stated."""

from __future__ import annotations

import math
from collections.abc import Callable

import cv2
import numpy as np
import pytest

from core.geometry.camera import Camera
from core.simulation import Light, Scene
from core.targets.subpixel import refinement
from core.targets.subpixel.refinement import refine_corners
from tests.support.cramer_rao import corner_bounds
from tests.support.simulation.renders import render, render_levels
from tests.support.simulation.scenes import standard_scene, standard_target
from tests.support.targets.refined_corners import normalised, refine_scene, rms, to_8_bit

Take = Callable[..., tuple[Scene, np.ndarray]]


@pytest.mark.parametrize(
    "size",
    [(9, 6), pytest.param((14, 10), marks=pytest.mark.slow), pytest.param((25, 18), marks=pytest.mark.slow)],
)
@pytest.mark.parametrize("tilt_deg", [pytest.param(0.0, marks=pytest.mark.slow), 30.0, 60.0])
def test_errors_are_as_stated(take: Take, size: tuple[int, int], tilt_deg: float) -> None:
    scene, image = take(*size, seed=2, tilt_deg=tilt_deg)
    refined = refine_scene(scene, image)
    assert refined.trusted.all()
    # of n independent corners the rms of the 2 n normalised errors scatters by 1 / (2 sqrt(n))
    assert rms(normalised(refined, scene)) == pytest.approx(
        1.0, abs=0.03 + 1.5 / math.sqrt(len(refined.trusted))
    )
    assert np.median(refined.blur_px) == pytest.approx(1.0, abs=0.03)


@pytest.mark.parametrize(
    "blur_px",
    [0.3, pytest.param(0.5, marks=pytest.mark.slow), pytest.param(1.0, marks=pytest.mark.slow), 2.0],
)
@pytest.mark.parametrize(
    "tilt_deg", [pytest.param(0.0, marks=pytest.mark.slow), 30.0, pytest.param(50.0, marks=pytest.mark.slow)]
)
def test_without_noise_next_to_nothing_is_left(take: Take, blur_px: float, tilt_deg: float) -> None:
    """What is left is the rounding to whole levels, and stated."""
    scene, image = take(9, 6, seed=4, tilt_deg=tilt_deg, blur_px=blur_px, noise_levels=0.0)
    refined = refine_scene(scene, image)
    error = (refined.points_px - scene.points_px)[refined.trusted]
    assert refined.trusted.sum() >= 50
    assert rms(error) < 0.003
    assert np.linalg.norm(error.mean(axis=0)) < 0.001
    assert np.median(refined.blur_px) == pytest.approx(blur_px, abs=0.02)


@pytest.mark.parametrize("roll_deg", [0.0, 180.0])
def test_pixel_aligned_boards_have_no_bias(roll_deg: float) -> None:
    """Every line of pixels cuts an edge at the same phase, so that nothing averages out."""
    camera = Camera(1000.0, 1000.0, 499.5, 399.5)
    target = standard_target(9, 6)
    for shift in (0.0, 0.25, 0.5):
        T = np.eye(4)
        T[:3, 3] = (-133.2 + shift * target.pitch_mm / 40.0, -83.25, target.pitch_mm * 1000.0 / 60.0)
        scene = Scene(target, camera, T, 1000, 800, blur_px=0.5, bit_depth=16)
        refined = refine_scene(scene, render(scene))
        assert refined.trusted.all()
        assert np.abs(refined.points_px - scene.points_px).max() < 0.001


@pytest.mark.parametrize(
    ("what", "change"),
    [
        ("gamma", lambda g: 255.0 * (g / 255.0) ** (1.0 / 2.2)),
        ("inverse gamma", lambda g: 255.0 * (g / 255.0) ** 2.2),
        ("ink spread", lambda g: 0.8 * g + 0.2 * cv2.erode(g.astype(np.float32), np.ones((3, 3), np.uint8))),
        ("motion", lambda g: cv2.blur(g.astype(np.float32), (3, 1))),
        ("reflex", lambda g: g + 40.0 * np.exp(-0.5 * ((np.arange(1000.0)[None] - 450.0) / 150.0) ** 2)),
    ],
)
def test_what_cameras_and_prints_do_moves_no_corner(
    take: Take, what: str, change: Callable[[np.ndarray], np.ndarray]
) -> None:
    scene, _ = take(9, 6, seed=1, tilt_deg=30.0, noise_levels=0.0, light=Light(gradient=(0.15, -0.1)))
    refined = refine_scene(scene, to_8_bit(change(np.clip(render_levels(scene), 0.0, 250.0))))
    error = refined.points_px - scene.points_px
    assert refined.trusted.mean() > 0.9
    assert rms(error[refined.trusted]) < 0.005, what
    assert np.linalg.norm(error[refined.trusted].mean(axis=0)) < 0.001


def test_steep_light_and_a_strong_lens(take: Take) -> None:
    light = Light(gradient=(0.5, -0.4), vignetting=0.5)
    scene, image = take(9, 6, seed=3, noise_levels=0.0, light=light)
    refined = refine_scene(scene, image)
    assert rms((refined.points_px - scene.points_px)[refined.trusted]) < 0.003
    lens = Camera(1000.0, 1000.0, 503.0, 396.0, k1=-0.3, k2=0.1)
    scene, image = take(14, 10, seed=3, noise_levels=0.0, camera=lens)
    refined = refine_scene(scene, image)
    assert rms((refined.points_px - scene.points_px)[refined.trusted]) < 0.003


def test_8_and_16_bit_agree(take: Take) -> None:
    scene, image = take(9, 6, seed=3)
    narrow, wide = (refine_scene(scene, p) for p in (image, image.astype(np.uint16) * 257))
    np.testing.assert_allclose(wide.points_px, narrow.points_px, atol=1e-9)
    np.testing.assert_allclose(wide.standard_uncertainty_px, narrow.standard_uncertainty_px, rtol=1e-6)
    np.testing.assert_allclose(wide.contrast, narrow.contrast * 257.0, rtol=1e-9)


def test_any_part_of_a_grid_serves(take: Take) -> None:
    scene, image = take(14, 10, seed=5)
    grid = scene.grid_points
    some = np.random.default_rng(0).permutation(len(grid))[:60]
    refined = refine_corners(
        image, grid.column[some] + 3, grid.row[some] + 4, grid.points_px[some], origin_is_black=False
    )
    assert refined.trusted.all()
    error = (refined.points_px - grid.points_px[some]) / refined.standard_uncertainty_px[:, None]
    assert rms(error) == pytest.approx(1.0, abs=0.2)


def test_a_shorter_reach_knows_less(take: Take, monkeypatch: pytest.MonkeyPatch) -> None:
    scene, image = take(9, 6, seed=2)
    half = refine_scene(scene, image)
    monkeypatch.setattr(refinement, "_LARGEST_REACH", 0.2)
    fifth = refine_scene(scene, image)
    ratio = fifth.standard_uncertainty_px / half.standard_uncertainty_px
    assert np.median(ratio) == pytest.approx(math.sqrt(0.5 / 0.2), rel=0.1)


@pytest.mark.parametrize(
    "views",
    [((1, 25.0),), pytest.param(((0, 10.0), (1, 25.0), (2, 40.0), (3, 50.0)), marks=pytest.mark.slow)],
    ids=["one", "all"],
)
def test_thresholded_images_are_measured_with_their_uncertainty(
    take: Take, views: tuple[tuple[int, float], ...]
) -> None:
    """Steps of whole pixels along the edges: no blur determines a place, and neighbours' errors are in unison."""
    errors, trusted = [], []
    for seed, tilt_deg in views:
        scene, image = take(14, 10, seed, tilt_deg, 180.0, blur_px=0.1, noise_levels=0.0, light=Light())
        refined = refine_scene(scene, np.where(image > 117, 210, 30).astype(np.uint8))
        errors.append(normalised(refined, scene))
        trusted.append(refined.trusted.mean())
    assert np.mean(trusted) > 0.8  # of lines along the pixels' rows next to nothing is known
    assert max(trusted) > 0.95
    assert 0.4 < rms(np.concatenate(errors)) < 1.2


def test_corners_at_the_images_border(take: Take) -> None:
    scene, image = take(9, 6, seed=2, tilt_deg=0.0, max_roll_deg=0.0)
    grid = scene.grid_points
    left = int(grid.points_px[0, 0]) - 1  # cut through the first column of corners
    refined = refine_corners(
        image[:, left:],
        grid.column,
        grid.row,
        grid.points_px - np.array([left, 0.0]),
        origin_is_black=True,
    )
    assert not refined.trusted[0]
    assert refined.trusted[grid.column > 0].all()
    error = (refined.points_px + np.array([left, 0.0]) - grid.points_px)[refined.trusted]
    assert rms(error / refined.standard_uncertainty_px[refined.trusted, None]) < 1.3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("noise_levels", "blur_px"), [(1.0, 0.5), (1.0, 2.0), (4.0, 1.0), (8.0, 0.5), (8.0, 2.0)]
)
def test_normalised_errors_have_unit_variance(take: Take, blur_px: float, noise_levels: float) -> None:
    errors = []
    for seed, tilt_deg in enumerate((0.0, 20.0, 40.0, 50.0)):
        scene, image = take(14, 10, seed, tilt_deg, 180.0, blur_px=blur_px, noise_levels=noise_levels)
        errors.append(normalised(refine_scene(scene, image), scene))
    error = np.concatenate(errors)
    # 2 n = 1120 errors: the rms scatters by .021
    assert rms(error) == pytest.approx(1.0, abs=0.07)
    assert np.abs(error).max() < 5.5


@pytest.mark.slow
@pytest.mark.parametrize("quality", [95, 80])
@pytest.mark.parametrize("noise_levels", [0.0, 1.0, 4.0])
def test_compressed_images_are_not_overrated(take: Take, quality: int, noise_levels: float) -> None:
    errors = []
    for seed, tilt_deg in enumerate((5.0, 30.0, 45.0, 55.0)):
        scene, image = take(9, 6, seed, tilt_deg, 180.0, noise_levels=noise_levels)
        _, file = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
        again = cv2.imdecode(file, cv2.IMREAD_GRAYSCALE)
        errors.append(normalised(refine_scene(scene, again), scene))
    assert 0.6 < rms(np.concatenate(errors)) < 1.25


@pytest.mark.slow
@pytest.mark.parametrize(("size", "scenes"), [((9, 6), 2), ((14, 10), 1), ((25, 18), 1)])
def test_standard_scenes_are_at_the_bound(size: tuple[int, int], scenes: int) -> None:
    squares, bounds = [], []
    for seed in range(100, 100 + scenes):
        scene = standard_scene(standard_target(*size), seed)
        refined = refine_scene(scene, render(scene))
        assert refined.trusted.mean() > 0.99
        error = refined.points_px - scene.points_px
        squares.append(np.mean(error[refined.trusted] ** 2))
        bounds.append(np.mean(corner_bounds(scene).standard_deviation_px[refined.trusted] ** 2))
        # noise alone gives the mean of n corners an error of its own
        mean_noise = math.sqrt(bounds[-1] / len(error))
        assert np.abs(error[refined.trusted].mean(axis=0)).max() < 0.001 + 3.0 * mean_noise
    corners = scenes * size[0] * size[1]
    assert math.sqrt(np.mean(squares) / np.mean(bounds)) < 1.05 + 2.0 / math.sqrt(4.0 * corners)
