"""A session whose camera is fixed, over HTTP: what is answered of it, and under which names."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import yaml

from app.api.schemas.analyses import DhAnalysis, HandEyeAnalysis
from app.client.commands.exports.hand_eye import _content, _ros, _yaml
from app.reports.forms.kinematics import kinematics_blocks
from core.geometry import invert
from core.kinematics import forward
from core.simulation.arm import KR5_ARC_HOME, Arm, free_angles, kr5_arc, sweep_angles
from tests.support.sessions.kinematics import make_robot
from tests.support.sessions.robot_session import in_view
from tests.support.sessions.stored_sessions import (
    Shot,
    body,
    commanded_pose,
    draw_board_pose,
    look,
    new_session,
    store_shots,
)


@dataclass(frozen=True)
class FixedCamera:
    """A session of a fixed camera, with the truth: the arm has the target in the camera's place."""

    api: Any
    id: str
    arm: Arm

    def get(self, analysis: str, **query: str) -> Any:
        return body(self.api.client.get(f"/v1/sessions/{self.id}/{analysis}", params=query))


@pytest.fixture(scope="module")
def fixed(api: Any) -> FixedCamera:
    """A KR5 that carries a board before a fixed camera: swept joint by joint and moved freely, each pose twice."""
    rng = np.random.default_rng(8)
    arm = kr5_arc(rng)
    at_home = forward(arm.chain, KR5_ARC_HOME[None])[0] @ arm.T_flange_camera
    T_camera_base = draw_board_pose(rng, 25.0) @ invert(at_home)
    arm = Arm(arm.chain, T_camera_base[None], arm.T_flange_camera)
    half_range = math.radians(8.0)
    q = np.concatenate(
        [
            sweep_angles(KR5_ARC_HOME, half_arc=half_range, steps=3),
            free_angles(rng, KR5_ARC_HOME, 16, half_range=half_range),
        ]
    )
    session = new_session(api, robot_id=make_robot(api), camera_mount="fixed")
    stated = [
        {
            "pose_id": f"P{i + 1}",
            **commanded_pose(T),
            "joint_angles_deg": np.degrees(angles).tolist(),
        }
        for i, (angles, T) in enumerate(zip(q, forward(arm.chain, q), strict=True))
    ]
    assert api.client.post(f"/v1/sessions/{session}/poses", json=stated).status_code == 200
    shots = []
    for cycle in (1, 2):
        for i, T in enumerate(arm.camera_poses(q, np.zeros(len(q), dtype=np.intp))):
            shot = Shot(f"P{i + 1}", cycle, look(rng, T), invert(T))
            shots.append(dataclasses.replace(shot, points=in_view(shot)))
    store_shots(api, session, shots)
    return FixedCamera(api, session, arm)


def assert_near(found: Any, truth: Any, mm: float, rad: float) -> None:
    T = np.array(found) @ invert(truth)
    assert np.linalg.norm(np.array(found)[:3, 3] - truth[:3, 3]) < mm
    assert np.linalg.norm(T[:3, :3] - np.eye(3)) < rad


def test_hand_eye_names_the_camera_in_the_base_and_the_target_on_the_flange(fixed: FixedCamera) -> None:
    found = fixed.get("hand-eye")
    HandEyeAnalysis.model_validate(found, extra="forbid")
    assert (found["flange_camera"], found["base_targets"]) == (None, [])
    assert found["subject"]["camera_mount"] == "fixed"
    (target,) = found["flange_targets"]
    assert_near(found["base_camera"]["T_base_camera"], invert(fixed.arm.T_target_base[0]), 5.0, 0.01)
    assert_near(target["T_flange_target"], fixed.arm.T_flange_camera, 5.0, 0.01)
    lines = [line for line in _ros(found, "tool0", "cam", "base", "board").splitlines() if line[0] != "#"]
    assert [line.split("--frame-id ")[1] for line in lines] == [
        "base --child-frame-id cam",
        "tool0 --child-frame-id board",
    ]
    content = yaml.safe_load(_yaml(_content(found)))
    assert "T_flange_camera" not in content
    assert content["T_base_camera"]["matrix"] == found["base_camera"]["T_base_camera"]


def test_identification_has_the_fixed_camera_in_the_base(fixed: FixedCamera) -> None:
    found = fixed.get("dh", model="dh")
    DhAnalysis.model_validate(found, extra="forbid")
    assert (found["flange_camera"], found["base_targets"]) == (None, [])
    # What the nominal robot holds of the first and the last joint is free to move base and flange.
    assert_near(found["base_camera"]["T_base_camera"], invert(fixed.arm.T_target_base[0]), 25.0, 0.05)
    assert_near(found["flange_targets"][0]["T_flange_target"], fixed.arm.T_flange_camera, 25.0, 0.05)
    assert not any(name.startswith(("flange_camera", "target_base")) for name in found["parameters"])
    assert found["validation"]["position_rms_mm"] < 2.0
    named = {**found, "flange_targets": [{**one, "named": "Board"} for one in found["flange_targets"]]}
    shown = str(kinematics_blocks(named, {"images": [], "measured_poses": []}))
    assert "Fixed camera in the base frame" in shown
    assert "Target Board in the flange's frame" in shown


@pytest.mark.parametrize("purpose", ["hand_eye", "dh"])
def test_next_views_have_the_flange_and_the_joints_that_take_the_target_there(
    fixed: FixedCamera, purpose: str
) -> None:
    asked = {"purpose": purpose, "count": 2}
    found = body(fixed.api.client.post(f"/v1/sessions/{fixed.id}/next-view", json=asked))
    for view in found["suggestions"]:
        T_camera_target = fixed.arm.camera_poses(
            np.radians([view["joint_angles_deg"]]), np.zeros(1, dtype=np.intp)
        )[0]
        assert_near(invert(np.array(view["T_target_camera"])), T_camera_target, 8.0, 0.03)
        if purpose == "hand_eye":
            flange = forward(fixed.arm.chain, np.radians([view["joint_angles_deg"]]))[0]
            assert_near(view["T_base_flange"], flange, 5.0, 0.02)


def test_the_mount_alone_changes_answers_and_no_pose(fixed: FixedCamera) -> None:
    address = f"/v1/sessions/{fixed.id}"
    poses = fixed.api.client.get(f"{address}/poses").json()
    before = fixed.get("hand-eye")["inputs_sha256"]
    assert body(fixed.api.client.patch(address, json={"camera_mount": "robot"}))["camera_mount"] == "robot"
    try:
        refused = fixed.api.client.get(f"{address}/hand-eye").json()
        assert refused["code"] == "not_converged"
        assert "camera_mount to fixed" in refused["advice"]
        assert fixed.api.client.get(f"{address}/poses").json() == poses
    finally:
        fixed.api.client.patch(address, json={"camera_mount": "fixed"})
    assert fixed.get("hand-eye")["inputs_sha256"] == before
    assert fixed.api.client.patch(address, json={"camera_mount": None}).status_code == 422
