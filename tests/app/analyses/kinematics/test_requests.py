"""Requests for the kinematics: sweeps by name, the same bytes in any order, refusals with their codes."""

from __future__ import annotations

import dataclasses
import random
from typing import Any

import numpy as np
import pytest

from core.kinematics.dh import Chain
from core.simulation.arm import KR5_ARC, KR5_ARC_HOME, free_angles
from tests.support.sessions.kinematics import (
    document,
    error_mm,
    get,
    make_robot,
    measured,
    of_readings,
    readings,
)
from tests.support.sessions.stored_sessions import (
    body,
    new_session,
    problem,
    same_but_for_ids,
)
from tests.support.sessions.tracked_robot import send


@pytest.mark.slow
def test_the_order_of_sending_and_ids_never_matter(api: Any) -> None:
    _, poses = measured(5, free=4)
    sent = readings(poses)
    shuffled = list(sent)
    random.Random(4).shuffle(shuffled)
    robot = make_robot(api)
    session, other = new_session(api, robot_id=robot), new_session(api, robot_id=make_robot(api))
    send(api, session, sent)
    for start in range(0, len(sent), 17):
        send(api, other, shuffled[start : start + 17])
    for method in ("global", "combined"):
        first, second = (of_readings(api, one, method=method) for one in (session, other))
        assert body(first)["inputs_sha256"] == body(second)["inputs_sha256"]
        assert same_but_for_ids(first.text, [session], second.text, [other])
    url = f"/v1/sessions/{session}/dh"
    query = {"source": "measured_poses", "method": "combined"}
    known = {"If-None-Match": of_readings(api, session, method="combined").headers["ETag"]}
    assert api.client.get(url, params=query, headers=known).status_code == 304
    # What it is computed from: tolerance and robot are part of it.
    wider = api.client.get(url, params={**query, "joint_tolerance_deg": 0.05}, headers=known)
    assert body(wider)["joint_tolerance_deg"] == 0.05
    changed = dataclasses.replace(KR5_ARC.joints[2], a_mm=121.0)
    deviating = make_robot(api, Chain((*KR5_ARC.joints[:2], changed, *KR5_ARC.joints[3:])))
    assert api.client.patch(f"/v1/sessions/{session}", json={"robot_id": deviating}).status_code == 200
    assert api.client.get(url, params=query, headers=known).status_code == 200


@pytest.mark.slow
def test_sampled_uncertainties_are_next_to_the_stated_ones(api: Any) -> None:
    _, poses = measured(5, free=4)
    session = new_session(api, robot_id=make_robot(api))
    send(api, session, readings(poses))
    found = body(of_readings(api, session, model="dh", uncertainty="monte_carlo"))
    sampling = found["parameter_sampling"]
    assert [one["parameter"] for one in sampling["sampled_parameters"]] == found["parameters"]
    assert sampling["agrees"] is all(one["agrees"] for one in sampling["sampled_parameters"])
    assert sampling["trials"] == 200
    assert 0.95 < sampling["joint_ratio"] < 1.05
    plain = body(of_readings(api, session, model="dh"))
    assert plain["parameter_sampling"] is None
    assert plain["joints"] == found["joints"]


def test_what_cannot_be_sampled_is_refused(api: Any) -> None:
    session = new_session(api)
    for query in ({"model": "auto"}, {"model": "dh", "method": "screw"}):
        found = problem(of_readings(api, session, uncertainty="monte_carlo", **query), 422, "invalid_request")
        assert found["errors"][0]["field"] == "uncertainty"


@pytest.mark.slow
def test_refusals_say_what_to_do(api: Any) -> None:
    robot = make_robot(api)
    _, poses = measured(6, free=4)
    sent = readings(poses)

    def refused(
        readings: list[dict[str, Any]], code: str, *, robot_id: str | None = robot, **query: Any
    ) -> str:
        session = new_session(api, robot_id=robot_id)
        send(api, session, readings)
        found = problem(of_readings(api, session, **query), 409, code)
        assert found["advice"]
        return str(found["detail"])

    assert refused([{**r, "joint_angles_deg": None} for r in sent], "joint_angles_missing")
    problem(of_readings(api, new_session(api)), 409, "measured_poses_missing")
    # The robot was changed after the readings came.
    session = new_session(api)
    send(api, session, sent)
    five = make_robot(api, Chain(KR5_ARC.joints[:5]))
    assert api.client.patch(f"/v1/sessions/{session}", json={"robot_id": five}).status_code == 200
    assert "5" in problem(of_readings(api, session), 409, "joint_angles_inconsistent")["detail"]
    # Radians by mistake; and a joint that does not turn.
    radians = [{**r, "joint_angles_deg": np.radians(r["joint_angles_deg"]).tolist()} for r in sent]
    for method in ("global", "combined"):
        assert "radians" in refused(radians, "joint_angles_unit_mismatch", method=method)
    # A left-handed frame, and inches: every method is asked about them.
    for method, changes in (("global", {}), ("combined", {}), ("cpa", {"rotation": None})):
        left = [{**r, **changes, "position_mm": [-r["position_mm"][0], *r["position_mm"][1:]]} for r in sent]
        assert "left-handed" in refused(left, "frame_mirrored", method=method)
        inches = [{**r, **changes, "position_mm": [x / 25.4 for x in r["position_mm"]]} for r in sent]
        assert "look like inches" in refused(inches, "lengths_unit_mismatch", method=method)
    # Without sweeps the nominal robot shows it, of positions alone too.
    _, loose = measured(6, arc_deg=40.0, free=40)
    free = readings(loose)[54:]
    for changes in ({}, {"rotation": None}):
        radians = [
            {**r, **changes, "joint_angles_deg": np.radians(r["joint_angles_deg"]).tolist()} for r in free
        ]
        assert "radians" in refused(radians, "joint_angles_unit_mismatch")
    _, short = measured(6, arc_deg=20.0, free=0)
    assert "60°" in refused(readings(short), "arc_too_short", method="cpa")
    still = [r for i, r in enumerate(sent[:54]) if not 27 <= i < 36]
    for method in ("global", "combined", "cpa"):
        assert "4" in refused(still, "joint_not_excited", method=method)
    sliding = [
        {
            **r,
            "joint_angles_deg": [*KR5_ARC_HOME[:5].tolist(), 10.0 * i],
            "position_mm": [100.0 * i, 0.0, 0.0],
            "rotation": np.eye(3).tolist(),
        }
        for i, r in enumerate(sent[:9])
    ]
    refused(sliding, "prismatic_joint", method="combined")
    refused(sent[:5], "joint_not_excited")


@pytest.mark.slow
def test_sweeps_named_by_their_poses(api: Any) -> None:
    """Free poses that happen to rest do not disturb, a pose serves several sweeps, patterns stand for many."""
    arm, poses = measured(7, free=6)
    joints = [np.flatnonzero(np.ptp(poses.joint_angles[9 * k : 9 * k + 9], axis=0) > 0.1) for k in range(6)]
    assert [j.tolist() for j in joints] == [[k] for k in range(6)]
    names = [f"j{i // 9 + 1}-{i % 9}" if i < 54 else f"free.{i - 54}" for i in range(len(poses))]
    sent = [{**r, "pose_id": name} for r, name in zip(readings(poses), names, strict=True)]
    session = new_session(api, robot_id=make_robot(api))
    send(api, session, sent)
    plain = document(of_readings(api, session, method="combined"))
    assert plain["named_sweeps"] == []
    assert [j["poses"] for j in plain["joints"]] == [14] * 6
    named = document(of_readings(api, session, method="combined", sweep=[f"{k}:j{k}-*" for k in range(1, 7)]))
    assert [j["poses"] for j in named["joints"]] == [9] * 6
    assert error_mm(named, arm, free_angles(np.random.default_rng(99), KR5_ARC_HOME, 50)) < 0.3
    # Home, the fifth of each sweep, may serve any of them; what is not named is recognised; order is of no matter.
    some = ["3:j3-1,j3-0,j3-8,j1-4,j3-7", "1:j1-?"]
    first, second = (
        of_readings(api, session, method="combined", sweep=order) for order in (some, some[::-1])
    )
    assert first.content == second.content
    found = document(first)
    assert found["named_sweeps"] == ["1:j1-?", "3:j1-4,j3-0,j3-1,j3-7,j3-8"]
    assert [j["poses"] for j in found["joints"]] == [9, 14, 5, 14, 14, 14]
    # Two sweeps of one joint, and the global method's residuals by joint.
    found = document(of_readings(api, session, sweep=["2:j2-0,j2-1,j2-2,j2-3", "2:j2-4,j2-5,j2-6,j2-7,j2-8"]))
    assert found["inputs_sha256"] != document(of_readings(api, session))["inputs_sha256"]
    assert found["joints"][1]["residual"]["position_rms_mm"] < 0.3

    def refused(code: str, *sweep: str) -> str:
        answer = problem(of_readings(api, session, method="combined", sweep=list(sweep)), 409, code)
        assert answer["advice"]
        return str(answer["detail"])

    assert "j9-1" in refused("sweep_pose_unknown", "1:j1-1,j9-1")
    assert "x*" in refused("sweep_pose_unknown", "1:x*")
    assert "*j*" in refused("sweep_pose_unknown", f"1:{'*j' * 40}*x")  # at once, however many stars
    assert "7" in refused("sweep_joint_unknown", "7:j1-*")
    assert "joint 2 moved" in refused("joint_angles_inconsistent", "1:j1-*,j2-0")
    assert "joint 2 moved" in refused("joint_angles_inconsistent", "1:j2-*")
    refused("joint_not_excited", "1:j1-1,j1-2")
    for malformed in ("", "j1-1", "0:j1-1", "1:", "1:a,,b", "100:a", "1:a b", "1:[a]", "1:ü"):
        assert of_readings(api, session, sweep=malformed).status_code == 422, malformed
    # A wider tolerance lets the others move by so much.
    document(of_readings(api, session, method="combined", sweep="1:j1-*", joint_tolerance_deg=1.0))


def test_poses_that_failed_are_excluded_from_a_named_sweep(api: Any) -> None:
    _, poses = measured(8, free=0)
    sent = [{**r, "pose_id": f"p{i}"} for i, r in enumerate(readings(poses))]
    sent[3]["joint_angles_deg"] = None
    session = new_session(api, robot_id=make_robot(api))
    send(api, session, sent)
    sweep = "1:" + ",".join(f"p{i}" for i in range(9))
    found = document(of_readings(api, session, method="combined", sweep=sweep))
    assert found["joints"][0]["poses"] == 8
    (said,) = (w for w in found["warnings"] if w["code"] == "poses_excluded")
    assert "p3" in said["detail"]


def test_queries_are_checked(api: Any) -> None:
    session = new_session(api)
    for query in (
        {"method": "paper"},
        {"joint_tolerance_deg": "0"},
        {"joint_tolerance_deg": "nan"},
        {"joint_tolerance_deg": "inf"},
        {"joint_tolerance_deg": "6"},
        {"joint_tolerance_deg": "x"},
        {"source": "robot"},
        {"estimator": "mine"},
    ):
        assert get(api, session, **query).status_code == 422, query
    problem(get(api, session), 409, "too_few_measurements")
    send(api, session, readings(measured(7, free=2)[1]))
    instead = problem(get(api, session), 409, "too_few_measurements")
    assert "source=measured_poses" in instead["advice"]
    problem(get(api, "ses_nothing"), 404, "session_not_found")
