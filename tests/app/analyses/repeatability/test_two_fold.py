"""Poses seen from afar, whose tilt is ambiguous: reported by the measurement, excluded from figures."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from app.records.codec import calibration_document
from core import calibrate_points
from core.geometry.se3 import invert, so3_exp, transform
from core.targets.specification import TargetSpec
from tests.support.sessions.stored_sessions import CAMERA, Shot, Store, body, look, problem

BOARD = TargetSpec("chessboard", 6, 5, 10.0)
NOISE = 0.1


def session_of(api: Any, store: Store, distances_mm: list[float]) -> tuple[str, list[str]]:
    """A session that was given its camera; every pose from another distance, tilted by 30°."""
    rng = np.random.default_rng(51)
    target = api.make_target(columns=BOARD.columns, rows=BOARD.rows, pitch_mm=BOARD.pitch_mm)
    names = ("fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "p1", "p2", "k3")
    intrinsics = dict(zip(names, CAMERA.as_array().tolist(), strict=True))
    session = str(api.make_session(target, intrinsics=intrinsics))
    shots = []
    for cycle in range(1, 11):
        for index, distance in enumerate(distances_mm):
            R = so3_exp(math.radians(30.0) * np.array([math.cos(index), math.sin(index), 0.0]))
            T = transform(R, np.array([10.0, -5.0, distance]) - R @ BOARD.points_target().mean(axis=0))
            commanded = invert(T)
            true = transform(commanded[:3, :3], commanded[:3, 3] + rng.normal(0.0, 0.05, 3))
            points = look(rng, invert(true), board=BOARD, sigma_px=NOISE)
            shots.append(Shot(f"P{index + 1}", cycle, points, true))
    return session, store(api, session, shots)


def table(api: Any, session: str) -> Any:
    return api.client.get(f"/v1/sessions/{session}/repeatability", params={"estimator": "given"})


def test_a_pose_that_cannot_be_determined_is_excluded_by_name(api: Any, store: Store) -> None:
    session, ids = session_of(api, store, [600.0, 6500.0, 700.0])
    document = body(table(api, session))
    rows = {row["pose_id"]: row for row in document["poses"]}
    assert [rows[name]["cycles"] for name in ("P1", "P2", "P3")] == [10, 0, 10]
    assert {e["code"] for e in rows["P2"]["excluded"]} == {"pose_ambiguous"}
    assert {e["measurement_id"] for e in rows["P2"]["excluded"]} == set(ids[1::3])
    (warning,) = [w for w in document["warnings"] if w["code"] == "images_excluded"]
    assert "pose_ambiguous (10)" in warning["detail"]
    assert all(rows[name]["repeatability"]["rp_l_mm"] < 60.0 for name in ("P1", "P3"))  # flipped: 600


def test_a_session_of_such_poses_is_refused_with_advice(api: Any, store: Store) -> None:
    session, _ = session_of(api, store, [6500.0])
    refusal = problem(table(api, session), 409, "pose_ambiguous")
    assert "nearer" in refusal["advice"]


def test_the_measurement_reports_the_ratio() -> None:
    rng = np.random.default_rng(52)
    R = so3_exp(np.array([0.5, 0.1, 0.0]))
    documents = []
    for distance in (300.0, 4000.0):
        T = transform(R, np.array([0.0, 0.0, distance]) - R @ BOARD.points_target().mean(axis=0))
        points = look(rng, T, board=BOARD, sigma_px=NOISE)
        documents.append(calibration_document(calibrate_points(points, intrinsics=CAMERA)))
    near, far = documents
    assert (
        near["observability"]["ambiguity_log_likelihood_ratio"] is None
        or near["observability"]["ambiguity_log_likelihood_ratio"] > 50.0
    )
    assert far["observability"]["ambiguity_log_likelihood_ratio"] < 5.0
    assert "pose_ambiguous" in {w["code"] for w in far["warnings"]}
    assert "pose_ambiguous" not in {w["code"] for w in near["warnings"]}
