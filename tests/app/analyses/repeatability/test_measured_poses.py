"""Repeatability and accuracy from another instrument: the same figures, null with a reason where it gives less."""

from __future__ import annotations

import math
import random
from typing import Any

import numpy as np
import pytest

from app.api.schemas.analyses import RepeatabilityAnalysis
from core.geometry.se3 import transform
from core.metrology import PoseCycles, assess_repeatability
from tests.support.sessions.repeatability import KEYS
from tests.support.sessions.stored_sessions import (
    Store,
    body,
    codes,
    new_session,
    problem,
    same_but_for_ids,
    shoot,
)
from tests.support.sessions.tracked_robot import (
    COVARIANCE,
    SCATTER_MM,
    SIGMA_MM,
    drawn_poses,
    readings,
    send,
    send_commands,
)


def get(api: Any, session: str, **query: Any) -> Any:
    url = f"/v1/sessions/{session}/repeatability"
    return api.client.get(url, params={"source": "measured_poses", **query})


def table(api: Any, session: str) -> dict[str, Any]:
    document = body(get(api, session))
    RepeatabilityAnalysis.model_validate(document, extra="forbid")
    assert (document["source"], document["pending"], document["groups"]) == ("measured_poses", 0, [])
    return document


def test_the_figures_are_those_of_the_readings(api: Any) -> None:
    session = new_session(api)
    sent = readings(drawn_poses(1, 3), cycles=15)
    ids = send(api, session, sent)
    document = table(api, session)
    assert [row["pose_id"] for row in document["poses"]] == ["P1", "P2", "P3"]
    assert document["poses"][1]["measured_pose_ids"] == ids[1::3]
    assert document["poses"][1]["measurement_ids"] == []
    for index, row in enumerate(document["poses"]):
        mine = sent[index::3]
        (expected,) = assess_repeatability(
            [
                PoseCycles(
                    np.array([r["position_mm"] for r in mine]),
                    np.array([r["rotation"] for r in mine]),
                    np.array([COVARIANCE] * len(mine)),
                )
            ]
        )
        assert (row["cycles"], row["verdict"], row["excluded"]) == (15, expected.verdict, [])
        for part in ("repeatability", "noise_floor", "corrected"):
            figures = [value for _, value in getattr(expected, part).items()]
            scale = [1.0] * 4 + [math.degrees(1.0)] * 3
            assert list(row[part]) == KEYS
            assert list(row[part].values()) == pytest.approx(
                [v * s for v, s in zip(figures, scale, strict=True)], rel=1e-3, abs=1e-5
            )
        assert row["mean"]["position_mm"] == pytest.approx(expected.mean_position_mm, abs=1e-4)
    assert codes(document) == ["accuracy_unavailable"]


def test_positions_alone_give_positions_alone(api: Any) -> None:
    session = new_session(api)
    send(api, session, readings(drawn_poses(2, 3), rotations=False))
    document = table(api, session)
    for row in document["poses"]:
        for part in ("repeatability", "interval", "noise_floor", "corrected"):
            assert [row[part][key] is None for key in KEYS] == [False] * 4 + [True] * 3
        assert row["mean"]["position_mm"] is not None
        assert row["mean"]["roll_deg"] is None
    assert "rotations_missing" in codes(document)
    (warning,) = (w for w in document["warnings"] if w["code"] == "rotations_missing")
    assert "no figure of orientation" in warning["detail"]


def test_an_instrument_that_says_nothing_of_itself_has_no_floor(api: Any) -> None:
    session = new_session(api)
    sent = readings(drawn_poses(3, 2), covariances=False)
    sent[0]["covariance"] = COVARIANCE.tolist()  # one of many is as good as none
    send(api, session, sent)
    document = table(api, session)
    for row in document["poses"]:
        assert set(row["noise_floor"].values()) == set(row["corrected"].values()) == {None}
        assert None not in row["repeatability"].values()
        assert None not in row["interval"].values()
        assert row["verdict"] == "instrument_limited"
    assert "noise_unknown" in codes(document)


def test_accuracy_is_reported_in_tied_frames(api: Any) -> None:
    """One pose was reached a millimetre off; whatever of orientation is known, its accuracy says so."""
    poses = drawn_poses(4, 12)
    reached = list(poses)
    reached[5] = transform(poses[5][:3, :3], poses[5][:3, 3] + [0.0, 1.0, 0.0])
    accuracies = {}
    for name, rotations, oriented in (
        ("six degrees of freedom", True, True),
        ("a reflector", False, True),
    ):
        session = new_session(api)
        send_commands(api, session, poses, oriented=oriented)
        send(api, session, readings(reached, cycles=3, rotations=rotations))
        document = table(api, session)
        accuracies[name] = {row["pose_id"]: row["accuracy"] for row in document["poses"]}
        assert None not in accuracies[name].values()
        assert "accuracy_unavailable" not in codes(document)
    noise = 6.0 * math.hypot(SCATTER_MM, SIGMA_MM)
    for name, by_pose in accuracies.items():
        others = [row["ap_p_mm"] for pose_id, row in by_pose.items() if pose_id != "P6"]
        assert by_pose["P6"]["ap_y_mm"] == pytest.approx(1.0, abs=noise), name
        assert abs(by_pose["P6"]["ap_x_mm"]) < noise, name
        assert abs(by_pose["P6"]["ap_z_mm"]) < noise, name
        assert np.median(others) < noise, name
    assert accuracies["a reflector"]["P6"]["ap_roll_deg"] is None
    assert accuracies["six degrees of freedom"]["P6"]["ap_roll_deg"] is not None


def test_positions_against_positions_say_what_they_assume(api: Any) -> None:
    poses = [transform(np.eye(3), T[:3, 3]) for T in drawn_poses(5, 10)]
    session = new_session(api)
    send_commands(api, session, poses, oriented=False)
    send(api, session, readings(poses, cycles=2, rotations=False))
    document = table(api, session)
    assert "tool_offset_unknown" in codes(document)
    assert all(row["accuracy"]["ap_p_mm"] < 0.5 for row in document["poses"])


def test_the_order_of_sending_never_matters_and_ids_do_not(api: Any) -> None:
    sent = readings(drawn_poses(6, 11), cycles=2)
    for one in (sent[3], sent[14]):
        one["cycle"] = None
    shuffled = list(enumerate(sent))
    random.Random(2).shuffle(shuffled)
    session, other = new_session(api), new_session(api)
    ids = send(api, session, sent)
    others = []
    for start in range(0, len(shuffled), 5):
        others += send(api, other, [one for _, one in shuffled[start : start + 5]])
    matched = [others[[place for place, _ in shuffled].index(i)] for i in range(len(sent))]
    first, second = get(api, session), get(api, other)
    assert body(first)["inputs_sha256"] == body(second)["inputs_sha256"]
    assert same_but_for_ids(first.text, [session, *ids], second.text, [other, *matched])
    assert [row["pose_id"] for row in body(first)["poses"]] == [f"P{i}" for i in range(1, 12)]


def test_the_answer_changes_with_the_readings_and_not_with_images(api: Any, store: Store) -> None:
    session = new_session(api)
    poses = drawn_poses(7, 2)
    send(api, session, readings(poses, cycles=2))
    first = get(api, session)
    url = f"/v1/sessions/{session}/repeatability"
    known = {"If-None-Match": first.headers["ETag"]}
    store(api, session, shoot(poses=2, cycles=2))
    send(api, session, readings(poses, cycles=2))  # nothing new
    assert api.client.get(url, params={"source": "measured_poses"}, headers=known).status_code == 304
    assert body(api.client.get(url))["inputs_sha256"] != body(first)["inputs_sha256"]
    send(api, session, readings(poses, cycles=3)[4:])
    changed = api.client.get(url, params={"source": "measured_poses"}, headers=known)
    assert changed.status_code == 200
    assert changed.headers["ETag"] != first.headers["ETag"]
    assert [row["cycles"] for row in body(changed)["poses"]] == [3, 3]


def test_a_session_without_readings_says_what_to_do(api: Any) -> None:
    refused = problem(get(api, new_session(api)), 409, "measured_poses_missing")
    assert "measured-poses" in refused["advice"]


def test_one_reading_each_is_no_repeatability(api: Any) -> None:
    session = new_session(api)
    send(api, session, readings(drawn_poses(8, 2), cycles=1))
    document = table(api, session)
    assert [row["verdict"] for row in document["poses"]] == ["too_few_cycles"] * 2
    assert set(document["poses"][0]["repeatability"].values()) == {None}
    assert "too_few_cycles" in codes(document)


def test_an_outlier_of_another_instrument_is_named_by_its_measured_pose(api: Any) -> None:
    session = new_session(api)
    rng = np.random.default_rng(6)
    positions = np.array([100.0, 200.0, 300.0]) + rng.normal(0.0, 0.02, (24, 3))
    positions[7] += [0.0, 1.0, 0.0]
    sent = [
        {"pose_id": "P1", "cycle": k + 1, "position_mm": position.tolist()}
        for k, position in enumerate(positions)
    ]
    stored = api.client.post(f"/v1/sessions/{session}/measured-poses", json=sent).json()["items"]
    found = table(api, session)
    (outlier,) = found["poses"][0]["outliers"]
    assert outlier["measurement_id"] is None
    assert (outlier["measured_pose_id"], outlier["cycle"]) == (stored[7]["id"], 8)
    assert (found["drift"]["against"], found["drift"]["time_source"]) == ("cycle", None)
