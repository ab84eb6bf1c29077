"""Robots over HTTP: nominal parameters, and names and limits of joints where their maker gives them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

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
    told = {"name": "A1", "minimum_deg": -155.0, "maximum_deg": 155.0}
    created = make(api, told, {}, {"name": "A3"}, {"minimum_deg": -15.0, "maximum_deg": 158.0})
    assert created.status_code == 201
    robot = created.json()
    unknown = {"name": None, "minimum_deg": None, "maximum_deg": None}
    plain = {**PLAIN, "theta_offset_deg": 0.0}
    assert robot["joints"] == [
        {**plain, **told},
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
    ],
)
def test_names_and_limits_that_cannot_be_are_refused(
    api: Any, joints: list[dict[str, Any]], field: str
) -> None:
    problem = assert_problem(make(api, *joints), 422, "invalid_joints")
    assert [error["field"] for error in problem["errors"]] == [field]
    assert problem["advice"]


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
