"""Scenes: repeatable from their seed, in view, and with the truth they state."""

from __future__ import annotations

import math

import numpy as np
import pytest

from core.geometry.se3 import invert
from tests.support.simulation.scenes import standard_scene, standard_target


@pytest.mark.parametrize("size", [(9, 6), (14, 10), (25, 18)])
@pytest.mark.parametrize("seed", range(12))
def test_standard_scenes_show_the_whole_board_from_the_front(size: tuple[int, int], seed: int) -> None:
    scene = standard_scene(standard_target(*size), seed)
    points = scene.points_px
    assert np.all(points > 4.0)
    assert np.all(points < np.array([scene.width_px, scene.height_px]) - 5.0)
    T_target_camera = invert(scene.T_camera_target)
    assert T_target_camera[2, 3] < 0.0  # z points into the board, so the camera is at negative z
    grid = points.reshape(size[1], size[0], 2)
    x, y = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    assert x[0] * y[1] - x[1] * y[0] > 0.0


@pytest.mark.parametrize("tilt_deg", [0.0, 15.0, 60.0])
def test_tilt_is_as_asked(tilt_deg: float) -> None:
    scene = standard_scene(standard_target(14, 10), 4, tilt=math.radians(tilt_deg))
    assert math.degrees(math.acos(min(1.0, scene.T_camera_target[2, 2]))) == pytest.approx(tilt_deg, abs=1e-6)


def test_scenes_follow_their_seed() -> None:
    target = standard_target(9, 6)
    np.testing.assert_array_equal(standard_scene(target, 8).points_px, standard_scene(target, 8).points_px)
    assert np.any(standard_scene(target, 8).points_px != standard_scene(target, 9).points_px)
