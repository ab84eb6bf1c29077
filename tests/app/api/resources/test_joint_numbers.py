"""Joint angles that are not as many as the robot's joints are refused wherever they are stated."""

from __future__ import annotations

from typing import Any

from tests.support.service.service import assert_problem

CODE = "joint_angles_inconsistent"


def test_angles_are_as_many_as_the_robot_s_joints(any_api: Any, grey_png: bytes) -> None:
    api = any_api
    session = f"/v1/sessions/{api.make_session(robot_id=api.make_robot())}"
    session_id = session.rpartition("/")[2]
    wrong, right = {"joint_angles_deg": [100.0, 20.0]}, {"joint_angles_deg": [100.0]}
    assert_problem(api.client.put(f"{session}/poses/P1", json=wrong), 422, CODE)
    listed = [{"pose_id": "P1", **right}, {"pose_id": "P2", **wrong}]
    refused = assert_problem(api.client.post(f"{session}/poses", json=listed), 422, CODE)
    assert [error["field"] for error in refused["errors"]] == ["1.joint_angles_deg"]
    assert_problem(api.put_image(session_id, grey_png, joint_angles_deg="100,20"), 422, CODE)
    assert api.measurements(session_id) == []
    assert api.client.get(f"{session}/poses").json()["items"] == []
    accepted = api.put_image(session_id, grey_png, joint_angles_deg="100")
    assert accepted.status_code == 202
    address = f"/v1/measurements/{accepted.json()['id']}"
    assert_problem(api.client.patch(address, json=wrong), 422, CODE)
    assert api.client.patch(address, json=right).status_code == 200
    assert api.client.put(f"{session}/poses/P1", json=right).status_code == 200
    # Where no robot is known, any number may be right.
    free = api.make_session()
    assert api.client.put(f"/v1/sessions/{free}/poses/P1", json=wrong).status_code == 201
