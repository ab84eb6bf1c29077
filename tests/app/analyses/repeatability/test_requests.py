"""Requests for the table: the same answer in any order, every image accounted for, refusals with their codes."""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import Any

import numpy as np
import pytest

from tests.support.sessions.repeatability import get, table
from tests.support.sessions.stored_sessions import (
    BOARD,
    CAMERA,
    WIDTH,
    Shot,
    Store,
    assert_order_is_irrelevant,
    body,
    die,
    look,
    new_session,
    problem,
    shoot,
    with_fields,
)
from tests.support.simulation.simulated_views import draw_pose


def test_the_order_of_uploads_never_matters(api: Any, store: Store) -> None:
    shots = shoot(seed=6, poses=11, cycles=2)
    for i in (1, 12, 13):
        shots[i] = dataclasses.replace(shots[i], cycle=None)
    shots[5] = dataclasses.replace(shots[5], points=None)
    document, ids = assert_order_is_irrelevant(api, store, shots, partial(get, api))
    assert [row["pose_id"] for row in document["poses"]] == [f"P{i}" for i in range(1, 12)]
    of_p2 = [ids[i] for i in (1, 12)]
    by_hash = sorted(of_p2, key=lambda one: shots[ids.index(one)].sha256)
    assert document["poses"][1]["measurement_ids"] == by_hash


def test_an_answer_the_client_has_is_not_sent_again(api: Any, store: Store) -> None:
    session = new_session(api)
    store(api, session, shoot(cycles=2))
    first = get(api, session)
    url = f"/v1/sessions/{session}/repeatability"
    again = api.client.get(url, headers={"If-None-Match": first.headers["ETag"]})
    assert (again.status_code, again.content) == (304, b"")
    # What was commanded enters too.
    pose = {"position_mm": [1.0, 2.0, 3.0], "roll_deg": 0.0, "pitch_deg": 0.0, "yaw_deg": 0.0}
    assert api.client.put(f"/v1/sessions/{session}/poses/P1", json=pose).status_code == 200
    changed = api.client.get(url, headers={"If-None-Match": first.headers["ETag"]})
    assert body(changed)["inputs_sha256"] != body(first)["inputs_sha256"]


def test_every_image_is_used_or_excluded_with_its_reason(api: Any, store: Store) -> None:
    rng = np.random.default_rng(9)
    shots = shoot(seed=8, poses=4, cycles=3)
    lonely = Shot("Q1", 1, look(rng, draw_pose(rng, BOARD, CAMERA, WIDTH, 0.5)), np.eye(4))
    empty = [Shot("Q2", cycle, None, np.eye(4)) for cycle in (1, 2)]
    shots[2] = dataclasses.replace(shots[2], points=None, failure="undecodable_image")
    session = new_session(api)
    ids = store(api, session, [*shots, lonely, *empty])
    document = table(api, session)
    rows = {row["pose_id"]: row for row in document["poses"]}
    assert list(rows) == ["P1", "P2", "P3", "P4", "Q1", "Q2"]
    assert [(row["cycles"], len(row["excluded"])) for row in rows.values()] == [
        (3, 0),
        (3, 0),
        (2, 1),
        (3, 0),
        (1, 0),
        (0, 2),
    ]
    assert rows["P3"]["excluded"] == [
        {
            "measurement_id": ids[2],
            "measured_pose_id": None,
            "filename": None,
            "code": "undecodable_image",
            "detail": "No grid was found.",
        }
    ]
    assert rows["Q1"]["mean"]["position_mm"] is not None
    assert set(rows["Q1"]["repeatability"].values()) == {None}
    assert set(rows["Q2"]["mean"].values()) == {None}
    assert {e["code"] for e in rows["Q2"]["excluded"]} == {"target_not_found"}
    assert "images_excluded" in {warning["code"] for warning in document["warnings"]}
    named = {one for row in rows.values() for one in row["measurement_ids"]}
    named |= {e["measurement_id"] for row in rows.values() for e in row["excluded"]}
    assert named == set(ids)


def test_bad_input_is_refused_with_advice(api: Any, store: Store) -> None:
    session = new_session(api)
    problem(get(api, session), 409, "too_few_measurements")
    store(api, session, [dataclasses.replace(shot, points=None) for shot in shoot(cycles=1)])
    assert problem(get(api, session), 409, "no_usable_images")["advice"]
    missing = problem(get(api, session, source="measured_poses"), 409, "measured_poses_missing")
    assert "source" in missing["advice"]
    problem(get(api, session, estimator="given"), 409, "intrinsics_missing")
    problem(get(api, session, source="tracker"), 422, "invalid_request")
    problem(get(api, session, estimator=""), 422, "invalid_request")
    misspelt = problem(get(api, session, estimater="given", source="images"), 422, "invalid_request")
    assert misspelt["errors"] == [{"field": "estimater", "message": "is not known"}]
    twice = api.client.get(f"/v1/sessions/{session}/repeatability?estimator=pooled&estimator=given").json()
    assert twice["errors"] == [{"field": "estimator", "message": "is given more than once"}]
    assert "estimator, method, refine_target, source" in misspelt["advice"]
    problem(get(api, "ses_" + "0" * 26), 404, "session_not_found")
    problem(get(api, "nonsense"), 404, "session_not_found")


def test_images_that_wait_are_counted_not_awaited(api: Any, store: Store) -> None:
    session = new_session(api)
    shots = shoot(cycles=2)
    store(api, session, shots[:7])
    store(api, session, with_fields(shots[7:9], status="queued"))
    store(api, session, with_fields(shots[9:], status="running"))
    document = table(api, session)
    assert document["pending"] == 3
    assert sum(row["cycles"] for row in document["poses"]) == 7


@pytest.mark.slow
def test_a_computation_that_dies_is_a_503_and_the_next_one_works(
    api: Any, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = new_session(api)
    store(api, session, shoot(cycles=2))
    with monkeypatch.context() as broken:
        broken.setattr("app.analyses.service.compute", die)
        gone = problem(get(api, session), 503, "analysis_interrupted")
        assert "ended unexpectedly" in gone["detail"]
        assert "Ask again" in gone["advice"]
    assert get(api, session).status_code == 200


def test_an_image_of_a_target_that_is_not_the_sessions_is_excluded_and_named(api: Any, store: Store) -> None:
    session, shots = new_session(api), shoot(cycles=4)
    store(api, session, shots[:-1])
    (foreign,) = store(api, session, shots[-1:], target_id=api.make_target(name="another"))
    document = body(api.client.get(f"/v1/sessions/{session}/repeatability"))
    left = [(e["measurement_id"], e["code"]) for pose in document["poses"] for e in pose["excluded"]]
    assert left == [(foreign, "target_not_in_session")]
    assert sum(pose["cycles"] for pose in document["poses"]) == len(shots) - 1
    for analysis in ("intrinsics", "comparison"):
        body(api.client.get(f"/v1/sessions/{session}/{analysis}"))
