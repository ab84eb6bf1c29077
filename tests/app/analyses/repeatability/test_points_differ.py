"""Poses whose images show different grid points: estimated from common ones, or not said to speak of the robot."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from tests.support.sessions.stored_sessions import Shot, Store, body, new_session, shoot


def hidden(shot: Shot, columns: range) -> Shot:
    """The same image with some columns of the board hidden."""
    points = shot.points
    assert points is not None
    keep = np.array([c not in columns for c in points.column])
    return dataclasses.replace(
        shot,
        points=points.take(keep),
    )


def test_a_pose_with_too_little_in_common_is_named_and_its_verdict_capped(api: Any, store: Store) -> None:
    shots = shoot(seed=41, poses=3, cycles=12, repeatability_mm=1.0)
    seen = []
    for shot in shots:
        assert shot.cycle is not None
        if shot.pose_id == "P2":  # left or right part, nothing in common but three columns
            shot = hidden(shot, range(6, 9) if shot.cycle % 2 else range(3))
        elif shot.pose_id == "P3":  # most is common
            shot = hidden(shot, range(6, 9)) if shot.cycle % 2 else shot
        seen.append(shot)
    session = new_session(api)
    store(api, session, seen)
    document = body(api.client.get(f"/v1/sessions/{session}/repeatability"))
    (warning,) = [w for w in document["warnings"] if w["code"] == "repeats_inconsistent"]
    assert "P2" in warning["detail"]
    assert "P1" not in warning["detail"]
    assert "P3" not in warning["detail"]
    rows = {row["pose_id"]: row for row in document["poses"]}
    assert [rows[name]["verdict"] for name in ("P1", "P2", "P3")] == ["robot", "instrument_limited", "robot"]
    assert all(row["cycles"] == 12 for row in rows.values())
    # What of the reading is the instrument's is not known there: nothing is taken off.
    assert rows["P2"]["corrected"] == rows["P2"]["repeatability"]
    assert rows["P1"]["corrected"] != rows["P1"]["repeatability"]
