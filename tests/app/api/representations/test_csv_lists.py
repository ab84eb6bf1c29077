"""Commanded and measured poses as CSV: the same as the JSON list, or refused with the place."""

from __future__ import annotations

from typing import Any

import pytest

HEADERS = {"Content-Type": "text/csv; charset=utf-8"}
POSES = (
    "pose_id,position_x_mm,position_y_mm,position_z_mm,roll_deg,joint_angles_deg,approach\r\n"
    'P1,1.5,-2,3e2,90,"0,10.5,-20",+x\r\n'
    "'-P2,,,,,,\r\n"
)


def send(api: Any, session: str, kind: str, text: str | bytes) -> Any:
    return api.client.post(f"/v1/sessions/{session}/{kind}", content=text, headers=HEADERS)


def test_commanded_poses_come_from_a_spreadsheet(api: Any) -> None:
    session = api.make_session()
    response = send(api, session, "poses", "\ufeff" + POSES)
    assert response.status_code == 200, response.text
    first, second = response.json()["items"]
    nothing = dict.fromkeys(
        ("position_mm", "roll_deg", "pitch_deg", "yaw_deg", "joint_angles_deg", "approach")
    )
    assert first == {
        **nothing,
        "pose_id": "P1",
        "position_mm": [1.5, -2.0, 300.0],
        "roll_deg": 90.0,
        "joint_angles_deg": [0.0, 10.5, -20.0],
        "approach": "+x",
    }
    assert second == {**nothing, "pose_id": "-P2"}
    listed = api.client.get(f"/v1/sessions/{session}/poses").json()["items"]
    assert listed == [first, second]


def test_measured_poses_come_from_a_spreadsheet(api: Any) -> None:
    session = api.make_session()
    text = "pose_id,cycle,position_mm,rotation,covariance\nP1,2,1 2 3,1 0 0; 0 1 0; 0 0 1,\n"
    response = send(api, session, "measured-poses", text)
    assert response.status_code == 200, response.text
    (item,) = response.json()["items"]
    assert (item["cycle"], item["position_mm"], item["covariance"]) == (2, [1.0, 2.0, 3.0], None)
    assert item["rotation"] == [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("", "invalid_csv"),
        (b"\xff\xfe", "invalid_csv"),
        ("pose_id,roll_deg\nP1\n", "invalid_csv"),
        ("pose_id,pose_id\nP1,P1\n", "invalid_csv"),
        ("pose_id,position_x_mm\nP1,1\n", "invalid_csv"),
        ('pose_id\n"P1\n', "invalid_csv"),
        ("pose_id,roll\nP1,1\n", "invalid_request"),
        ("pose_id,roll_deg\nP1,x\n", "invalid_request"),
        ("pose_id,roll_deg\nP1,nan\n", "invalid_request"),
        ("pose_id,position_mm\nP1,1 2\n", "invalid_request"),
        ("roll_deg\n1\n", "invalid_request"),
        ("pose_id\nP1\nP1\n", "duplicate_pose"),
    ],
)
def test_a_table_that_cannot_be_is_refused_and_nothing_stored(api: Any, text: str, code: str) -> None:
    session = api.make_session()
    response = send(api, session, "poses", text)
    assert (response.status_code, response.json()["code"]) == (422, code)
    assert response.json()["errors"]
    assert api.client.get(f"/v1/sessions/{session}/poses").json()["items"] == []


def test_other_lists_take_json_alone(api: Any) -> None:
    response = send(api, api.make_session(), "images/missing", "pose_id\nP1\n")
    assert response.status_code == 415
