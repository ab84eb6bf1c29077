"""The paper's experiment: poses where ISO 9283 puts them, in reach and in view, and a scatter that is as stated."""

from __future__ import annotations

import math

import numpy as np
import pytest

from core.errors import InvalidArgument
from core.geometry.camera import Camera
from core.geometry.se3 import compose, so3_log
from core.kinematics.dh import forward
from core.metrology import PoseCycles, assess_repeatability
from core.simulation.arm import KR5_ARC, KR5_ARC_LIMITS, T_FLANGE_CAMERA
from core.simulation.paper_experiment import Experiment, cube_experiment, cube_points
from core.targets.specification import TargetSpec

BOARD = TargetSpec("chessboard", 14, 10, 21.0)
CAMERA = Camera(1160.0, 1160.0, 620.0, 505.0, k1=-0.1, k2=0.05)
SIZE = (1224, 1025)


def experiment(seed: int, cycles: int = 1, **options: float) -> Experiment:
    return cube_experiment(BOARD, CAMERA, SIZE, cycles=cycles, seed=seed, **options)


def test_cube_points_lie_on_the_diagonals_of_the_measuring_plane() -> None:
    points = cube_points(np.array([10.0, 20.0, 30.0]))
    p1, rest = points[0], points[1:]
    np.testing.assert_allclose(p1, [10.0, 20.0, 30.0])
    diagonal = 100.0 * math.sqrt(3.0)
    ends = diagonal / 2.0 - np.linalg.norm(rest - p1, axis=1)
    np.testing.assert_allclose(ends / diagonal, 0.1)
    assert np.linalg.matrix_rank(rest - p1, tol=1e-9) == 2  # one plane
    np.testing.assert_allclose(rest.sum(axis=0), 4 * p1)
    assert len(np.unique(points.round(6), axis=0)) == 5


@pytest.mark.parametrize("seed", range(8))
def test_every_pose_is_in_reach_and_shows_the_board(seed: int) -> None:
    made = experiment(seed)
    assert [pose.pose_id for pose in made.poses] == ["P1", "P2", "P3", "P4", "P5"]
    for pose, image in zip(made.poses, made.images, strict=True):
        flange = forward(KR5_ARC, pose.joint_angles[None])[0]
        np.testing.assert_allclose(flange, pose.commanded_T_base_flange, atol=1e-6)
        assert np.all(pose.joint_angles > KR5_ARC_LIMITS[:, 0])
        assert np.all(pose.joint_angles < KR5_ARC_LIMITS[:, 1])
        assert np.all(image.scene.points_px > 60.0)
        assert np.all(image.scene.points_px < np.array(SIZE) - 60.0)
        assert 15.0 < math.degrees(math.acos(image.scene.T_camera_target[2, 2])) < 45.0
    cameras = [compose(pose.commanded_T_base_flange, T_FLANGE_CAMERA)[:3, 3] for pose in made.poses]
    np.testing.assert_allclose(cameras, cube_points(cameras[0]), atol=1e-6)


def test_the_arm_as_built_is_not_its_data_sheet() -> None:
    (first, *_), (image, *_) = experiment(1).poses, experiment(1).images
    off = first.mean_T_target_camera[:3, 3] - image.commanded_T_target_camera[:3, 3]
    assert 0.3 < np.linalg.norm(off) < 40.0


def test_the_robot_scatters_as_stated() -> None:
    made = experiment(4, cycles=400)
    for pose in made.poses:
        true = np.array([i.true_T_target_camera for i in made.images if i.pose_id == pose.pose_id])
        d = true[:, :3, 3] - pose.mean_T_target_camera[:3, 3]
        w = np.array([so3_log(T[:3, :3] @ pose.mean_T_target_camera[:3, :3].T) for T in true])
        white = np.linalg.solve(np.linalg.cholesky(pose.covariance), np.hstack([d, w]).T)
        # Six variances and fifteen covariances of 400 draws, each known to √(2/400) and 1/20; four of those.
        assert np.abs(white @ white.T / 400.0 - np.eye(6)).max() < 0.28
        (figures,) = assess_repeatability([PoseCycles(true[:, :3, 3], true[:, :3, :3])])
        found = [value for _, value in figures.repeatability.items()]
        expected = [value for _, value in pose.true_repeatability.items()]
        np.testing.assert_allclose(found, expected, rtol=0.15)  # 3 S to 1/√800, RP_l to less; four of those


def test_cycles_come_pose_by_pose_and_follow_the_seed() -> None:
    made, again, other = experiment(3, cycles=2), experiment(3, cycles=2), experiment(4, cycles=2)
    tags = [(image.pose_id, image.cycle) for image in made.images]
    assert tags == [(f"P{p}", cycle) for cycle in (1, 2) for p in (1, 2, 3, 4, 5)]
    assert len({image.scene.seed for image in made.images}) == 10
    for one, same, different in zip(made.images, again.images, other.images, strict=True):
        np.testing.assert_array_equal(one.scene.T_camera_target, same.scene.T_camera_target)
        assert np.any(one.scene.T_camera_target != different.scene.T_camera_target)


def test_a_pose_beyond_reach_is_refused() -> None:
    large = TargetSpec("chessboard", 14, 10, 120.0)  # to be seen whole from farther than the arm is long
    with pytest.raises(InvalidArgument, match="reach"):
        cube_experiment(large, CAMERA, SIZE, cycles=1)
