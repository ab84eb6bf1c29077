"""The map of a plane by a lens with radial distortion, and the dots' centres that rest on it."""

from __future__ import annotations

import numpy as np
import pytest

from core.geometry import find_homography, map_in_front
from core.geometry.camera import Camera, project
from core.geometry.se3 import so3_exp, transform_points
from core.simulation import Scene
from core.targets import TargetSpec, detect
from core.targets.circles.centres.lens_map import equations, fit_lens_map
from tests.support.simulation.renders import render

WIDE = Camera(480.0, 480.0, 322.0, 238.0, k1=-0.35, k2=0.1)
SIZE = (640, 480)
MIDDLE = np.array([319.5, 239.5])
SYMMETRIC = TargetSpec("circles", 9, 7, 25.0)
ASYMMETRIC = TargetSpec("asymmetric_circles", 4, 11, 20.0)
NINE = TargetSpec("circles", 3, 3, 75.0)


def scene_of(target: TargetSpec, seed: int, margin_px: float = 14.0, **changes: float) -> Scene:
    """A board that fills the image, tilted by 30 to 45 degrees."""
    rng = np.random.default_rng(seed)
    low, high = target.points_target().min(axis=0), target.points_target().max(axis=0)
    about = rng.uniform(0.0, 2.0 * np.pi)
    tilt = rng.uniform(0.5, 0.8) * np.array([np.cos(about), np.sin(about), 0.0])
    R = so3_exp(tilt) @ so3_exp(np.array([0.0, 0.0, rng.uniform(-0.4, 0.4)]))
    T = np.eye(4)
    T[:3, :3] = R
    for away in np.linspace(0.6, 3.0, 100) * float((high - low).max()):
        T[:3, 3] = np.array([0.0, 0.0, away]) - R @ (0.5 * (low + high))
        scene = Scene(target, WIDE, T, *SIZE, seed=seed, **changes)  # type: ignore[arg-type]
        margin = np.abs(scene.points_px - MIDDLE) - MIDDLE
        if margin.max() < -margin_px:
            break
    return scene


def test_the_normal_equations_are_those_of_the_map() -> None:
    rng = np.random.default_rng(3)
    x, y = rng.normal(size=(2, 30, 2))
    p = np.array([1.1, 0.1, 0.2, -0.1, 0.9, 0.1, 0.08, -0.05, 0.1, -0.2, -0.03, 0.004, -0.0005])

    def mapped(p: np.ndarray) -> np.ndarray:
        q = np.column_stack([x, np.ones(len(x))]) @ np.append(p[:8], 1.0).reshape(3, 3).T
        d = q[:, :2] / q[:, 2:] - p[8:10]
        square = np.sum(d**2, axis=1, keepdims=True)
        return np.ravel(p[8:10] + d * (1.0 + p[10] * square + p[11] * square**2 + p[12] * square**3))

    h = 1e-6
    J = np.stack([(mapped(p + e) - mapped(p - e)) / (2.0 * h) for e in h * np.eye(13)], axis=1)
    rest = y.ravel() - mapped(p)
    N, g, squares = equations(p, x, y)
    np.testing.assert_allclose(N, J.T @ J, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(g, J.T @ rest, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(squares, rest @ rest, rtol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_what_a_lens_bends_is_recovered_between_the_points_too(seed: int) -> None:
    """Less that, points of a plane are where a homography has them."""
    scene = scene_of(SYMMETRIC, seed)
    plane = SYMMETRIC.points_target()[:, :2] / SYMMETRIC.pitch_mm
    lens = fit_lens_map(plane, scene.points_px, MIDDLE)
    around = plane + 0.25
    places = np.column_stack([around, np.zeros(len(around))]) * SYMMETRIC.pitch_mm
    points = project(transform_points(scene.T_camera_target, places), WIDE)

    def off(displaced: np.ndarray) -> float:
        H = find_homography(around, displaced)
        assert H is not None
        return float(np.abs(map_in_front(H, around) - displaced).max())

    assert off(points) > 1.0
    assert off(points - lens.bend(around)) < 0.01


def test_slopes_are_the_derivatives() -> None:
    scene = scene_of(ASYMMETRIC, 7)
    plane = ASYMMETRIC.points_target()[:, :2] / ASYMMETRIC.pitch_mm
    lens = fit_lens_map(plane, scene.points_px, MIDDLE)
    step = 1e-5
    for axis in np.eye(2):
        difference = lens.bend(plane + step * axis) - lens.bend(plane - step * axis)
        np.testing.assert_allclose(
            lens.bend_slopes(plane) @ axis, difference / (2.0 * step), rtol=1e-5, atol=1e-5
        )


@pytest.mark.parametrize("seed", range(8, 12))
def test_nine_points_determine_a_lens_with_what_is_known_of_lenses(seed: int) -> None:
    """Between them, too: thirteen parameters stand against eighteen coordinates."""
    scene = scene_of(NINE, seed)
    plane = NINE.points_target()[:, :2] / NINE.pitch_mm
    lens = fit_lens_map(plane, scene.points_px, MIDDLE)
    between = 1.0 + 0.7 * (plane - 1.0)
    places = np.column_stack([between, np.zeros(len(between))]) * NINE.pitch_mm
    points = project(transform_points(scene.T_camera_target, places), WIDE)
    straight = scene.points_px - lens.bend(plane)
    H = find_homography(plane, straight)
    assert H is not None
    assert np.abs(map_in_front(H, between) + lens.bend(between) - points).max() < 0.05


@pytest.mark.parametrize("target", [SYMMETRIC, ASYMMETRIC], ids=["circles", "asymmetric"])
@pytest.mark.parametrize("seed", range(10, 16))
def test_dots_at_the_grids_ends_are_in_place_under_strong_distortion(target: TargetSpec, seed: int) -> None:
    scene = scene_of(target, seed, noise_levels=2.0, blur_px=0.7)
    found = detect(render(scene), target)
    truth = scene.points_px.reshape(target.rows, target.columns, 2)
    error = found.points_px - truth[found.row, found.column]
    z = error / found.standard_uncertainty_px[:, None]
    assert np.sqrt(np.mean(z**2)) < 1.3
    assert np.abs(z).max() < 5.0


@pytest.mark.parametrize("target", [NINE, TargetSpec("circles", 4, 3, 65.0)], ids=["9 dots", "12 dots"])
def test_dots_of_small_boards_are_in_place_under_strong_distortion(target: TargetSpec) -> None:
    """They are large, and their images' centres pixels away from the images of their centres."""
    z = []
    for seed in range(20, 28):
        scene = scene_of(target, seed, 130.0, noise_levels=2.0, blur_px=0.7)
        found = detect(render(scene), target)
        truth = scene.points_px.reshape(target.rows, target.columns, 2)
        turned = [truth, truth[::-1, ::-1]]
        if target.rows == target.columns:
            turned += [t.transpose(1, 0, 2)[:, ::-1] for t in turned]
        errors = [found.points_px - t[found.row, found.column] for t in turned]
        error = min(errors, key=lambda e: float(np.abs(e).mean()))
        assert np.abs(error).max() < 0.03
        z.append(error / found.standard_uncertainty_px[:, None])
    assert np.sqrt(np.mean(np.concatenate(z) ** 2)) < 1.5
