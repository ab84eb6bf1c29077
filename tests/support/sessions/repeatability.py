"""Requests for the table of repeatability, and a robot that misses what it is commanded."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from app.api.schemas.analyses import RepeatabilityAnalysis
from core.geometry.se3 import compose, invert, so3_exp, transform
from tests.support.sessions.stored_sessions import (
    Shot,
    body,
    commanded_pose,
    draw_board_pose,
    look,
    put_pose,
)

KEYS = ["rp_l_mm", "rp_x_mm", "rp_y_mm", "rp_z_mm", "rp_roll_deg", "rp_pitch_deg", "rp_yaw_deg"]


def get(api: Any, session: str, **query: Any) -> Any:
    return api.client.get(f"/v1/sessions/{session}/repeatability", params=query)


def table(api: Any, session: str, **query: Any) -> dict[str, Any]:
    """The document, checked for what every one of them keeps."""
    document = body(get(api, session, **query))
    RepeatabilityAnalysis.model_validate(document, extra="forbid")
    for row in document["poses"]:
        for part in ("repeatability", "interval", "noise_floor", "corrected"):
            assert list(row[part]) == KEYS
            assert (None in row[part].values()) == (row["cycles"] < 2)
        assert list(row["corrected_interval"]) == KEYS
        assert (row["without_outliers"] is None) == (row["outliers"] == [])
        if row["within_stops"] is None:
            assert len(row["measurement_ids"]) == row["cycles"]
        assert (row["verdict"] == "too_few_cycles") == (row["cycles"] < 10)
        for name in KEYS if row["cycles"] > 1 else ():
            low, high = row["interval"][name]
            assert 0 <= low <= row["repeatability"][name] <= high
            assert row["corrected"][name] <= row["repeatability"][name]
    return document


def command(api: Any, session: str, commanded: dict[str, Any], *, angles: bool = True) -> None:
    """Store the commanded poses, in the robot's base frame."""
    for pose_id, T in commanded.items():
        fields = commanded_pose(T) if angles else {"position_mm": T[:3, 3].tolist()}
        put_pose(api, session, pose_id, fields)


T_FLANGE_CAMERA = transform(so3_exp(np.array([0.1, 0.2, -0.5])), np.array([30.0, -20.0, 60.0]))
T_BASE_TARGET = transform(so3_exp(np.array([0.0, math.pi, 0.3])), np.array([800.0, 50.0, 200.0]))


def deviating_robot(
    seed: int, poses: int, deviation_mm: float
) -> tuple[list[Shot], dict[str, Any], dict[str, Any]]:
    """Images of poses all round the board, what was commanded, and by how much the robot was off at each."""
    rng = np.random.default_rng(seed)
    shots, commanded, off = [], {}, {}
    for index in range(poses):
        name = f"P{index + 1}"
        T_target_camera = invert(draw_board_pose(rng, 30.0))
        attained = compose(T_BASE_TARGET, T_target_camera, invert(T_FLANGE_CAMERA))
        off[name] = rng.normal(0.0, deviation_mm, 3)
        commanded[name] = transform(attained[:3, :3], attained[:3, 3] - off[name])
        for cycle in range(1, 6):
            true = transform(T_target_camera[:3, :3], T_target_camera[:3, 3] + rng.normal(0.0, 0.02, 3))
            shots.append(Shot(name, cycle, look(rng, invert(true)), true))
    return shots, commanded, off
