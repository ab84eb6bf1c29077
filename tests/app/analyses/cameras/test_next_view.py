"""Next views over HTTP: what each leaves uncertain, and refusals with their codes."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

import numpy as np
import pytest

from app.analyses.documents.next_view import next_view_findings
from app.api.schemas.analyses import NextViewAnalysis
from core.session import SessionData
from tests.support.sessions.arm_views import ArmViews, arm_before_board, viewing_angles
from tests.support.sessions.kinematics import make_robot, measured, readings
from tests.support.sessions.robot_session import RobotSession, store_robot_session
from tests.support.sessions.stored_sessions import Store, body, new_session, problem, shoot
from tests.support.sessions.tracked_robot import send


@pytest.fixture(scope="module")
def robot(api: Any) -> RobotSession:
    """A KR5 before one board, with commanded joint angles."""
    return store_robot_session(api)


def ask(api: Any, session: str, **fields: Any) -> Any:
    return api.client.post(f"/v1/sessions/{session}/next-view", json=fields)


def test_each_suggested_view_makes_the_camera_more_certain(api: Any, store: Store) -> None:
    session = new_session(api)
    store(api, session, shoot(poses=4, cycles=1))
    found = body(ask(api, session, purpose="intrinsics", count=4))
    NextViewAnalysis.model_validate(found, extra="forbid")
    assert found["target_id"] == api.client.get(f"/v1/sessions/{session}").json()["target_ids"][0]
    assert len(found["suggestions"]) == 4
    before = None
    for view in found["suggestions"]:
        now, after = view["expected_uncertainty_now"], view["expected_uncertainty_after"]
        assert before in (None, now)
        assert after["projection_rms_px"] < now["projection_rms_px"]
        assert after["focal_relative_uncertainty"] <= now["focal_relative_uncertainty"]
        T = np.array(view["T_target_camera"])
        np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-6)
        assert view["view_distance_mm"] > 0.0
        assert 0.0 <= view["view_tilt_deg"] <= 51.0
        assert view["joint_angles_deg"] is None
        assert view["T_base_flange"] is None
        assert now["length_rms_mm"] is None
        assert view["instruction"].endswith(f"{view['view_distance_mm']:.0f} mm away") or (
            "mm away (" in view["instruction"]
        )
        before = after


@pytest.mark.parametrize(("purpose", "of_robot"), [("dh", True), ("hand_eye", False), ("intrinsics", False)])
def test_poses_of_another_instrument_alone_have_advice_of_their_own(
    api: Any, purpose: str, of_robot: bool
) -> None:
    session = new_session(api, robot_id=make_robot(api))
    send(api, session, readings(measured(1, free=2)[1]))
    found = problem(ask(api, session, purpose=purpose), 409, "too_few_measurements")
    assert "another instrument" in found["detail"]
    assert ("observability_indices" in found["advice"]) == of_robot


def test_what_cannot_be_planned_is_refused(api: Any, store: Store) -> None:
    session = new_session(api)
    problem(ask(api, session), 409, "too_few_measurements")
    problem(ask(api, session, count=0), 422, "invalid_request")
    problem(ask(api, session, purpose="tool"), 422, "invalid_request")
    shots = shoot(poses=4, cycles=1)
    far = [dataclasses.replace(s, cycle=2, fields={"focus_group": "far"}) for s in shots]
    store(api, session, [*shots, *far])
    problem(ask(api, session), 409, "focus_group_required")
    problem(ask(api, session, focus_group="near"), 404, "focus_group_not_found")
    problem(ask(api, session, focus_group="far", target_id="tgt_other"), 409, "target_not_in_session")
    assert ask(api, session, focus_group="far", count=1).status_code == 200


@pytest.mark.parametrize("purpose", ["hand_eye", "dh"])
def test_views_for_a_robot_have_joint_angles_and_make_it_more_certain(
    robot: RobotSession, purpose: str
) -> None:
    found = body(ask(robot.api, robot.id, purpose=purpose, count=2))
    NextViewAnalysis.model_validate(found, extra="forbid")
    assert found["purpose"] == purpose
    for view in found["suggestions"]:
        now, after = view["expected_uncertainty_now"], view["expected_uncertainty_after"]
        assert now["projection_rms_px"] is None
        assert 0.0 < after["length_rms_mm"] <= now["length_rms_mm"]
        assert 0.0 < after["angle_rms_deg"] <= now["angle_rms_deg"]
        assert len(view["joint_angles_deg"]) == 6
        assert np.array(view["T_base_flange"]).shape == (4, 4)


@pytest.mark.parametrize("purpose", ["intrinsics", "hand_eye", "dh"])
def test_views_are_chosen_of_the_candidates_stated(robot: RobotSession, purpose: str) -> None:
    begun = body(ask(robot.api, robot.id, purpose="hand_eye", count=8))["suggestions"]
    known = [list(q) for q in sorted({tuple(view["joint_angles_deg"]) for view in begun})]
    assert len(known) >= 2
    away = [known[0][0] + 120.0, *known[0][1:]]
    candidates = [{"joint_angles_deg": q} for q in [away, *known]]
    found = body(ask(robot.api, robot.id, purpose=purpose, count=50, candidates=candidates))
    NextViewAnalysis.model_validate(found, extra="forbid")
    taken = [view["joint_angles_deg"] for view in found["suggestions"]]
    assert len(taken) == len(known)
    places = {int(np.argmin([np.abs(np.subtract(q, one)).max() for one in known])) for q in taken}
    assert len(places) == len(known)
    assert all(min(np.abs(np.subtract(q, one)).max() for one in known) < 1e-6 for q in taken)
    assert all(np.array(view["T_base_flange"]).shape == (4, 4) for view in found["suggestions"])
    (warning,) = [w for w in found["warnings"] if w["code"] == "candidates_hide_target"]
    assert f"1 of {len(candidates)} candidates do not show the whole target: 1." in warning["detail"]


def test_candidates_of_coupled_joints_are_the_angles_that_the_robot_states() -> None:
    rng = np.random.default_rng(4)
    views = ArmViews(arm_before_board(rng, as_built=False), rng, 0.2, 2e-4)
    views.take(viewing_angles(views.arm, rng, 8))
    plain, C = views.all(), np.eye(6)
    C[2, 1] = 1.0
    commanded = {
        name: dataclasses.replace(
            c, joint_angles_deg=np.linalg.solve(C, np.array(c.joint_angles_deg)).tolist()
        )
        for name, c in plain.commanded.items()
    }
    coupled = dataclasses.replace(plain, joint_coupling=C, commanded=commanded)
    q = np.degrees(viewing_angles(views.arm, np.random.default_rng(12), 4))

    def suggested(data: SessionData, stated_deg: np.ndarray) -> list[dict[str, Any]]:
        asked = {"purpose": "hand_eye", "count": "4", "candidates": json.dumps(stated_deg.tolist())}
        asked["limits"] = json.dumps([[None, None]] * 6)
        found: list[dict[str, Any]] = next_view_findings(data, asked).fields["suggestions"]
        return found

    of_plain, of_coupled = suggested(plain, q), suggested(coupled, np.linalg.solve(C, q.T).T)
    for one, other in zip(of_plain, of_coupled, strict=True):
        np.testing.assert_allclose(other["T_base_flange"], one["T_base_flange"], atol=1e-6)
        np.testing.assert_allclose(C @ other["joint_angles_deg"], one["joint_angles_deg"], atol=1e-9)


def test_candidates_that_are_no_views_of_the_robot_are_refused(robot: RobotSession, store: Store) -> None:
    two = [{"joint_angles_deg": [1.0, 2.0]}]
    problem(ask(robot.api, robot.id, candidates=two), 409, "joint_angles_inconsistent")
    problem(ask(robot.api, robot.id, candidates=[]), 422, "invalid_request")
    fine = robot.api.make_target(kind="chessboard", columns=100, rows=100, pitch_mm=2.0)
    both = [*robot.api.client.get(f"/v1/sessions/{robot.id}").json()["target_ids"], fine]
    change = {"target_ids": both}
    assert robot.api.client.patch(f"/v1/sessions/{robot.id}", json=change).status_code == 200
    many = [{"joint_angles_deg": [0.1 * k] * 6} for k in range(300)]
    problem(ask(robot.api, robot.id, candidates=many, target_id=fine), 409, "plan_too_large")
    bare = new_session(robot.api)
    store(robot.api, bare, shoot(poses=4, cycles=1))
    problem(ask(robot.api, bare, candidates=two), 409, "nominal_robot_missing")


def test_views_are_a_table_too(robot: RobotSession) -> None:
    answer = robot.api.client.post(
        f"/v1/sessions/{robot.id}/next-view",
        json={"purpose": "dh", "count": 2},
        headers={"Accept": "text/csv"},
    )
    assert answer.status_code == 200
    header, *rows = answer.text.splitlines()
    assert "instruction" in header.split(",")
    assert len(rows) == 2


def test_what_a_purpose_needs_is_named(api: Any, store: Store) -> None:
    session = new_session(api)
    store(api, session, shoot(poses=4, cycles=1))
    problem(ask(api, session, purpose="hand_eye"), 409, "commanded_poses_missing")
    problem(ask(api, session, purpose="dh"), 409, "joint_angles_missing")
