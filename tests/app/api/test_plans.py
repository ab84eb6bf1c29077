"""The planner over HTTP: more poses determine more, suggested ones most; what cannot be planned is refused."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from app.api.schemas.analyses import DhPlan
from app.cli.demo.session import joint_rows
from core.simulation.arm import KR5_ARC, KR5_ARC_HOME, T_FLANGE_CAMERA
from tests.support.service.service import Api, ApiMaker, assert_problem

CAMERA = {
    **{"fx_px": 2320.0, "fy_px": 2320.0, "cx_px": 1223.5, "cy_px": 1024.5, "k1": -0.1, "k2": 0.05},
    **{"image_width_px": 2448, "image_height_px": 2050},
}


@pytest.fixture(scope="module")
def api(open_api: ApiMaker) -> Iterator[Api]:
    """One application for all tests here: none counts what is stored."""
    with open_api() as running:
        yield running


def make_robot(api: Any, limits: Any = None) -> str:
    joints = joint_rows(KR5_ARC)
    for joint, (low, high) in zip(
        joints, () if limits is None else np.degrees(limits).tolist(), strict=False
    ):
        joint.update(minimum_deg=low, maximum_deg=high)
    return str(api.client.post("/v1/robots", json={"name": "KR5", "joints": joints}).json()["id"])


def body(api: Any, **changes: Any) -> dict[str, Any]:
    return {
        "target_id": api.make_target(columns=14, rows=10),
        "camera": CAMERA,
        "home_deg": np.degrees(KR5_ARC_HOME).tolist(),
        "T_flange_camera": T_FLANGE_CAMERA.tolist(),
        "random_half_range_deg": 8.0,
        "image_coverage": 0.4,
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


def mean_uncertainty(joints: list[dict[str, Any]]) -> float:
    """The geometric mean of the lengths' uncertainties."""
    values = [joint["standard_uncertainty"]["a_mm"] for joint in joints[:5]]
    return float(np.exp(np.mean(np.log(values))))


@pytest.mark.slow
def test_more_poses_determine_more_and_suggested_ones_most(api: Any) -> None:
    robot = make_robot(api)
    few = planned(
        api, robot, sweeps={"sweep_half_angle_deg": 8.0, "steps": 7}, random_poses=10, suggest_count=20
    )
    assert len(few["poses"]) == 52
    assert sum(pose["shows_target"] for pose in few["poses"]) > 30
    assert len(few["suggested_poses"]) == 20
    assert few["null_space"]
    assert few["joints"][5]["identifiable"]["a_mm"] is False
    assert mean_uncertainty(few["predicted_joints_with_suggestions"]) < 0.8 * mean_uncertainty(few["joints"])
    before, after = few["observability_indices"], few["observability_indices_with_suggestions"]
    assert before["o1"] == few["observability_o1"]
    assert before["o2"] == pytest.approx(1.0 / few["condition_number"], rel=1e-5)
    assert all(after[name] > before[name] for name in ("o1", "o2", "o3", "o4", "o5"))
    # As many at random help less.
    random = planned(api, robot, sweeps={"sweep_half_angle_deg": 8.0, "steps": 7}, random_poses=30)
    assert random["suggested_poses"] == []
    assert random["predicted_joints_with_suggestions"] is None
    assert random["observability_indices_with_suggestions"] is None
    assert mean_uncertainty(few["predicted_joints_with_suggestions"]) < mean_uncertainty(random["joints"])
    # A robot that scatters is determined less well by the same poses, and equal questions get equal answers.
    query = {
        "poses": few["suggested_poses"],
        "sweeps": {"sweep_half_angle_deg": 8.0, "steps": 7},
    }
    still, loose = (planned(api, robot, **query, robot_position_sigma_mm=s) for s in (0.0, 0.2))
    assert mean_uncertainty(loose["joints"]) > 1.5 * mean_uncertainty(still["joints"])
    assert planned(api, robot, **query)["joints"] == still["joints"]


def test_coupled_joints_are_planned_by_their_stated_angles(api: Any) -> None:
    """The same poses of the chain determine the same; planned are the angles that the controller takes."""
    coupling = np.eye(6)
    coupling[2, 1] = 1.0
    home = np.degrees(KR5_ARC_HOME)
    stated_home = np.linalg.solve(coupling, home)
    plain, coupled = make_robot(api), make_robot(api)
    api.client.patch(f"/v1/robots/{coupled}", json={"joint_coupling": coupling.tolist()})
    swept = {"sweep_half_angle_deg": 8.0, "steps": 7}
    listed = home + np.random.default_rng(3).uniform(-6.0, 6.0, (6, 6))
    ours = [{"joint_angles_deg": q} for q in listed.tolist()]
    theirs = [{"joint_angles_deg": q} for q in np.linalg.solve(coupling, listed.T).T.tolist()]
    one = planned(api, plain, sweeps=swept, poses=ours)
    other = planned(api, coupled, home_deg=stated_home.tolist(), sweeps=swept, poses=theirs, suggest_count=5)
    of_chain, stated = (np.array([p["joint_angles_deg"] for p in found["poses"]]) for found in (one, other))
    np.testing.assert_allclose(stated @ coupling.T, of_chain, atol=1e-9)
    for a, b in zip(one["joints"], other["joints"], strict=True):
        for name, u in a["standard_uncertainty"].items():
            v = b["standard_uncertainty"][name]
            assert v is None if u is None else v == pytest.approx(u, rel=1e-6)
    # Random and suggested poses lie about the stated home, and limits are those of stated angles.
    assert (
        np.max(
            np.abs(np.array([pose["joint_angles_deg"] for pose in other["suggested_poses"]]) - stated_home)
        )
        <= 8.0 + 1e-9
    )
    limits = np.radians(np.column_stack([stated_home - 5.0, stated_home + 90.0]))
    bounded = make_robot(api, limits)
    api.client.patch(f"/v1/robots/{bounded}", json={"joint_coupling": coupling.tolist()})
    within = {"sweep_half_angle_deg": 4.0, "steps": 5, "joint_numbers": [2]}
    planned(api, bounded, home_deg=stated_home.tolist(), sweeps=within, random_poses=25)
    beyond = {**within, "sweep_half_angle_deg": 6.0}
    refused = ask(api, bounded, home_deg=stated_home.tolist(), sweeps=beyond)
    assert "joint 2" in assert_problem(refused, 409, "joint_limits_exceeded")["detail"]


def test_poses_that_determine_nothing_are_reported(api: Any) -> None:
    robot = make_robot(api)
    still = planned(api, robot, poses=[{"joint_angles_deg": np.degrees(KR5_ARC_HOME).tolist()}] * 20)
    assert not any(any(joint["identifiable"].values()) for joint in still["joints"])
    # One joint alone, all images from one direction.
    one = planned(api, robot, sweeps={"joint_numbers": [6], "steps": 15})
    assert not any(any(joint["identifiable"].values()) for joint in one["joints"][:4])


def test_suggested_poses_stay_within_the_joints_limits(api: Any) -> None:
    home = np.degrees(KR5_ARC_HOME)
    limits = np.radians(np.column_stack([home - 3.0, home + np.where(np.arange(6) == 0, 1.0, 90.0)]))
    robot = make_robot(api, limits)
    found = planned(api, robot, random_poses=25, suggest_count=8)
    q = np.array([pose["joint_angles_deg"] for pose in found["poses"] + found["suggested_poses"]]) - home
    assert len(q) == 33
    assert np.all(q >= -3.0 - 1e-9)
    assert np.all(q[:, 0] <= 1.0 + 1e-9)
    assert np.all(q[:, 1:].max(axis=0) > 3.0)
    # Without limits they go to either side equally.
    free = planned(api, make_robot(api), random_poses=25, suggest_count=8)
    q = np.array([pose["joint_angles_deg"] for pose in free["poses"] + free["suggested_poses"]]) - home
    assert np.all(q.min(axis=0) < -3.0)
    assert np.all(q[:, 0].max() > 3.0)
    for changes in (
        {"sweeps": {"sweep_half_angle_deg": 4.0, "steps": 5, "joint_numbers": [1]}},
        {"poses": [{"joint_angles_deg": (home + 2.0).tolist()}]},
        {"home_deg": (home - 4.0).tolist(), "random_poses": 30},
    ):
        problem = assert_problem(ask(api, robot, **changes), 409, "joint_limits_exceeded")
        assert "joint 1" in problem["detail"]
        assert problem["advice"]


def test_refusals_say_what_to_do(api: Any) -> None:
    robot = make_robot(api)
    for changes, code in (
        ({}, "too_few_poses"),
        ({"poses": [{"joint_angles_deg": [0.0] * 5}]}, "joint_angles_inconsistent"),
        ({"home_deg": [0.0]}, "joint_angles_inconsistent"),
        ({"sweeps": {"joint_numbers": [7]}}, "joint_angles_inconsistent"),
        ({"random_poses": 5}, "too_few_poses"),
        ({"random_poses": 30, "T_flange_camera": np.diag([1.0, 1.0, -1.0, 1.0]).tolist()}, "invalid_matrix"),
    ):
        assert assert_problem(ask(api, robot, **changes), 409, code)["advice"], changes
    huge = api.make_target(columns=500, rows=500)
    assert_problem(ask(api, robot, target_id=huge, random_poses=30), 409, "plan_too_large")
    assert_problem(ask(api, "rob_nothing"), 404, "robot_not_found")
    assert_problem(
        ask(api, robot, target_id="tgt_nothing", random_poses=30), 422, "referenced_target_not_found"
    )


@pytest.mark.parametrize(
    "changes",
    [
        {"camera": {**CAMERA, "fx_px": 0.0}},
        {"camera": None},
        {"image_coverage": 0.0},
        {"noise_px": 0.0},
        {"suggest_count": 101},
        {"random_poses": -1},
        {"T_flange_camera": np.eye(3).tolist()},
        {"sweeps": {"steps": 2}},
        {"pose": []},
    ],
)
def test_wrong_fields_are_refused(api: Any, changes: dict[str, Any]) -> None:
    assert_problem(ask(api, make_robot(api), **changes), 422, "invalid_request")
