"""Values that are almost surely in another unit are refused with the guess, unless the client insists."""

from __future__ import annotations

import math
from typing import Any

import pytest

from tests.support.service.service import TARGET

JOINT = {"a_mm": 180.0, "alpha_deg": -90.0, "d_mm": 400.0}
INSIST = {"accept_implausible": "true"}


@pytest.mark.parametrize(
    ("joints", "field", "guess"),
    [
        ([{**JOINT, "alpha_deg": math.pi / 2}, {**JOINT, "alpha_deg": 0.0}], "joints.0.alpha_deg", "radians"),
        ([{**JOINT, "minimum_deg": -2.96, "maximum_deg": 2.96}], "joints.0.minimum_deg", "radians"),
        ([{**JOINT, "a_mm": 0.18}, {**JOINT, "a_mm": -0.6}], "joints.0.a_mm", "metres"),
    ],
)
def test_a_robot_in_radians_or_metres_is_refused(
    api: Any, joints: list[dict[str, float]], field: str, guess: str
) -> None:
    body = {"name": "R", "joints": joints}
    refused = api.client.post("/v1/robots", json=body)
    assert (refused.status_code, refused.json()["code"]) == (422, "implausible_unit")
    assert field in [error["field"] for error in refused.json()["errors"]]
    assert guess in refused.json()["detail"]
    assert "accept_implausible" in refused.json()["advice"]
    assert api.client.post("/v1/robots", json=body, params=INSIST).status_code == 201


@pytest.mark.parametrize(
    "joints",
    [
        [{**JOINT, "alpha_deg": 0.0}, {**JOINT, "alpha_deg": 0.02}],  # a SCARA as calibrated
        [{**JOINT, "a_mm": 0.0}],  # an arm whose axes all meet
        [{**JOINT, "minimum_deg": -170.0, "maximum_deg": 5.0}],
        [{**JOINT, "a_mm": 3.0}, JOINT],
    ],
)
def test_what_may_be_is_stored(api: Any, joints: list[dict[str, float]]) -> None:
    assert api.client.post("/v1/robots", json={"name": "R", "joints": joints}).status_code == 201


def test_a_pitch_in_metres_is_refused(api: Any) -> None:
    body = {**TARGET, "pitch_mm": 0.025}
    refused = api.client.post("/v1/targets", json=body)
    assert (refused.status_code, refused.json()["code"]) == (422, "implausible_unit")
    assert [error["field"] for error in refused.json()["errors"]] == ["pitch_mm"]
    assert "25 mm" in refused.json()["detail"]
    assert api.client.post("/v1/targets", json=body, params=INSIST).status_code == 201
    assert api.client.post("/v1/targets", json={**body, "pitch_mm": 0.2}).status_code == 201


@pytest.mark.parametrize(
    ("poses", "field", "guess"),
    [
        ([{"position_mm": [0.4, 0.1, 0.5]}, {"position_mm": [0.5, -0.1, 0.5]}], "0.position_mm", "400 mm"),
        (
            [{"joint_angles_deg": [0.0, -1.5708]}, {"joint_angles_deg": [0.2, -1.2]}],
            "1.joint_angles_deg",
            "-90°",
        ),
        (
            [{"roll_deg": 3.14159}, {"roll_deg": 3.14159, "pitch_deg": 0.0, "yaw_deg": 0.3}],
            "0.roll_deg",
            "180°",
        ),
        ([{"joint_angles_deg": [0.0, -1.57, 1.571, 0.0]}], "0.joint_angles_deg", "-89.95°"),
    ],
)
def test_commanded_poses_in_metres_or_radians_are_refused(
    api: Any, poses: list[dict[str, Any]], field: str, guess: str
) -> None:
    path = f"/v1/sessions/{api.make_session()}/poses"
    body = [{"pose_id": f"P{place}", **pose} for place, pose in enumerate(poses, start=1)]
    refused = api.client.post(path, json=body)
    assert (refused.status_code, refused.json()["code"]) == (422, "implausible_unit")
    assert field in [error["field"] for error in refused.json()["errors"]]
    assert guess in refused.json()["detail"]
    assert api.client.get(path).json()["items"] == []
    assert api.client.post(path, json=body, params=INSIST).status_code == 200


def test_one_commanded_pose_in_radians_is_refused(api: Any) -> None:
    path = f"/v1/sessions/{api.make_session()}/poses/P1"
    refused = api.client.put(path, json={"joint_angles_deg": [0.1, -1.5708, 1.2]})
    assert (refused.status_code, refused.json()["code"]) == (422, "implausible_unit")
    assert [error["field"] for error in refused.json()["errors"]] == ["joint_angles_deg"] * 3
    assert api.client.put(path, json={"joint_angles_deg": [0.1, -1.5708]}, params=INSIST).status_code == 201


@pytest.mark.parametrize(
    "poses",
    [
        [{"position_mm": [0.0, 0.0, 0.0]}, {"position_mm": [0.0, 0.0, 0.0]}],
        [{"position_mm": [1.0, 2.0, 3.0]}],
        [
            {"position_mm": [1.0, 2.0, 3.0], "yaw_deg": 2.0},
            {"position_mm": [400.0, 2.0, 3.0], "yaw_deg": 2.5},
        ],
        [{"joint_angles_deg": [0.0, 1.5]}, {"joint_angles_deg": [30.0, -1.0]}],
        [{"joint_angles_deg": [0.0, 5.0, 0.0]}],
        [{"roll_deg": 0.2, "pitch_deg": 1.5}, {"roll_deg": -0.1}],
        [{}, {}],
    ],
)
def test_plausible_poses_are_stored(api: Any, poses: list[dict[str, Any]]) -> None:
    path = f"/v1/sessions/{api.make_session()}/poses"
    body = [{"pose_id": f"P{place}", **pose} for place, pose in enumerate(poses, start=1)]
    assert api.client.post(path, json=body).status_code == 200


def test_the_services_address_leads_to_a_page_for_people(api: Any) -> None:
    response = api.client.get("/", headers={"Authorization": ""})
    assert response.status_code == 200
    assert response.headers["content-type"].startswith("text/html")
    assert response.url.path == "/ui/sign-in"
