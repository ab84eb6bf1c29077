"""Drawn joint angles bring the camera before the grid, within the joints' limits."""

from __future__ import annotations

import numpy as np
import pytest

from core.camera import Camera
from core.simulation.arm import KR5_ARC_HOME, KR5_ARC_LIMITS, kr5_arc
from core.simulation.looking import looking_angles
from core.simulation.scenes import Scene
from core.targets.specification import TargetSpec
from core.transforms import invert

GRID = TargetSpec("chessboard", 14, 9, 25.0)
CAMERA = Camera(2350.0, 2348.0, 1230.0, 1018.0, -0.1, 0.05)


def test_the_grid_is_in_view_and_the_joints_within_limits() -> None:
    rng = np.random.default_rng(1)
    arm = kr5_arc(rng)
    q = looking_angles(arm, GRID, CAMERA, (2448, 2050), rng, 12, home=KR5_ARC_HOME, limits=KR5_ARC_LIMITS)
    assert q.shape == (12, 6)
    assert np.all((q > KR5_ARC_LIMITS[:, 0]) & (q < KR5_ARC_LIMITS[:, 1]))
    for T in arm.camera_poses(q):
        pixels = Scene(GRID, CAMERA, invert(T)).points_px
        assert np.all(pixels > 10.0)
        assert np.all(pixels < [2438.0, 2040.0])
        assert T[2, 2] > np.cos(np.radians(40.5))  # tilt


def test_a_target_out_of_reach_is_refused() -> None:
    rng = np.random.default_rng(2)
    arm = kr5_arc(rng)
    far = arm.T_target_base.copy()
    far[0, :3, 3] += 5000.0
    with pytest.raises(ValueError, match="hardly look"):
        looking_angles(
            type(arm)(arm.chain, far, arm.T_flange_camera),
            GRID,
            CAMERA,
            (2448, 2050),
            rng,
            1,
            home=KR5_ARC_HOME,
            limits=KR5_ARC_LIMITS,
        )
