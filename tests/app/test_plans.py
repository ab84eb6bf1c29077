"""The planner over HTTP: more poses tell more, suggested ones most, and what cannot be planned is refused in words."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from app.api.schemas.planning import DhPlan
from core.simulation.arm import KR5_ARC, KR5_ARC_HOME, T_FLANGE_CAMERA
from tests.app.test_bad_input import assert_problem

CAMERA = {
    **{"fx_px": 2320.0, "fy_px": 2320.0, "cx_px": 1223.5, "cy_px": 1024.5, "k1": -0.1, "k2": 0.05},
    **{"image_width_px": 2448, "image_height_px": 2050},
}


def make_robot(api: Any, limits: Any = None) -> str:
    joints = [
        {
            "a_mm": j.a_mm,
            "alpha_deg": math.degrees(j.alpha_rad),
            "d_mm": j.d_mm,
            "theta_offset_deg": math.degrees(j.theta_offset_rad),
        }
        for j in KR5_ARC.joints
    ]
    for joint, (low, high) in zip(
        joints, () if limits is None else np.degrees(limits).tolist(), strict=False
    ):
        joint.update(lower_deg=low, upper_deg=high)
    return str(api.client.post("/v1/robots", json={"name": "KR5", "joints": joints}).json()["id"])


def body(api: Any, **changes: Any) -> dict[str, Any]:
    return {
        "target_id": api.make_target(columns=14, rows=10),
        "camera": CAMERA,
        "home_deg": np.degrees(KR5_ARC_HOME).tolist(),
        "T_flange_camera": T_FLANGE_CAMERA.tolist(),
        "half_range_deg": 8.0,
        "fill": 0.4,
        **changes,
    }


def ask(api: Any, robot: str, **changes: Any) -> Any:
    return api.client.post(f"/v1/robots/{robot}/dh-plan", json=body(api, **changes))


def planned(api: Any, robot: str, **changes: Any) -> dict[str, Any]:
    response = ask(api, robot, **changes)
    assert response.status_code == 200, response.text
    document: dict[str, Any] = response.json()
    DhPlan.model_validate(document, extra="forbid")
    return document


def doubt(joints: list[dict[str, Any]]) -> float:
    """The geometric mean of the lengths' uncertainties."""
    values = [joint["standard_uncertainty"]["a_mm"] for joint in joints[:5]]
    return float(np.exp(np.mean(np.log(values))))


def test_more_poses_tell_more_and_suggested_ones_most(api: Any) -> None:
    robot = make_robot(api)
    few = planned(api, robot, sweeps={"half_arc_deg": 8.0, "steps": 7}, free_poses=10, suggest=20)
    assert len(few["poses"]) == 52
    assert sum(pose["visible"] for pose in few["poses"]) > 30
    assert len(few["suggested"]) == 20
    assert few["null_space"]
    assert few["joints"][5]["identifiable"]["a_mm"] is False
    assert doubt(few["joints_with_suggested"]) < 0.8 * doubt(few["joints"])
    # As many at random help less.
    random = planned(api, robot, sweeps={"half_arc_deg": 8.0, "steps": 7}, free_poses=30)
    assert random["suggested"] == []
    assert random["joints_with_suggested"] is None
    assert doubt(few["joints_with_suggested"]) < doubt(random["joints"])
    # A robot that scatters tells less by the same poses, and a question gets the same answer again.
    query = {"joint_angles_deg": few["suggested"], "sweeps": {"half_arc_deg": 8.0, "steps": 7}}
    still, loose = (planned(api, robot, **query, robot_position_mm=s) for s in (0.0, 0.2))
    assert doubt(loose["joints"]) > 1.5 * doubt(still["joints"])
    assert planned(api, robot, **query)["joints"] == still["joints"]


def test_poses_that_tell_nothing_are_said_to(api: Any) -> None:
    robot = make_robot(api)
    still = planned(api, robot, joint_angles_deg=[np.degrees(KR5_ARC_HOME).tolist()] * 20)
    assert not any(any(joint["identifiable"].values()) for joint in still["joints"])
    # One joint alone, all images from one direction.
    one = planned(api, robot, sweeps={"joints": [6], "steps": 15})
    assert not any(any(joint["identifiable"].values()) for joint in one["joints"][:4])


def test_suggested_poses_stay_within_the_joints_limits(api: Any) -> None:
    home = np.degrees(KR5_ARC_HOME)
    limits = np.radians(np.column_stack([home - 3.0, home + np.where(np.arange(6) == 0, 1.0, 90.0)]))
    robot = make_robot(api, limits)
    found = planned(api, robot, free_poses=25, suggest=8)
    q = np.array([pose["joint_angles_deg"] for pose in found["poses"]] + found["suggested"]) - home
    assert len(q) == 33
    assert np.all(q >= -3.0 - 1e-9)
    assert np.all(q[:, 0] <= 1.0 + 1e-9)
    assert np.all(q[:, 1:].max(axis=0) > 3.0)
    # Without limits they go to either side alike.
    free = planned(api, make_robot(api), free_poses=25, suggest=8)
    q = np.array([pose["joint_angles_deg"] for pose in free["poses"]] + free["suggested"]) - home
    assert np.all(q.min(axis=0) < -3.0)
    assert np.all(q[:, 0].max() > 3.0)
    for changes in (
        {"sweeps": {"half_arc_deg": 4.0, "steps": 5, "joints": [1]}},
        {"joint_angles_deg": [(home + 2.0).tolist()]},
        {"home_deg": (home - 4.0).tolist(), "free_poses": 30},
    ):
        problem = assert_problem(ask(api, robot, **changes), 409, "joint_limits_exceeded")
        assert "joint 1" in problem["detail"]
        assert problem["advice"]


def test_refusals_say_what_to_do(api: Any) -> None:
    robot = make_robot(api)
    for changes, code in (
        ({}, "too_few_poses"),
        ({"joint_angles_deg": [[0.0] * 5]}, "joint_angles_inconsistent"),
        ({"home_deg": [0.0]}, "joint_angles_inconsistent"),
        ({"sweeps": {"joints": [7]}}, "joint_angles_inconsistent"),
        ({"free_poses": 5}, "too_few_poses"),
        ({"free_poses": 30, "T_flange_camera": np.diag([1.0, 1.0, -1.0, 1.0]).tolist()}, "invalid_matrix"),
    ):
        assert assert_problem(ask(api, robot, **changes), 409, code)["advice"], changes
    huge = api.make_target(columns=500, rows=500)
    assert_problem(ask(api, robot, target_id=huge, free_poses=30), 409, "plan_too_large")
    assert_problem(ask(api, "rob_nothing"), 404, "robot_not_found")
    assert_problem(ask(api, robot, target_id="tgt_nothing", free_poses=30), 422, "target_unknown")


@pytest.mark.parametrize(
    "changes",
    [
        {"camera": {**CAMERA, "fx_px": 0.0}},
        {"camera": None},
        {"fill": 0.0},
        {"noise_px": 0.0},
        {"suggest": 101},
        {"free_poses": -1},
        {"T_flange_camera": np.eye(3).tolist()},
        {"sweeps": {"steps": 2}},
        {"poses": []},
    ],
)
def test_wrong_fields_are_refused(api: Any, changes: dict[str, Any]) -> None:
    assert_problem(ask(api, make_robot(api), **changes), 422, "invalid_request")
