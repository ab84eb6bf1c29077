"""Boards of dots across which a shadow's edge runs, or of which a dot is half hidden: what that makes of dots costs
these, and neither the size of the board nor the others."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from core.errors import TargetMismatch
from core.geometry.camera import Camera
from core.simulation import Scene, random_pose
from core.targets import TargetSpec, detect
from core.targets.circles.board_ends import without_stray_lines
from core.targets.circles.lattice import DotLattice
from tests.support.image.dot_sites import sites_of
from tests.support.image.view_flaws import trail
from tests.support.simulation.renders import render

CAMERA = Camera(700.0, 700.0, 321.0, 238.0, k1=-0.1)
SIZE = (640, 480)
SYMMETRIC = TargetSpec("circles", 9, 7, 25.0)
ASYMMETRIC = TargetSpec("asymmetric_circles", 4, 11, 20.0)
NOISE = 2.0


def scene_of(target: TargetSpec, seed: int) -> Scene:
    T = random_pose(target, CAMERA, SIZE, 0.5, 0.6, np.random.default_rng(seed))
    return Scene(target, CAMERA, T, *SIZE, clutter=0.0, seed=seed, background_seed=seed)


def shaded(image: np.ndarray, scene: Scene, edge_px: float, shade: float, seed: int) -> np.ndarray:
    """The image with a shadow on one side of a line near the board's middle, at `shade` of the light there.

    Its noise is the same in the light and in the shade.
    """
    rng = np.random.default_rng(seed)
    angle = rng.uniform(0.0, 2.0 * np.pi)
    u0, v0 = scene.points_px.mean(axis=0) + rng.uniform(-15.0, 15.0, 2)
    v, u = np.mgrid[0 : image.shape[0], 0 : image.shape[1]]
    away = (u - u0) * np.cos(angle) + (v - v0) * np.sin(angle)
    light = shade + (1.0 - shade) * 0.5 * (1.0 + np.tanh(0.5 * away / edge_px))
    return np.clip(np.rint(image * light + rng.normal(0.0, NOISE, image.shape)), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("target", [SYMMETRIC, ASYMMETRIC], ids=["circles", "asymmetric"])
@pytest.mark.parametrize(("edge_px", "shade"), [(2.0, 0.6), (2.0, 0.45), (0.7, 0.15)])
def test_dots_on_both_sides_of_a_shadow_are_measured(
    target: TargetSpec, edge_px: float, shade: float
) -> None:
    for seed in range(20, 26):
        scene = scene_of(target, seed)
        found = detect(shaded(render(scene), scene, edge_px, shade, seed), target)
        assert len(found) >= 0.7 * target.size
        truth = scene.points_px.reshape(target.rows, target.columns, 2)
        if found.labelling == "up_to_symmetry":
            turned = truth[::-1, ::-1]
            if np.hypot(*(found.points_px[0] - truth[found.row[0], found.column[0]])) > 5.0:
                truth = turned
        z = (found.points_px - truth[found.row, found.column]) / found.standard_uncertainty_px[:, None]
        assert np.sqrt(np.mean(z**2)) < 1.5
        assert np.median(np.abs(z)) < 0.95  # of a normal distribution: .67


def test_a_larger_dot_beyond_a_shadows_edge_is_the_origin() -> None:
    """The edge cuts the lattice in two; the origin's dot comes with its part."""
    target = TargetSpec("circles", 8, 8, 25.0)
    for seed in range(20, 28):
        scene = replace(scene_of(target, seed), origin_dot=1.6)
        found = detect(shaded(render(scene), scene, 0.7, 0.3, seed), target)
        assert found.labelling == "absolute", seed
        truth = scene.points_px.reshape(8, 8, 2)[found.row, found.column]
        assert np.hypot(*(found.points_px - truth).T).max() < 1.0


@pytest.mark.parametrize("direction_deg", [0.0, 90.0])
def test_a_larger_dot_in_motion_is_the_origin(direction_deg: float) -> None:
    """Motion makes the other dots more slender than a blot next to one makes it; the larger dot less so."""
    target = TargetSpec("circles", 8, 8, 25.0)
    for seed in range(20, 24):
        scene = replace(scene_of(target, seed), origin_dot=1.7)
        noise = np.random.default_rng(seed).normal(0.0, NOISE, SIZE[::-1])
        blurred = cv2.filter2D(
            render(scene).astype(np.float32), -1, trail(0.3 * pitch_px(scene), math.radians(direction_deg))
        )
        found = detect(np.clip(np.rint(blurred + noise), 0, 255).astype(np.uint8), target)
        assert found.labelling == "absolute", seed
        truth = scene.points_px.reshape(8, 8, 2)[found.row, found.column]
        assert np.hypot(*(found.points_px - truth).T).max() < 1.0


def pitch_px(scene: Scene) -> float:
    """How far neighbouring dots usually are apart in the image."""
    grid = scene.points_px.reshape(scene.target.rows, scene.target.columns, 2)
    return float(np.median(np.hypot(*np.diff(grid, axis=1).reshape(-1, 2).T)))


def on_plane(target: TargetSpec, seen: np.ndarray) -> tuple[DotLattice, np.ndarray]:
    """The lattice of those of a target's dots that are seen, and their places in an image of 40 px per line."""
    row, column = np.nonzero(seen)
    sites = sites_of(target, column, row)
    places = sites
    if target.kind == "asymmetric_circles":  # the lattice's steps go along the diagonals
        places = np.stack([(sites[:, 0] + sites[:, 1]) // 2, (sites[:, 1] - sites[:, 0]) // 2], axis=1)
    return DotLattice(np.arange(len(sites)), places), 40.0 * sites + 100.0


@pytest.mark.parametrize("target", [SYMMETRIC, ASYMMETRIC], ids=["circles", "asymmetric"])
def test_one_patch_makes_no_line(target: TargetSpec) -> None:
    larger = TargetSpec(target.kind, target.columns, target.rows + 1, target.pitch_mm)
    seen = np.ones((larger.rows, larger.columns), dtype=np.bool_)
    seen[-1] = False
    seen[-1, 1] = True
    lattice, points = on_plane(larger, seen)
    kept = without_stray_lines(lattice, points, (1000, 1000), target)
    assert len(kept.dots) == target.size
    assert len(lattice.dots) - 1 not in kept.dots


def test_two_of_seven_dots_are_no_line_unless_the_others_are_out_of_the_image() -> None:
    seen = np.ones((8, 7), dtype=np.bool_)
    seen[-1, 2:] = False
    target = TargetSpec("circles", 7, 7, 25.0)
    lattice, points = on_plane(TargetSpec("circles", 7, 8, 25.0), seen)
    assert len(without_stray_lines(lattice, points, (1000, 1000), target).dots) == 49
    angle = 0.5
    turned = points @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    turned += 250.0
    height = int(turned[-1, 1]) + 25  # the last row goes down and out of the image from its second dot on
    inside = turned[:, 1] < height
    lattice = DotLattice(lattice.dots[inside], lattice.places[inside])
    kept = without_stray_lines(lattice, turned[inside], (height, 2000), target)
    assert len(kept.dots) == len(lattice.dots)


def test_three_dots_of_a_line_are_still_named() -> None:
    """A larger board of which one line is mostly hidden is not one of the requested size."""
    scene = scene_of(SYMMETRIC, 31)
    image = np.array(render(scene))
    for u, v in scene.points_px.reshape(7, 9, 2)[-1, 3:].round().astype(int):
        image[v - 14 : v + 15, u - 14 : u + 15] = 220
    with pytest.raises(TargetMismatch):
        detect(image, TargetSpec("circles", 9, 6, 25.0))


@pytest.mark.parametrize(("columns", "rows"), [(5, 4), (7, 5)])
def test_a_dot_that_is_half_hidden_is_nothing_to_the_others(columns: int, rows: int) -> None:
    """It is far from an ellipse, and would pull the map by which all centres are corrected."""
    target, camera, size = (
        TargetSpec("circles", columns, rows, 30.0),
        Camera(700.0, 700.0, 322.0, 238.0, -0.1),
        (640, 480),
    )
    for seed in range(8):
        rng = np.random.default_rng(seed)
        T = random_pose(target, camera, size, 0.6, 0.6, np.random.default_rng(1000 + seed))
        scene = Scene(target, camera, T, *size, blur_px=0.7, noise_levels=1.0, seed=seed)
        image, places = render(scene).copy(), scene.points_px.reshape(rows, columns, 2)
        i, j = int(rng.integers(0, rows)), int(rng.integers(0, columns - 1))
        u, v = places[i, j]
        reach = 0.25 * float(np.linalg.norm(places[i, j + 1] - places[i, j]))
        cover = (int(u + 0.6 * reach), int(v - 1.3 * reach)), (int(u + 1.3 * reach), int(v + 1.3 * reach))
        cv2.rectangle(image, *cover, 120, -1)
        found = detect(image, target)
        error = found.points_px - places[found.row, found.column]
        if np.median(np.abs(error)) > 3.0:  # turned by half
            error = found.points_px - places[rows - 1 - found.row, columns - 1 - found.column]
        z = error / found.standard_uncertainty_px[:, None]
        assert 0.7 < float(np.sqrt(np.mean(z**2))) < 1.35, seed  # of 36 figures at least
