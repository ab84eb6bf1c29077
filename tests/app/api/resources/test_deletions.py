"""Targets, robots and measured poses are deleted where nothing refers to them, and refused where something does."""

from __future__ import annotations

from typing import Any

import pytest

from tests.support.service.service import assert_problem

JOINT = {"a_mm": 100.0, "alpha_deg": 90.0, "d_mm": 0.0}


def reading(pose_id: str, cycle: int | None) -> dict[str, Any]:
    return {"pose_id": pose_id, "cycle": cycle, "position_mm": [1.0, 2.0, 3.0]}


def test_a_target_goes_when_no_session_looks_at_it(any_api: Any, grey_png: bytes) -> None:
    target_id, other = any_api.make_target(), any_api.make_target()
    session_id = any_api.make_session(target_id)
    address = f"/v1/targets/{target_id}"
    problem = assert_problem(any_api.client.delete(address), 409, "target_in_use")
    assert problem["errors"] == [{"field": "session_id", "message": session_id}]
    assert "target_ids" in problem["advice"]
    any_api.put_image(session_id, grey_png)
    change = {"target_ids": [other]}
    assert any_api.client.patch(f"/v1/sessions/{session_id}", json=change).status_code == 200
    assert_problem(any_api.client.delete(address), 409, "target_in_use")  # its image waits for the new search
    assert any_api.client.get(address).status_code == 200
    assert any_api.client.delete(f"/v1/sessions/{session_id}").status_code == 204
    deleted = any_api.client.delete(address)
    assert (deleted.status_code, deleted.content) == (204, b"")
    assert "content-type" not in deleted.headers
    assert any_api.client.get(address).status_code == 404
    assert_problem(any_api.client.delete(address), 404, "target_not_found")


def test_a_robot_goes_when_no_session_names_it(any_api: Any) -> None:
    robot_id = any_api.client.post("/v1/robots", json={"name": "r", "joints": [JOINT]}).json()["id"]
    session_id = any_api.make_session(robot_id=robot_id)
    address = f"/v1/robots/{robot_id}"
    problem = assert_problem(any_api.client.delete(address), 409, "robot_in_use")
    assert problem["errors"] == [{"field": "session_id", "message": session_id}]
    change = {"robot_id": None}
    assert any_api.client.patch(f"/v1/sessions/{session_id}", json=change).status_code == 200
    assert any_api.client.delete(address).status_code == 204
    assert_problem(any_api.client.get(address), 404, "robot_not_found")
    found = any_api.client.get("/v1/audit", params={"object_id": robot_id}).json()["items"]
    assert [entry["action"] for entry in found] == ["create_robot", "delete_robot"]


@pytest.mark.parametrize(
    ("query", "left"),
    [
        ({}, []),
        ({"pose_id": "P1"}, [("P2", 1), ("P2", None)]),
        ({"cycle": 1}, [("P1", 2), ("P2", None)]),
        ({"pose_id": "P2", "cycle": 1}, [("P1", 1), ("P1", 2), ("P2", None)]),
        ({"pose_id": "P9"}, [("P1", 1), ("P1", 2), ("P2", 1), ("P2", None)]),
    ],
)
def test_measured_poses_go_all_or_by_pose_and_cycle(
    any_api: Any, query: dict[str, Any], left: list[Any]
) -> None:
    session_id, other = any_api.make_session(), any_api.make_session()
    stored = [reading("P1", 1), reading("P1", 2), reading("P2", 1), reading("P2", None)]
    for each in (session_id, other):
        address = f"/v1/sessions/{each}/measured-poses"
        assert any_api.client.post(address, json=stored).status_code == 200
    address = f"/v1/sessions/{session_id}/measured-poses"
    deleted = any_api.client.delete(address, params=query)
    assert (deleted.status_code, deleted.json()) == (200, {"deleted": 4 - len(left)})
    found = any_api.client.get(address).json()["items"]
    assert [(each["pose_id"], each["cycle"]) for each in found] == left
    assert len(any_api.client.get(f"/v1/sessions/{other}/measured-poses").json()["items"]) == 4


@pytest.mark.parametrize("query", [{"pose": "P1"}, {"cycle": "0"}, {"cycle": "x"}, {"pose_id": "/"}])
def test_a_misspelt_deletion_deletes_nothing(api: Any, query: dict[str, str]) -> None:
    address = f"/v1/sessions/{api.make_session()}/measured-poses"
    api.client.post(address, json=[reading("P1", 1)])
    assert_problem(api.client.delete(address, params=query), 422, "invalid_request")
    assert len(api.client.get(address).json()["items"]) == 1


def test_a_wrong_reading_is_corrected_as_the_advice_says(any_api: Any) -> None:
    address = f"/v1/sessions/{any_api.make_session()}/measured-poses"
    wrong, right = reading("P1", 1), {**reading("P1", 1), "position_mm": [1.0, 2.0, 3.5]}
    any_api.client.post(address, json=[wrong])
    problem = assert_problem(any_api.client.post(address, json=[right]), 409, "measured_pose_conflict")
    assert "measured-poses delete" in problem["advice"]
    assert any_api.client.delete(address, params={"pose_id": "P1", "cycle": 1}).json() == {"deleted": 1}
    assert any_api.client.post(address, json=[right]).status_code == 200
