"""Robots that are measured and identified over HTTP."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from app.api.schemas.analyses import DhAnalysis
from app.cli.demo.session import joint_rows
from core.geometry.se3 import invert
from core.kinematics.dh import Chain, forward
from core.kinematics.pose_observations import PoseData
from core.simulation.arm import KR5_ARC, KR5_ARC_HOME, Arm, free_angles, kr5_arc, sweep_angles
from tests.support.sessions.stored_sessions import (
    body,
)
from tests.support.simulation.simulated_poses import Repeatability, measure_poses

NAMES = ("a_mm", "alpha_deg", "d_mm", "theta_offset_deg")


ROBOT = Repeatability(0.05, math.radians(0.004))


def make_robot(api: Any, chain: Chain = KR5_ARC) -> str:
    response = api.client.post("/v1/robots", json={"name": "KR5", "joints": joint_rows(chain)})
    assert response.status_code == 201, response.text
    return str(response.json()["id"])


def measured(seed: int = 1, *, arc_deg: float = 40.0, free: int = 20, **options: Any) -> tuple[Arm, PoseData]:
    """A KR5 as built, swept joint by joint and moved freely, and what a laser tracker reads of it."""
    rng = np.random.default_rng(seed)
    arm = kr5_arc(rng)
    q = sweep_angles(KR5_ARC_HOME, half_arc=math.radians(arc_deg), steps=9)
    q = np.concatenate([q, free_angles(rng, KR5_ARC_HOME, free)])
    return arm, measure_poses(arm, q, rng, estimator="given", robot=ROBOT, **options)


def readings(poses: PoseData, **changes: Any) -> list[dict[str, Any]]:
    assert poses.rotations is not None
    assert poses.covariance is not None
    return [
        {
            "pose_id": poses.label(i),
            "cycle": 1,
            "joint_angles_deg": np.degrees(poses.joint_angles[i]).tolist(),
            "position_mm": poses.positions_mm[i].tolist(),
            "rotation": poses.rotations[i].tolist(),
            "covariance": poses.covariance[i].tolist(),
            **changes,
        }
        for i in range(len(poses))
    ]


def get(api: Any, session: str, **query: Any) -> Any:
    return api.client.get(f"/v1/sessions/{session}/dh", params=query)


def of_readings(api: Any, session: str, **query: Any) -> Any:
    return get(api, session, source="measured_poses", **query)


def document(response: Any) -> dict[str, Any]:
    """The document, checked for what every one of them keeps."""
    found = body(response)
    DhAnalysis.model_validate(found, extra="forbid")
    assert found["convention"] == "classic_dh"
    assert [j["joint"] for j in found["joints"]] == list(range(1, len(found["joints"]) + 1))
    for joint in found["joints"]:
        for name, identifiable in joint["identifiable"].items():
            assert (joint["standard_uncertainty"][name] is not None) == identifiable
        assert (joint["beta_deg"] is not None) == joint["parallel_to_next"]
        if joint["nominal"] is not None:
            for name in NAMES:
                assert joint["identifiable"][name] or joint[name] == pytest.approx(joint["nominal"][name])
    size = len(found["parameters"])
    assert np.array(found["correlation"]).shape == (size, size)
    assert found["null_space"]
    return found


def chain_of(found: dict[str, Any]) -> Chain:
    return Chain.from_array(
        np.array(
            [
                [
                    j["a_mm"],
                    math.radians(j["alpha_deg"]),
                    j["d_mm"],
                    math.radians(j["theta_offset_deg"]),
                    math.radians(j["beta_deg"] or 0.0),
                ]
                for j in found["joints"]
            ]
        )
    )


def error_mm(found: dict[str, Any], arm: Arm, q: Any, target: int = 0) -> float:
    """Rms distance, over configurations, of where the camera is said to be from where it was."""
    T = invert(np.array(found["base_targets"][target]["T_base_target"])) @ forward(chain_of(found), q)
    T = T @ np.array(found["flange_camera"]["T_flange_camera"])
    true = arm.camera_poses(q, np.full(len(q), target))
    return float(np.sqrt(np.mean(np.sum((T[:, :3, 3] - true[:, :3, 3]) ** 2, axis=1))))
