"""Commands corrected over HTTP and by the command: by joint angles or poses, with reasons where they are left."""

from __future__ import annotations

import csv
import io
from typing import Any

import numpy as np
import pytest

from app.api.schemas.analyses import Compensation
from core.geometry import rotation_to_rpy, transform
from core.kinematics import Chain, forward
from core.simulation.arm import KR5_ARC, Arm, deviated
from tests.support.service.service import assert_problem
from tests.support.sessions.kinematics import ROBOT, make_robot, readings
from tests.support.sessions.stored_sessions import new_session
from tests.support.sessions.tracked_robot import send
from tests.support.simulation.robots.real_arms import RealArm, angles_within_limits, measured, real_arm
from tests.support.simulation.simulated_poses import measure_poses


@pytest.fixture
def stored(api: Any) -> tuple[str, str, RealArm]:
    """A robot with gears and compliance and a session of 70 readings of it."""
    rng = np.random.default_rng(3)
    real = real_arm(rng)
    robot = make_robot(api)
    session = new_session(api, robot_id=robot)
    send(api, session, readings(measured(real, angles_within_limits(rng, 70), rng)))
    return robot, session, real


def ask(api: Any, robot: str, session: str, poses: list[dict[str, Any]], **more: Any) -> Any:
    body = {"session_id": session, "poses": poses, "source": "measured_poses", **more}
    return api.client.post(f"/v1/robots/{robot}/compensate", json=body)


@pytest.mark.slow
def test_commands_are_corrected_or_left_with_a_reason(api: Any, stored: tuple[str, str, RealArm]) -> None:
    robot, session, _ = stored
    q = angles_within_limits(np.random.default_rng(4), 30, share=0.4)
    poses = [{"pose_id": f"P{i}", "joint_angles_deg": np.degrees(a).tolist()} for i, a in enumerate(q)]
    T = forward(KR5_ARC, q[:3])
    for i in range(3):
        pose = dict(
            zip(
                ("roll_deg", "pitch_deg", "yaw_deg"),
                np.degrees(rotation_to_rpy(T[i, :3, :3])).tolist(),
                strict=True,
            )
        )
        poses.append({"pose_id": f"C{i}", "position_mm": T[i, :3, 3].tolist(), **pose})
    poses.append({"pose_id": "far", "joint_angles_deg": [0.0, -80.0, 80.0, 0.0, 128.0, 0.0]})
    response = ask(api, robot, session, poses)
    assert response.status_code == 200, response.text
    found = response.json()
    Compensation.model_validate(found, extra="forbid")
    ratio = found["validation"]["random_gain"]["position_ratio"]
    assert ratio < 0.6
    assert found["curves"]["applied"] is False
    by_id = {pose["pose_id"]: pose for pose in found["poses"]}
    assert [pose["pose_id"] for pose in found["poses"]] == [pose["pose_id"] for pose in poses]
    far = by_id["far"]
    assert (far["outcome"], far["applied"], far["expected_residual_mm"]) == ("outside_region", False, None)
    assert far["joint_angles_deg"] == poses[-1]["joint_angles_deg"]
    corrected = np.radians([by_id[f"P{i}"]["joint_angles_deg"] for i in range(30)])
    assert np.max(np.abs(np.degrees(corrected - q))) > 0.01
    # A pose without joint angles may be attained in another configuration, whose compliance is another.
    for i in range(3):
        one, other = by_id[f"P{i}"], by_id[f"C{i}"]
        assert other["applied"]
        assert other["position_mm"] == pytest.approx(one["position_mm"], abs=1.0)
    codes = {warning["code"] for warning in found["warnings"]}
    assert {"configuration_assumed", "commands_not_corrected"} <= codes


@pytest.mark.slow
def test_joint_curves_count_where_asked_for_or_confirmed(api: Any, stored: tuple[str, str, RealArm]) -> None:
    robot, session, real = stored
    rng = np.random.default_rng(5)
    second = new_session(api, robot_id=robot)
    send(api, second, readings(measured(real, angles_within_limits(rng, 50), rng)))
    poses = [{"pose_id": "P1", "joint_angles_deg": [0.0, -60.0, 60.0, 20.0, 50.0, 0.0]}]
    found = ask(api, robot, session, poses, confirming_session_id=second).json()
    assert found["curves"]["basis"] == "confirmed"
    assert found["curves"]["confirming_ratio"] < 0.95
    assert "joint_curves" in found["terms"]
    path = f"/v1/robots/{robot}/compensate?curves=true"
    body = {"session_id": session, "poses": poses, "source": "measured_poses"}
    asked = api.client.post(path, json=body).json()
    assert asked["curves"] == {
        "applied": True,
        "basis": "requested",
        "confirming_ratio": None,
        "failure_code": None,
    }
    table = api.client.post(path, json=body, headers={"Accept": "text/csv"})
    rows = list(csv.DictReader(io.StringIO(table.text)))
    assert rows[0]["pose_id"] == "P1"
    assert float(rows[0]["expected_residual_mm"]) == pytest.approx(asked["poses"][0]["expected_residual_mm"])


def test_a_robot_of_four_axes_says_once_what_it_cannot_correct(api: Any) -> None:
    rng = np.random.default_rng(8)
    nominal = Chain.from_rows(
        [
            (300.0, -90.0, 600.0, 0.0),
            (900.0, 0.0, 0.0, 0.0),
            (1000.0, 0.0, 0.0, 0.0),
            (250.0, -90.0, 0.0, 0.0),
        ]
    )
    arm = Arm(
        deviated(nominal, rng, 1.0, 1e-3), np.eye(4)[None], transform(np.eye(3), np.array([60.0, 0.0, 90.0]))
    )
    q = np.radians(rng.uniform([-150.0, -100.0, 10.0, -90.0], [150.0, 0.0, 110.0, 90.0], (60, 4)))
    robot = make_robot(api, nominal)
    session = new_session(api, robot_id=robot)
    send(api, session, readings(measure_poses(arm, q, rng, estimator="given", robot=ROBOT)))
    poses = [
        {"pose_id": f"P{i}", "joint_angles_deg": np.degrees(a).tolist()} for i, a in enumerate(0.8 * q[:10])
    ]
    response = ask(api, robot, session, poses)
    assert response.status_code == 200, response.text
    found = response.json()
    assert "near_singularity" not in {pose["outcome"] for pose in found["poses"]}
    (partial,) = [warning for warning in found["warnings"] if warning["code"] == "correction_partial"]
    assert "4 axes" in partial["detail"]
    assert "1 of 3 of the rotation" in partial["detail"]


def test_what_cannot_be_corrected_is_refused_in_words(api: Any, stored: tuple[str, str, RealArm]) -> None:
    robot, session, _ = stored
    pose = {"pose_id": "P1", "joint_angles_deg": [0.0, -60.0, 60.0, 0.0, 50.0, 0.0]}
    assert_problem(ask(api, robot, session, [{"pose_id": "P1"}]), 409, "command_incomplete")
    short = {"pose_id": "P1", "joint_angles_deg": [1.0, 2.0]}
    assert_problem(ask(api, robot, session, [short]), 409, "joint_angles_inconsistent")
    assert_problem(ask(api, make_robot(api), session, [pose]), 409, "session_of_another_robot")
    assert_problem(ask(api, robot, "ses_unknown", [pose]), 422, "referenced_session_not_found")
    assert_problem(ask(api, "rob_unknown", session, [pose]), 404, "robot_not_found")
    assert ask(api, robot, session, []).status_code == 422
