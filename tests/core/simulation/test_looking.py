"""Drawn joint angles bring the camera before the grid, within the joints' limits; sweeps do not lose it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from core.geometry.camera import Camera
from core.geometry.se3 import invert, transform
from core.simulation.arm import KR5_ARC_HOME, KR5_ARC_LIMITS, kr5_arc
from core.simulation.looking import in_view, largest_visible_sweep, sample_viewing_configurations
from core.simulation.scenes import Scene
from core.targets.specification import TargetSpec

GRID = TargetSpec("chessboard", 14, 9, 25.0)
CAMERA = Camera(2350.0, 2348.0, 1230.0, 1018.0, -0.1, 0.05)


def test_the_grid_is_in_view_and_the_joints_within_limits() -> None:
    rng = np.random.default_rng(1)
    arm = kr5_arc(rng)
    q = sample_viewing_configurations(
        arm, GRID, CAMERA, (2448, 2050), rng, 12, home=KR5_ARC_HOME, limits=KR5_ARC_LIMITS
    )
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
        sample_viewing_configurations(
            type(arm)(arm.chain, far, arm.T_flange_camera),
            GRID,
            CAMERA,
            (2448, 2050),
            rng,
            1,
            home=KR5_ARC_HOME,
            limits=KR5_ARC_LIMITS,
        )


def test_in_view_is_the_whole_grid_ahead_and_inside() -> None:
    middle = GRID.points_target().mean(axis=0)
    ahead = transform(np.eye(3), np.array([0.0, 0.0, 600.0]) - middle)
    views = np.array([ahead, ahead, ahead, ahead])
    views[1, 0, 3] += 200.0  # beyond the right edge
    views[2, 2, 3] = 250.0  # so near that it is larger than the image
    views[3, 2, 3] = -600.0  # behind the camera, where a projection would stand upside down in the image
    assert in_view(views, GRID, CAMERA, (2448, 2050)).tolist() == [True, False, False, False]


@pytest.mark.parametrize("joint", range(6))
def test_a_sweep_goes_as_far_as_the_grid_is_seen(joint: int) -> None:
    rng = np.random.default_rng(3)
    arm = kr5_arc(rng)
    size, lens = (1224, 1025), Camera(650.0, 650.0, 618.0, 509.0, -0.1, 0.05)
    through = sample_viewing_configurations(
        arm, GRID, lens, size, rng, 20, home=KR5_ARC_HOME, limits=KR5_ARC_LIMITS, fill=(0.2, 0.4)
    )
    q = largest_visible_sweep(arm, GRID, lens, size, through, joint, limits=KR5_ARC_LIMITS, steps=31)
    assert q.shape == (31, 6)
    assert np.all(np.ptp(np.delete(q, joint, axis=1), axis=0) == 0.0)  # one joint moves

    def seen(angles: np.ndarray) -> np.ndarray:
        T = np.linalg.inv(arm.camera_poses(angles))
        inside = np.all((angles > KR5_ARC_LIMITS[:, 0]) & (angles < KR5_ARC_LIMITS[:, 1]), axis=1)
        return np.asarray(in_view(T, GRID, lens, size) & (T[:, 2, 2] > 0.5) & inside)

    assert seen(q).all()
    arc = math.degrees(float(np.ptp(q[:, joint])))
    assert 10.0 <= arc <= 120.001
    if arc < 119.0:
        step = np.radians(2.01) * np.eye(6)[joint]
        assert not seen(np.stack([q[0] - step, q[-1] + step])).any()


def test_a_joint_that_loses_the_grid_at_once_is_reported() -> None:
    rng = np.random.default_rng(4)
    arm = kr5_arc(rng)
    q = sample_viewing_configurations(
        arm, GRID, CAMERA, (2448, 2050), rng, 3, home=KR5_ARC_HOME, limits=KR5_ARC_LIMITS
    )
    with pytest.raises(ValueError, match="Joint 1"):
        largest_visible_sweep(
            arm, GRID, CAMERA, (2448, 2050), q, 0, limits=KR5_ARC_LIMITS, steps=3, smallest=math.radians(90.0)
        )
