"""The decision on a robot's data sheet, over HTTP: from what the session measured and what the robot states."""

from __future__ import annotations

from typing import Any

import pytest

from tests.support.sessions.kinematics import make_robot
from tests.support.sessions.stored_sessions import body, new_session
from tests.support.sessions.tracked_robot import drawn_poses, readings, send, send_commands


def table(api: Any, session: str) -> dict[str, Any]:
    response = api.client.get(f"/v1/sessions/{session}/repeatability", params={"source": "measured_poses"})
    document: dict[str, Any] = body(response)
    return document


@pytest.fixture
def measured(api: Any) -> tuple[str, str]:
    """Return a robot and its session of three poses; its RP_l is about .2 mm."""
    robot = make_robot(api)
    session = new_session(api, robot_id=robot)
    send(api, session, readings(drawn_poses(9, 3), cycles=30))
    return robot, session


def test_a_robot_without_a_promise_is_not_judged(api: Any, measured: tuple[str, str]) -> None:
    robot, session = measured
    assert table(api, session)["acceptance"] is table(api, session)["accuracy_acceptance"] is None
    stated = {"datasheet_accuracy_mm": 0.5, "serial_number": "K-1"}
    assert api.client.patch(f"/v1/robots/{robot}", json=stated).status_code == 200
    found = table(api, session)
    assert found["acceptance"] is None
    assert found["accuracy_acceptance"] is None  # no pose was commanded


@pytest.mark.parametrize(("limit", "decision"), [(0.5, "pass"), (0.02, "fail")])
def test_a_promise_is_kept_or_not(api: Any, measured: tuple[str, str], limit: float, decision: str) -> None:
    robot, session = measured
    before = table(api, session)
    api.client.patch(f"/v1/robots/{robot}", json={"datasheet_repeatability_mm": limit})
    found = table(api, session)
    judged = found["acceptance"]
    assert (judged["decision"], judged["rule"]) == (decision, "ISO 14253-1 guard band")
    assert judged["datasheet_repeatability_mm"] == limit
    assert judged["cycles_needed"] is None
    worst = max(pose["repeatability"]["rp_l_mm"] for pose in found["poses"])
    assert judged["worst_rp_l_mm"] == worst
    assert judged["pose_id"] in {pose["pose_id"] for pose in found["poses"]}
    # The robot is an input of the answer, and nothing else of it changes.
    assert found["inputs_sha256"] != before["inputs_sha256"]
    assert found["poses"] == before["poses"]


def test_a_limit_within_the_interval_is_left_open_and_says_what_would_decide(
    api: Any, measured: tuple[str, str]
) -> None:
    robot, session = measured
    worst = max(table(api, session)["poses"], key=lambda pose: pose["corrected_interval"]["rp_l_mm"][1])
    value, high = worst["corrected"]["rp_l_mm"], worst["corrected_interval"]["rp_l_mm"][1]
    limit = (value * high) ** 0.5
    api.client.patch(f"/v1/robots/{robot}", json={"datasheet_repeatability_mm": limit})
    judged = table(api, session)["acceptance"]
    assert (judged["decision"], judged["pose_id"]) == ("inconclusive", worst["pose_id"])
    assert judged["cycles_needed"] == pytest.approx(
        1 + 29 * 4, abs=1
    )  # half of the width on the logarithmic scale


@pytest.mark.parametrize(("limit", "decision"), [(5.0, "pass"), (0.05, "fail")])
def test_the_accuracy_of_commanded_poses_is_judged(api: Any, limit: float, decision: str) -> None:
    robot = make_robot(api)
    session = new_session(api, robot_id=robot)
    poses = drawn_poses(9, 8)
    commanded = [pose.copy() for pose in poses]
    commanded[2][0, 3] += 1.0
    send_commands(api, session, commanded)
    send(api, session, readings(poses, cycles=30))
    api.client.patch(f"/v1/robots/{robot}", json={"datasheet_accuracy_mm": limit})
    found = table(api, session)
    judged = found["accuracy_acceptance"]
    assert (judged["decision"], judged["datasheet_accuracy_mm"]) == (decision, limit)
    assert judged["pose_id"] == "P3"
    assert judged["worst_ap_p_mm"] == max(pose["accuracy"]["ap_p_mm"] for pose in found["poses"])
    assert found["acceptance"] is None
