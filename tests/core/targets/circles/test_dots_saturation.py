"""Boards of dots whose white is cut off at the camera's largest level, under light that falls off to the sides."""

from __future__ import annotations

import numpy as np
import pytest

from core.geometry.camera import Camera
from core.simulation import Light, Scene, random_pose
from core.targets import TargetSpec, detect
from core.targets.circles.centres.ellipse_fit import FittedDots
from core.targets.circles.saturation import unstated_uncertainty
from tests.support.simulation.renders import render

CAMERA = Camera(700.0, 700.0, 322.0, 238.0, k1=-0.1)
SIZE = (640, 480)
SYMMETRIC = TargetSpec("circles", 9, 7, 25.0)
ASYMMETRIC = TargetSpec("asymmetric_circles", 4, 11, 20.0)


def scene_of(target: TargetSpec, seed: int, light: Light) -> Scene:
    T = random_pose(target, CAMERA, SIZE, 0.6, 0.6, np.random.default_rng(seed))
    return Scene(target, CAMERA, T, *SIZE, blur_px=0.7, noise_levels=2.0, light=light, seed=seed)


@pytest.mark.parametrize("target", [SYMMETRIC, ASYMMETRIC], ids=["circles", "asymmetric"])
@pytest.mark.parametrize("white_level", [330.0, 420.0])
@pytest.mark.parametrize("vignetting", [0.0, 0.5])
def test_errors_are_as_stated_where_white_is_cut_off(
    target: TargetSpec, white_level: float, vignetting: float
) -> None:
    light = Light(black_level=25.0, white_level=white_level, vignetting=vignetting)
    z = []
    for seed in range(50, 58):
        scene = scene_of(target, seed, light)
        found = detect(render(scene), target)
        truth = scene.points_px.reshape(target.rows, target.columns, 2)
        error = found.points_px - truth[found.row, found.column]
        z.append(error / found.standard_uncertainty_px[:, None])
    assert 0.7 < np.sqrt(np.mean(np.concatenate(z) ** 2)) < 1.25


def grid(grown_px: np.ndarray, *, clipped: bool = True) -> np.ndarray:
    """What saturation adds to dots of 10 px on a square grid of 40 px, whose edges have moved outward."""
    v, u = (40.0 * values.ravel() for values in np.mgrid[0:7, 0:9])
    r = 10.0 + grown_px.ravel()
    shapes = np.column_stack([u, v, r**-2.0, np.zeros(63), r**-2.0, np.full(63, 0.8)])
    fitted = FittedDots(shapes, np.ones(63), np.zeros((63, 2, 2)), np.ones(63), np.ones(63, dtype=np.bool_))
    return unstated_uncertainty(fitted, r / 40.0, np.zeros(63), np.full(63, clipped), np.full(63, 0.005))


def test_edges_that_move_more_on_one_side_move_the_centre() -> None:
    """A dot of 10 px of which δ grows by .002 per px is displaced by .02 px."""
    _, u = np.mgrid[0:7, 0:9] * 40.0
    np.testing.assert_allclose(grid(0.002 * (u - u.mean()))[30:33], 0.02, rtol=0.1)
    np.testing.assert_allclose(grid(np.full((7, 9), 0.3)), 0.0, atol=1e-9)
    np.testing.assert_array_equal(grid(0.002 * u, clipped=False), 0.0)


def test_scatter_about_the_map_is_stated_where_it_is_beyond_chance() -> None:
    rng = np.random.default_rng(2)
    shapes = np.tile([0.0, 0.0, 0.01, 0.0, 0.01, 0.8], (100, 1))
    fitted = FittedDots(
        shapes, np.ones(100), np.zeros((100, 2, 2)), np.ones(100), np.ones(100, dtype=np.bool_)
    )
    radius, clipped = np.full(100, 0.25), np.zeros(100, dtype=np.bool_)
    unit = [np.hypot(*rng.normal(0.0, 1.0, (2, 100))) for _ in range(200)]
    as_stated = [
        unstated_uncertainty(fitted, radius, 0.03 * off, clipped, np.full(100, 0.03)) for off in unit
    ]
    assert np.mean([found.max() > 0.0 for found in as_stated]) < 0.02
    larger = [unstated_uncertainty(fitted, radius, 0.15 * off, clipped, np.full(100, 0.03)) for off in unit]
    assert np.median(larger) == pytest.approx(np.sqrt(0.15**2 - 0.03**2), rel=0.1)


def test_rejected_dots_do_not_silence_the_scatter_of_the_others() -> None:
    """Of 44 dots before a bowed sheet five are rejected: the others scatter as before."""
    ones = np.ones(44)
    fitted = FittedDots(
        np.tile([0.0, 0.0, 0.01, 0.0, 0.01, 0.8], (44, 1)), ones, np.zeros((44, 2, 2)), ones, ones > 0.0
    )
    off = np.hypot(*np.random.default_rng(2).normal(0.0, 0.15, (2, 44)))
    left = FittedDots(fitted.shapes, ones, fitted.covariance, ones, np.arange(44) >= 5)
    for dots in (fitted, left):
        added = unstated_uncertainty(dots, 0.25 * ones, off, ones < 0.0, 0.03 * ones)
        assert np.median(added) == pytest.approx(0.15, rel=0.3)
