"""Poses with joint angles: taken whole, or refused by name."""

from __future__ import annotations

import numpy as np
import pytest

from core.errors import InvalidArgument, JointAnglesInconsistent, JointAnglesMissing
from core.kinematics.pose_observations import PoseData, stack_joint_angles


def two(**changes: object) -> PoseData:
    given: dict[str, object] = {
        "joint_angles": np.zeros((2, 6)),
        "positions_mm": np.zeros((2, 3)),
        "rotations": np.tile(np.eye(3), (2, 1, 1)),
        "covariance": np.tile(np.eye(6), (2, 1, 1)),
        "labels": ("home", "away"),
    }
    return PoseData(**(given | changes))  # type: ignore[arg-type]


def test_parts_stay_together() -> None:
    poses = PoseData(
        np.arange(12.0).reshape(3, 4),
        np.arange(9.0).reshape(3, 3),
        target=np.array([0, 1, 0]),
        common=np.ones((3, 6, 2)) * np.arange(3.0)[:, None, None],
        labels=("a", "b", "c"),
    )
    some = poses.take(np.array([2, 1]))
    assert some.labels == ("c", "b")
    assert some.joint_angles[:, 0].tolist() == [8.0, 4.0]
    assert some.targets.tolist() == [0, 1]
    assert some.common is not None
    assert some.common[:, 0, 0].tolist() == [2.0, 1.0]
    assert (len(poses), poses.joints) == (3, 4)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"positions_mm": np.array([[0.0, 0, 0], [np.nan, 0, 0]])}, "away has a position"),
        ({"rotations": np.array([np.eye(3), -np.eye(3)])}, "away has a matrix that is no rotation"),
        ({"rotations": np.array([1.01 * np.eye(3), np.eye(3)])}, "home has a matrix that is no rotation"),
        ({"covariance": np.array([np.eye(6), np.zeros((6, 6))])}, "away has a covariance"),
        ({"target": np.array([0, -1])}, "away has a target"),
        ({"joint_angles": np.zeros((3, 6))}, "differ in length"),
        ({"labels": ("home",)}, "labels"),
    ],
)
def test_what_cannot_be_used_is_named(changes: dict[str, object], words: str) -> None:
    with pytest.raises(InvalidArgument, match=words):
        two(**changes)


def test_rotations_of_positions_alone_need_no_variance() -> None:
    covariance = np.zeros((2, 6, 6))
    covariance[:, :3, :3] = np.eye(3)
    assert len(two(rotations=None, covariance=covariance)) == 2


def test_missing_angles_are_named() -> None:
    angles = np.zeros((2, 6))
    angles[1, 3] = np.nan
    with pytest.raises(JointAnglesMissing, match="1 of 2"):
        two(joint_angles=angles)
    with pytest.raises(JointAnglesMissing):
        two(joint_angles=np.zeros((2, 0)))


def test_angles_are_stacked_or_refused() -> None:
    assert stack_joint_angles([(1.0, 2.0), [3.0, 4.0]], 2).tolist() == [[1.0, 2.0], [3.0, 4.0]]
    with pytest.raises(JointAnglesMissing, match=r"2 of 3 .* P2, P3"):
        stack_joint_angles([(1.0,), None, ()], labels=("P1", "P2", "P3"))
    with pytest.raises(JointAnglesMissing):
        stack_joint_angles([])
    with pytest.raises(JointAnglesInconsistent, match="P1"):
        stack_joint_angles([(1.0,), (1.0, 2.0)], labels=("P1", "P2"))
    with pytest.raises(JointAnglesInconsistent, match="6"):
        stack_joint_angles([(1.0, 2.0)], 6)
