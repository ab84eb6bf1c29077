"""Distances between poses and variation over approaches by HTTP: the truth, and nulls with their reasons."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from app.api.schemas.analyses import RepeatabilityAnalysis
from core.geometry.se3 import compose, invert, so3_exp, transform
from core.session.repeatability.performance import MAX_PAIRS
from tests.support.sessions.stored_sessions import (
    MEASURED_BOARD,
    Shot,
    Store,
    body,
    codes,
    commanded_pose,
    draw_board_pose,
    look,
    new_session,
    put_pose,
    shoot,
)

X = transform(so3_exp(np.array([0.1, 0.2, -0.5])), np.array([30.0, -20.0, 60.0]))
Z = transform(so3_exp(np.array([0.0, math.pi, 0.3])), np.array([800.0, 50.0, 200.0]))


def table(api: Any, session: str, **query: Any) -> dict[str, Any]:
    document = body(api.client.get(f"/v1/sessions/{session}/repeatability", params=query))
    RepeatabilityAnalysis.model_validate(document, extra="forbid")
    return document


def command(api: Any, session: str, pose_id: str, T: Any, **fields: Any) -> None:
    """Store the commanded pose of the robot whose camera is at T in the target frame."""
    put_pose(api, session, pose_id, commanded_pose(compose(Z, T, invert(X))) | fields)


def cube(rng: np.random.Generator) -> dict[str, Any]:
    """Two poses of one orientation, 50 mm apart, and one that is turned besides."""
    middle = invert(draw_board_pose(rng, 30.0))
    return {
        "P1": middle,
        "P2": compose(transform(np.eye(3), np.array([30.0, 0.0, -40.0])), middle),
        "P3": compose(
            transform(np.eye(3), np.array([20.0, 10.0, 20.0])),
            middle,
            transform(so3_exp(np.array([0.0, 0.1, 0.3])), np.zeros(3)),
        ),
    }


def visits(
    rng: np.random.Generator,
    poses: dict[str, Any],
    cycles: int,
    scatter_mm: float,
    off: dict[str, Any] | None = None,
) -> list[Shot]:
    shots = []
    for cycle in range(1, cycles + 1):
        for pose_id, T in poses.items():
            d = rng.normal(0.0, scatter_mm, 3) + ((off or {}).get(pose_id, 0.0))
            true = transform(T[:3, :3], T[:3, 3] + d)
            shots.append(Shot(pose_id, cycle, look(rng, invert(true)), true))
    return shots


def test_distances_by_cycle_against_the_commanded_ones(api: Any, store: Store) -> None:
    rng = np.random.default_rng(1)
    poses = cube(rng)
    session = new_session(api, MEASURED_BOARD)
    # The robot is .4 mm too far out at P2, along the way from P1.
    store(api, session, visits(rng, poses, 12, 0.05, {"P2": 0.4 * np.array([0.6, 0.0, -0.8])}))
    for pose_id, T in poses.items():
        command(api, session, pose_id, T)
    document = table(api, session)
    ways = {(d["from_pose_id"], d["to_pose_id"]): d for d in document["distances"]}
    assert list(ways) == [("P1", "P2"), ("P1", "P3"), ("P2", "P3")]
    way = ways["P1", "P2"]
    assert way["cycles"] == 12
    assert way["commanded_mm"] == pytest.approx(50.0, abs=1e-6)
    assert way["ad_mm"] == pytest.approx(way["mean_mm"] - 50.0)
    assert way["ad_mm"] == pytest.approx(0.4, abs=4.0 * way["standard_uncertainty_mm"])
    assert 0.0 < way["standard_uncertainty_mm"] < 0.2
    # 3 √2 · .05 and the images' noise, within what twelve cycles know
    low, high = way["interval_mm"]
    assert low < 3.0 * math.sqrt(2.0) * 0.055 < high
    assert low < way["rd_mm"] < high
    assert 0.0 < way["noise_floor_mm"] < way["rd_mm"]
    # Where the robot turns, the camera does not move as the commanded point.
    for turned in (ways["P1", "P3"], ways["P2", "P3"]):
        assert turned["commanded_mm"] is turned["ad_mm"] is None
        assert turned["rd_mm"] > 0.0
    (warning,) = [w for w in document["warnings"] if w["code"] == "distance_accuracy_unavailable"]
    assert "P1-P3, P2-P3" in warning["detail"]
    assert document["approach_variation"] is None


def test_distances_need_cycles_that_are_numbered(api: Any, store: Store) -> None:
    shots = shoot(seed=2, poses=3, cycles=4)
    session = new_session(api)
    store(api, session, [dataclasses.replace(shot, cycle=None) for shot in shots])
    document = table(api, session)
    assert document["distances"] is None
    (warning,) = [w for w in document["warnings"] if w["code"] == "distances_unavailable"]
    assert "numbered cycles" in warning["detail"]
    # Without commands the distances themselves stand.
    session = new_session(api)
    store(api, session, shots)
    document = table(api, session)
    assert [d["ad_mm"] for d in document["distances"]] == [None] * 3
    assert [d["cycles"] for d in document["distances"]] == [4] * 3
    assert {"distances_unavailable", "distance_accuracy_unavailable"}.isdisjoint(codes(document))


def test_a_cycle_that_visits_a_pose_twice_is_not_paired(api: Any, store: Store) -> None:
    shots = shoot(seed=3, poses=2, cycles=4)
    shots.append(
        dataclasses.replace(shots[0], points=look(np.random.default_rng(0), invert(shots[0].T_target_camera)))
    )
    session = new_session(api)
    store(api, session, shots)
    (way,) = table(api, session)["distances"]
    assert way["cycles"] == 3


def test_many_poses_have_the_distances_of_successive_ones(api: Any, store: Store) -> None:
    session = new_session(api)
    store(api, session, shoot(seed=4, poses=12, cycles=2))
    document = table(api, session)
    assert MAX_PAIRS < 12 * 11 // 2
    assert [(d["from_pose_id"], d["to_pose_id"]) for d in document["distances"]] == [
        (f"P{i}", f"P{i + 1}") for i in range(1, 12)
    ]
    (warning,) = [w for w in document["warnings"] if w["code"] == "distance_pairs_truncated"]
    assert "12 poses" in warning["detail"]


def test_one_pose_approached_from_three_sides(api: Any, store: Store) -> None:
    rng = np.random.default_rng(5)
    poses = cube(rng)
    sides = {"x": np.array([0.3, 0.0, 0.0]), "y": np.array([0.0, 0.4, 0.0]), "z": np.zeros(3)}
    approached = {**{f"A_{side}": poses["P1"] for side in sides}, "P2": poses["P2"], "P3": poses["P3"]}
    session = new_session(api)
    store(api, session, visits(rng, approached, 10, 0.02, {f"A_{side}": off for side, off in sides.items()}))
    for side in sides:
        command(api, session, f"A_{side}", poses["P1"], approach=side)
    document = table(api, session)
    (pose,) = document["approach_variation"]
    assert [(d["approach"], d["pose_ids"], d["cycles"]) for d in pose["directions"]] == [
        (side, [f"A_{side}"], 10) for side in sides
    ]
    assert pose["variation"]["vap_p_mm"] == pytest.approx(0.5, abs=0.05)
    assert pose["variation"]["vap_x_mm"] == pytest.approx(0.3, abs=0.05)
    assert 0.0 < pose["expected_variation"]["vap_p_mm"] < 0.05
    assert pose["variation"]["vap_yaw_deg"] < 5.0 * pose["expected_variation"]["vap_yaw_deg"]
    # Poses in one place are no distance; those from the third side to the others are.
    ways = {(d["from_pose_id"], d["to_pose_id"]) for d in document["distances"]}
    assert ("A_x", "A_y") not in ways
    assert ("A_x", "P2") in ways
    assert {"approach_variation_from_two_directions", "approach_variation_unavailable"}.isdisjoint(
        codes(document)
    )


def test_two_sides_are_a_lower_bound_and_one_is_no_bound(api: Any, store: Store) -> None:
    rng = np.random.default_rng(6)
    poses = cube(rng)
    session = new_session(api)
    store(api, session, visits(rng, {"A": poses["P1"], "B": poses["P1"], "P2": poses["P2"]}, 3, 0.02))
    command(api, session, "A", poses["P1"], approach="from above")
    document = table(api, session)
    assert document["approach_variation"] is None
    assert "approach_variation_unavailable" in codes(document)
    command(api, session, "B", poses["P1"], approach="from the side")
    document = table(api, session)
    assert len(document["approach_variation"]) == 1
    assert "approach_variation_from_two_directions" in codes(document)


def test_another_instrument_s_readings_have_distances_too(api: Any) -> None:
    session = new_session(api)
    rng = np.random.default_rng(7)
    readings = [
        {"pose_id": pose_id, "cycle": cycle, "position_mm": (at + rng.normal(0.0, 0.02, 3)).tolist()}
        for cycle in range(1, 11)
        for pose_id, at in (("P1", np.zeros(3)), ("P2", np.array([0.0, 0.0, 700.0])))
    ]
    response = api.client.post(f"/v1/sessions/{session}/measured-poses", json=readings)
    assert response.status_code in (200, 201), response.text
    for pose_id, z in (("P1", 0.0), ("P2", 700.2)):
        assert api.client.put(
            f"/v1/sessions/{session}/poses/{pose_id}", json={"position_mm": [10.0, 20.0, z]}
        ).status_code in (200, 201)
    (way,) = table(api, session, source="measured_poses")["distances"]
    assert way["cycles"] == 10
    assert way["ad_mm"] == pytest.approx(-0.2, abs=0.05)
    assert way["noise_floor_mm"] is None
