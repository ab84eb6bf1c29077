"""The session for identification: every joint swept before both grids, each image with its truth."""

from __future__ import annotations

import math

import numpy as np
import pytest

from core.geometry.camera import Camera
from core.kinematics.pose_observations import PoseData
from core.kinematics.sweeps import find_sweeps
from core.simulation.arm import KR5_ARC_LIMITS, kr5_arc
from core.simulation.arm_session import ArmSession, simulate_arm_session
from core.simulation.paper_experiment import JOINT_REPEATABILITY_RAD
from core.targets.specification import TargetSpec

GRID = TargetSpec("chessboard", 9, 6, 30.0)
CAMERA = Camera(650.0, 650.0, 618.0, 509.0, -0.1, 0.05)
SIZE = (1224, 1025)
STEPS, FREE = 5, 3


def made(seed: int) -> ArmSession:
    arm = kr5_arc(np.random.default_rng(seed))
    return simulate_arm_session(arm, GRID, CAMERA, SIZE, steps=STEPS, free=FREE, seed=seed)


@pytest.fixture(scope="module")
def session() -> ArmSession:
    return made(7)


def poses_of(session: ArmSession) -> PoseData:
    T = np.array([image.true_T_target_camera for image in session.images])
    q = np.array([pose.joint_angles for pose in session.poses])
    target = np.array([pose.target for pose in session.poses])
    return PoseData(q, T[:, :3, 3], T[:, :3, :3], target=target)


def test_every_joint_is_swept_before_both_grids_wide_enough_for_circles(session: ArmSession) -> None:
    sweeps = find_sweeps(poses_of(session))
    assert sorted((s.joint, s.target) for s in sweeps) == [(j, t) for j in range(6) for t in range(2)]
    assert {len(s.poses) for s in sweeps} == {STEPS}
    widest = {j: max(math.degrees(s.arc) for s in sweeps if s.joint == j) for j in range(6)}
    assert min(widest.values()) > 60.0
    # The grids are tied by joints 1 and 2: one setting of joint 1 in both sweeps of joint 2, and both wide.
    tying = [s for s in sweeps if s.joint == 1]
    assert tying[0].setting[0] == tying[1].setting[0]
    assert min(math.degrees(s.arc) for s in sweeps if s.joint < 2) > 60.0
    assert sum("free" in pose.pose_id for pose in session.poses) == 2 * FREE


def test_images_show_the_grid_and_are_where_the_arm_took_them(session: ArmSession) -> None:
    assert len({pose.pose_id for pose in session.poses}) == len(session.poses) == len(session.images)
    off = []
    for pose, image in zip(session.poses, session.images, strict=True):
        assert (image.pose_id, image.cycle) == (pose.pose_id, 1)
        assert np.all((pose.joint_angles > KR5_ARC_LIMITS[:, 0]) & (pose.joint_angles < KR5_ARC_LIMITS[:, 1]))
        assert np.all((image.scene.points_px > 8.0) & (image.scene.points_px < np.array(SIZE) - 8.0))
        commanded = session.arm.camera_poses(pose.joint_angles[None], np.array([pose.target]))[0]
        np.testing.assert_allclose(image.commanded_T_target_camera, commanded)
        off.append(image.true_T_target_camera[:3, 3] - commanded[:3, 3])
    # Joints that come back to σ move the camera by σ times its distance from their axes: a metre, or less.
    spread = float(np.sqrt(np.mean(np.square(off))))
    assert 0.2 * 1000.0 * JOINT_REPEATABILITY_RAD < spread < 2.0 * 1000.0 * JOINT_REPEATABILITY_RAD


def test_it_follows_the_seed(session: ArmSession) -> None:
    again = made(7)
    for pose, same, image, image_again in zip(
        session.poses, again.poses, session.images, again.images, strict=True
    ):
        np.testing.assert_array_equal(pose.joint_angles, same.joint_angles)
        np.testing.assert_array_equal(image.scene.T_camera_target, image_again.scene.T_camera_target)
