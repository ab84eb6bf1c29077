"""What becomes of a session's measurements before anything is identified."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from core.errors import JointAnglesInconsistent, TooManyMeasurements
from core.kinematics.dh import Chain
from core.session import CommandedPose, MeasuredPose, SessionData
from core.session.robot import MAX_POSES, poses_of_readings
from core.targets.specification import TargetSpec

TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
COVARIANCE = np.diag([1e-4] * 3 + [1e-10] * 3)


def session(*readings: dict[str, Any], commanded: dict[str, CommandedPose] | None = None) -> SessionData:
    measured = [
        MeasuredPose(
            **{
                "measurement_id": f"mpo_{i}",
                "pose_id": f"P{i}",
                "cycle": None,
                "joint_angles_deg": [10.0, 20.0],
                "position_mm": np.array([float(i), 0.0, 0.0]),
                "rotation": TURN,
                "covariance": COVARIANCE,
                "scatter": COVARIANCE,
                **reading,
            }
        )
        for i, reading in enumerate(readings)
    ]
    board = TargetSpec("chessboard", 9, 6, 12.0)
    return SessionData((board,), ("tgt_1",), commanded=commanded or {}, measured=tuple(measured))


def codes(data: SessionData) -> list[str]:
    return [w.code for w in poses_of_readings(data).warnings]


def test_readings_become_poses() -> None:
    gathered = poses_of_readings(session({}, {}))
    assert gathered.poses.joint_angles.tolist() == [[math.radians(10.0), math.radians(20.0)]] * 2
    assert gathered.poses.labels == ("P0", "P1")
    assert gathered.poses.rotations is not None
    assert gathered.poses.rotations.tolist() == [TURN.tolist()] * 2
    assert (gathered.targets, gathered.warnings) == ((), ())


def test_a_reading_s_own_angles_come_before_its_pose_s() -> None:
    at_angles = CommandedPose(joint_angles_deg=[1.0, 2.0])
    poses = poses_of_readings(
        session({}, {"joint_angles_deg": None}, commanded={"P0": at_angles, "P1": at_angles})
    ).poses
    assert np.degrees(poses.joint_angles).round(9).tolist() == [[10.0, 20.0], [1.0, 2.0]]


def test_what_few_lack_leaves_them_out_and_what_most_lack_leaves_it_out() -> None:
    without = {"rotation": None}
    assert codes(session({}, {}, without)) == ["rotations_missing"]
    assert len(poses_of_readings(session({}, {}, without)).poses) == 2
    positions = poses_of_readings(session({}, without, without))
    assert positions.poses.rotations is None
    assert len(positions.poses) == 3
    assert [w.code for w in positions.warnings] == ["rotations_ignored"]
    mixed = poses_of_readings(session({}, {"covariance": None}))
    assert mixed.poses.covariance is None
    assert [w.code for w in mixed.warnings] == ["covariances_ignored"]
    assert codes(session({}, {"joint_angles_deg": None})) == ["joint_angles_missing"]


def test_other_numbers_of_angles_than_the_robot_has_joints_are_excluded() -> None:
    two = Chain.from_rows([(0.0, 0.0, 0.0, 0.0)] * 2)
    data = session({}, {"joint_angles_deg": [1.0]}, {"joint_angles_deg": None})
    gathered = poses_of_readings(dataclasses.replace(data, nominal=two))
    assert gathered.poses.labels == ("P0",)
    assert [w.code for w in gathered.warnings] == ["joint_angles_missing", "joint_angles_inconsistent"]
    assert [w.detail for w in gathered.warnings] == [
        "Poses without joint angles are excluded: P2.",
        "Poses with another number of joint angles than the robot has joints are excluded: P1.",
    ]
    assert [(one.measurement_id, one.code) for one in gathered.excluded] == [
        ("mpo_1", "joint_angles_inconsistent"),
        ("mpo_2", "joint_angles_missing"),
    ]


def test_more_than_memory_holds_and_other_robots_are_refused() -> None:
    with pytest.raises(TooManyMeasurements):
        poses_of_readings(session(*[{}] * (MAX_POSES + 1)))
    three = Chain.from_rows([(0.0, 0.0, 0.0, 0.0)] * 3)
    with pytest.raises(JointAnglesInconsistent):
        poses_of_readings(dataclasses.replace(session({}), nominal=three))
