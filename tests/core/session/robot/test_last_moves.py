"""The side that joints come from, by the order in which poses were measured."""

from __future__ import annotations

import numpy as np
import pytest

from core.session import MeasuredPose, SessionData
from core.session.robot.last_moves import last_moves, measuring_order


def pose(name: str, pose_id: str, cycle: int | None = None) -> MeasuredPose:
    return MeasuredPose(name, pose_id, cycle, None, np.zeros(3), None, None, None)


def moves(
    poses: list[MeasuredPose], angles_deg: list[float], taken_h: dict[str, float] | None = None
) -> list[float] | None:
    data = SessionData((), (), taken_h=taken_h or {})
    found = last_moves(measuring_order(data, poses), np.radians(angles_deg)[:, None])
    return None if found is None else found[:, 0].tolist()


def test_poses_are_visited_by_cycle_and_name() -> None:
    poses = [pose("a", "P10", 1), pose("b", "P2", 1), pose("c", "P1", 1), pose("d", "P1", 2)]
    # P1 at 0, P2 at 10, P10 at -5, then P1 of the second cycle at 0.
    assert moves(poses, [-5.0, 10.0, 0.0, 0.0]) == [-1.0, 1.0, 0.0, 1.0]


def test_times_go_before_names_and_a_joint_that_stays_keeps_its_side() -> None:
    poses = [pose("a", "P1", 1), pose("b", "P2", 1), pose("c", "P3", 1)]
    taken = {"a": 2.0, "b": 1.0, "c": 3.0}
    assert moves(poses, [20.0, 10.0, 20.001], taken) == [1.0, 0.0, 1.0]
    assert moves(poses, [20.0, 10.0, 20.001], {"a": 2.0}) == [0.0, -1.0, 1.0]  # not all are known


@pytest.mark.parametrize("second", ["P1", "P2"])
def test_without_cycles_every_pose_is_visited_once(second: str) -> None:
    found = moves([pose("a", "P1"), pose("b", second)], [0.0, 5.0])
    assert found == (None if second == "P1" else [0.0, 1.0])
    assert moves([pose("a", "P1"), pose("b", "P2", 1)], [0.0, 5.0]) is None
