"""Robots over HTTP: nominal parameters, and names and limits of joints where their maker gives them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from app.services.plausibility import MAX_PARALLEL
from core.kinematics.dh import PARALLEL_AT_MOST
from tests.support.service.service import Api, ApiMaker, assert_problem

PLAIN = {"a_mm": 180.0, "alpha_deg": -90.0, "d_mm": 400.0}


@pytest.fixture(scope="module")
def api(open_api: ApiMaker) -> Iterator[Api]:
    """One application for all tests here: none counts what is stored."""
    with open_api() as running:
        yield running


def make(api: Any, *joints: dict[str, Any]) -> Any:
    return api.client.post(
        "/v1/robots", json={"name": "R", "joints": [{**PLAIN, **joint} for joint in joints]}
    )


def test_names_and_limits_are_kept_and_what_is_not_known_is_null(api: Any) -> None:
    stated = {"name": "A1", "minimum_deg": -155.0, "maximum_deg": 155.0}
    created = make(api, stated, {}, {"name": "A3"}, {"minimum_deg": -15.0, "maximum_deg": 158.0})
    assert created.status_code == 201
    robot = created.json()
    unknown = {"name": None, "minimum_deg": None, "maximum_deg": None}
    plain = {**PLAIN, "theta_offset_deg": 0.0, "beta_deg": None}
    assert robot["joints"] == [
        {**plain, **stated},
        {**plain, **unknown},
        {**plain, **unknown, "name": "A3"},
        {**plain, **unknown, "minimum_deg": -15.0, "maximum_deg": 158.0},
    ]
    assert api.client.get(f"/v1/robots/{robot['id']}").json() == robot
    assert robot in api.client.get("/v1/robots").json()["items"]


@pytest.mark.parametrize(
    ("joints", "field"),
    [
        ([{"name": "A"}, {"name": "B"}, {"name": "A"}], "joints.2.name"),
        ([{"minimum_deg": 10.0, "maximum_deg": 10.0}], "joints.0.maximum_deg"),
        ([{}, {"minimum_deg": 10.0, "maximum_deg": -10.0}], "joints.1.maximum_deg"),
        ([{"minimum_deg": 10.0}], "joints.0.maximum_deg"),
        ([{"maximum_deg": 10.0}], "joints.0.minimum_deg"),
        ([{"beta_deg": 0.1}, {}], "joints.0.beta_deg"),
        ([{"alpha_deg": 11.6, "beta_deg": 0.1}, {}], "joints.0.beta_deg"),
        ([{"alpha_deg": 0.0, "beta_deg": 11.6}, {}], "joints.0.beta_deg"),
        ([{"alpha_deg": 0.0, "beta_deg": 180.0}, {}], "joints.0.beta_deg"),
        ([{}, {"alpha_deg": 0.0, "beta_deg": 0.1}], "joints.1.beta_deg"),
    ],
)
def test_names_and_limits_that_cannot_be_are_refused(
    api: Any, joints: list[dict[str, Any]], field: str
) -> None:
    problem = assert_problem(make(api, *joints), 422, "invalid_joints")
    assert [error["field"] for error in problem["errors"]] == [field]
    assert problem["advice"]


def test_nearly_parallel_axes_may_have_a_second_turn(api: Any) -> None:
    assert MAX_PARALLEL == PARALLEL_AT_MOST
    robot = make(
        api, {"alpha_deg": 0.03, "beta_deg": -0.04}, {"alpha_deg": -179.98, "beta_deg": 0.1}, {}
    ).json()
    assert [joint["beta_deg"] for joint in robot["joints"]] == [-0.04, 0.1, None]
    assert api.client.get(f"/v1/robots/{robot['id']}").json() == robot
    assert make(api, {"beta_deg": 0.0}).status_code == 201


@pytest.mark.parametrize(
    "joint",
    [
        {"name": ""},
        {"name": 3},
        {"name": "a\nb"},
        {"name": "A\u202e1"},
        {"minimum_deg": "1"},
        {"minimum_deg": 1e9},
        {"limits_deg": [0, 1]},
    ],
)
def test_wrong_fields_are_refused(api: Any, joint: dict[str, Any]) -> None:
    assert_problem(make(api, joint), 422, "invalid_request")


def test_a_robot_is_changed_field_by_field(api: Any) -> None:
    robot = make(api, {"name": "A1"}).json()
    address = f"/v1/robots/{robot['id']}"
    stated = {
        "manufacturer": "KUKA",
        "model": "KR 5 arc",
        "serial_number": "412",
        "datasheet_accuracy_mm": 0.4,
    }
    changed = api.client.patch(address, json=stated)
    assert changed.status_code == 200
    assert changed.json() == {**robot, **stated}
    joints = [{**PLAIN, "d_mm": 410.0, "name": "J1"}]
    changed = api.client.patch(address, json={"joints": joints, "model": None})
    assert (changed.json()["joints"][0]["d_mm"], changed.json()["model"]) == (410.0, None)
    assert api.client.get(address).json() == changed.json()
    assert api.client.patch(address, json={}).json() == changed.json()


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"name": None}, "invalid_request"),
        ({"joints": None}, "invalid_request"),
        ({"joints": []}, "invalid_request"),
        ({"datasheet_accuracy_mm": -1.0}, "invalid_request"),
        ({"serial": "1"}, "invalid_request"),
        ({"joints": [{**PLAIN, "name": "A"}, {**PLAIN, "name": "A"}]}, "invalid_joints"),
        ({"joints": [{"a_mm": 0.18, "alpha_deg": -90.0, "d_mm": 0.4}]}, "implausible_unit"),
    ],
)
def test_a_change_that_cannot_be_is_refused_and_changes_nothing(
    api: Any, change: dict[str, Any], code: str
) -> None:
    robot = make(api, {}).json()
    assert_problem(api.client.patch(f"/v1/robots/{robot['id']}", json=change), 422, code)
    assert api.client.get(f"/v1/robots/{robot['id']}").json() == robot


def test_a_robot_that_is_not_there_cannot_be_changed(api: Any) -> None:
    assert_problem(api.client.patch(f"/v1/robots/rob_{'0' * 26}", json={"name": "R"}), 404, "robot_not_found")


COUPLED = [[1.0, 0.0], [-1.0, 1.0]]


def test_a_coupling_fits_the_joints_and_can_be_changed(api: Any) -> None:
    robot = make(api, {}, {}).json()
    address = f"/v1/robots/{robot['id']}"
    assert robot["joint_coupling"] is None
    assert api.client.patch(address, json={"joint_coupling": COUPLED}).json()["joint_coupling"] == COUPLED
    # Joints that no longer fit are refused, both together are taken.
    three = [{**PLAIN}, {**PLAIN}, {**PLAIN}]
    assert_problem(api.client.patch(address, json={"joints": three}), 422, "invalid_joint_coupling")
    changed = api.client.patch(address, json={"joints": three, "joint_coupling": None})
    assert (len(changed.json()["joints"]), changed.json()["joint_coupling"]) == (3, None)


@pytest.mark.parametrize(
    "coupling", [[[1.0]], [[1.0, 0.0], [1.0]], [[1.0, 1.0], [1.0, 1.0]], [[0.0, 0.0], [0.0, 0.0]]]
)
def test_a_coupling_that_cannot_be_is_refused(api: Any, coupling: list[list[float]]) -> None:
    robot = make(api, {}, {}).json()
    change = {"joint_coupling": coupling}
    assert_problem(api.client.patch(f"/v1/robots/{robot['id']}", json=change), 422, "invalid_joint_coupling")
    body = {"name": "R", "joints": [PLAIN, PLAIN], **change}
    assert_problem(api.client.post("/v1/robots", json=body), 422, "invalid_joint_coupling")
