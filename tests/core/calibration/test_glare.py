"""A broad reflection on the target: light that bends under corners costs points; the pose keeps its uncertainty."""

from __future__ import annotations

import numpy as np
import pytest

from core import TargetSpec, calibrate_points
from core.geometry.se3 import invert
from core.targets import detect
from tests.support.simulation.renders import render_levels
from tests.support.simulation.scenes import standard_scene

TARGETS = {
    "chessboard": TargetSpec("chessboard", 14, 10, 21.4),
    "charuco": TargetSpec("charuco", 14, 10, 21.4, 16.0, "DICT_5X5_100"),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", TARGETS)
@pytest.mark.parametrize("seed", [50, 51, 52])
@pytest.mark.parametrize(("levels", "share"), [(300.0, 0.10), (150.0, 0.20)])
def test_glare_costs_points_not_the_pose(kind: str, seed: int, levels: float, share: float) -> None:
    """`share` is the reflection's standard deviation over the board's width; its middle saturates, its flanks bend."""
    scene = standard_scene(TARGETS[kind], seed, tilt=0.6)
    image = render_levels(scene)
    rng = np.random.default_rng([seed, 7])
    middle = scene.points_px[rng.integers(len(scene.points_px))]
    width = share * np.ptp(scene.points_px[:, 0])
    v, u = np.mgrid[0 : image.shape[0], 0 : image.shape[1]]
    image += levels * np.exp(-((u - middle[0]) ** 2 + (v - middle[1]) ** 2) / (2.0 * width**2))
    image += 4.0 * rng.standard_normal(image.shape)
    found = calibrate_points(detect(np.clip(np.rint(image), 0, 255).astype(np.uint8), scene.target))
    error = found.pose.position_mm - invert(scene.T_camera_target)[:3, 3]
    squares = error @ np.linalg.solve(found.pose.covariance[:3, :3], error)
    assert squares < 21.1  # chi-square of 3 degrees of freedom at 1e-4
