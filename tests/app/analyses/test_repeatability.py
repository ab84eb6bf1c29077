"""Repeatability over HTTP: tables that hold the truth, every image accounted for, every refusal in words."""

from __future__ import annotations

import dataclasses
import math
import random
from typing import Any

import numpy as np
import pytest

from app.api.schemas.analyses import RepeatabilityAnalysis
from core.calibration.readings import turns_alike
from core.camera import project
from core.simulation.views import draw_pose
from core.targets.specification import TargetSpec
from core.transforms import (
    compose,
    invert,
    rotation_to_rpy,
    rpy_to_rotation,
    so3_exp,
    transform,
    transform_points,
)
from tests.app.analyses.conftest import (
    BOARD,
    CAMERA,
    WIDTH,
    Shot,
    Store,
    body,
    die,
    look,
    new_session,
    problem,
    same_but_for_ids,
    shoot,
    with_fields,
)

KEYS = ["position_mm", "x_mm", "y_mm", "z_mm", "roll_deg", "pitch_deg", "yaw_deg"]
# RP_l of isotropic scatter σ: the mean of |d| and three times its standard deviation, Maxwell's law.
RP_OF_SIGMA = math.sqrt(8.0 / math.pi) + 3.0 * math.sqrt(3.0 - 8.0 / math.pi)


def get(api: Any, session: str, **query: Any) -> Any:
    return api.client.get(f"/v1/sessions/{session}/repeatability", params=query)


def table(api: Any, session: str, **query: Any) -> dict[str, Any]:
    """The document, checked for what every one of them keeps."""
    document = body(get(api, session, **query))
    RepeatabilityAnalysis.model_validate(document, extra="forbid")
    for row in document["poses"]:
        for part in ("repeatability", "interval", "noise_floor", "corrected"):
            assert list(row[part]) == KEYS
            assert (None in row[part].values()) == (row["n"] < 2)
        assert len(row["used"]) == row["n"]
        assert (row["verdict"] == "too_few_cycles") == (row["n"] < 10)
        for name in KEYS if row["n"] > 1 else ():
            low, high = row["interval"][name]
            assert 0 <= low <= row["repeatability"][name] <= high
            assert row["corrected"][name] <= row["repeatability"][name]
    return document


def test_the_table_holds_the_truth(api: Any, store: Store) -> None:
    session = new_session(api)
    ids = store(api, session, shoot(seed=3, cycles=30))
    document = table(api, session)
    assert (document["estimator"], document["source"], document["confidence_level"]) == (
        "pooled",
        "images",
        0.95,
    )
    assert [row["pose_id"] for row in document["poses"]] == ["P1", "P2", "P3", "P4", "P5"]
    assert sorted(one for row in document["poses"] for one in row["used"]) == sorted(ids)
    sigma, degrees = 0.05, math.degrees(0.05e-3)
    true = {"position_mm": RP_OF_SIGMA * sigma} | dict.fromkeys(KEYS[1:4], 3.0 * sigma)
    inside = []
    for row in document["poses"]:
        assert (row["n"], row["verdict"], row["excluded"], row["with_excluded"]) == (30, "robot", [], None)
        assert row["noise_floor"]["position_mm"] < 0.25 * row["repeatability"]["position_mm"]
        for name, value in true.items():
            low, high = row["interval"][name]
            inside.append(low < value < high)
        assert row["corrected"]["position_mm"] == pytest.approx(true["position_mm"], rel=0.35)
        rotation = rpy_to_rotation(
            np.radians([row["mean"][f"{name}_deg"] for name in ("roll", "pitch", "yaw")])
        )
        assert rotation[2, 2] > 0.7  # the camera looks at the board
        # Angles scatter by the robot's 3 σ, as the mapping to roll, pitch and yaw magnifies it, and the noise.
        assert 2.0 * degrees < row["repeatability"]["yaw_deg"] < 6.0 * degrees
    # 20 intervals of 95 %: fewer than 15 inside has a probability of 3e-4, were they independent.
    assert sum(inside) >= 15
    (group,) = document["intrinsics"]
    assert (group["focus_group"], group["images"]) == ("default", 150)
    assert [warning["code"] for warning in document["warnings"]] == ["accuracy_unavailable"]
    assert document["poses"][0]["accuracy"] is None


def test_a_motionless_robot_is_not_measured_by_its_camera(api: Any, store: Store) -> None:
    session = new_session(api)
    store(api, session, shoot(seed=4, poses=4, cycles=12, repeatability_mm=0.0))
    for row in table(api, session)["poses"]:
        assert row["verdict"] == "instrument_limited"
        assert row["noise_floor"]["position_mm"] == pytest.approx(
            row["repeatability"]["position_mm"], rel=0.5
        )
        assert row["corrected"]["position_mm"] < row["repeatability"]["position_mm"]


def test_no_row_is_the_robots_whose_camera_was_not_steady(api: Any, store: Store) -> None:
    """A focus that changes from cycle to cycle at one pose scatters there; one that differs from pose to pose, or a
    print that is not as stated, does not."""
    zoomed = dataclasses.replace(CAMERA, fx_px=1.004 * CAMERA.fx_px, fy_px=1.004 * CAMERA.fy_px)
    rng = np.random.default_rng(2)
    shots = [
        dataclasses.replace(shot, points=look(rng, invert(shot.T_target_camera), camera=zoomed))
        if shot.pose_id == "P3" and (shot.cycle or 0) % 2 == 0
        else shot
        for shot in shoot(seed=3, cycles=12)
    ]
    session = new_session(api)
    store(api, session, shots)
    mixed = table(api, session)
    codes = [warning["code"] for warning in mixed["warnings"]]
    assert {"intrinsics_not_common", "camera_not_steady"} <= set(codes)
    verdicts = {row["pose_id"]: row["verdict"] for row in mixed["poses"]}
    assert verdicts.pop("P3") == "instrument_limited"
    assert set(verdicts.values()) == {"robot"}
    for row in mixed["poses"]:  # how much of P3's scatter the camera made is not known: nothing is taken off
        assert (row["corrected"] == row["repeatability"]) == (row["pose_id"] == "P3")
    # Another lens at P3, in all of its cycles: one camera does not explain that, and yet nothing scatters by it.
    rng = np.random.default_rng(2)
    between = [
        dataclasses.replace(shot, points=look(rng, invert(shot.T_target_camera), camera=zoomed))
        if shot.pose_id == "P3"
        else shot
        for shot in shoot(seed=3, cycles=12)
    ]
    session = new_session(api)
    store(api, session, between)
    steady = table(api, session)
    assert "intrinsics_not_common" in [warning["code"] for warning in steady["warnings"]]
    assert "camera_not_steady" not in [warning["code"] for warning in steady["warnings"]]
    assert {row["verdict"] for row in steady["poses"]} == {"robot"}


@pytest.mark.parametrize("estimator", ["pooled_free_focal", "per_image", "per_image_fixed_pp", "given"])
def test_every_estimator_gives_a_table(api: Any, store: Store, estimator: str) -> None:
    session = new_session(api, intrinsics=dataclasses.asdict(CAMERA))
    store(api, session, shoot(seed=5, cycles=10))
    document = table(api, session, estimator=estimator)
    assert document["estimator"] == estimator
    floors = [row["noise_floor"]["position_mm"] for row in document["poses"]]
    pooled = [row["noise_floor"]["position_mm"] for row in table(api, session)["poses"]]
    if estimator == "given":
        assert floors == pytest.approx(pooled, rel=0.01)
    else:
        assert np.mean(floors) > 1.5 * np.mean(pooled)


def test_the_order_of_uploads_never_matters(api: Any, store: Store) -> None:
    shots = shoot(seed=6, poses=11, cycles=2)
    for i in (1, 12, 13):
        shots[i] = dataclasses.replace(shots[i], cycle=None)
    shots[5] = dataclasses.replace(shots[5], points=None)
    shuffled = list(enumerate(shots))
    random.Random(3).shuffle(shuffled)
    session, other = new_session(api), new_session(api)
    ids = store(api, session, shots)
    others = store(api, other, [shot for _, shot in shuffled])
    matched = [others[[place for place, _ in shuffled].index(i)] for i in range(len(shots))]
    first, second = get(api, session), get(api, other)
    assert body(first)["inputs_sha256"] == body(second)["inputs_sha256"]
    assert same_but_for_ids(first.text, [session, *ids], second.text, [other, *matched])
    assert [row["pose_id"] for row in body(first)["poses"]] == [f"P{i}" for i in range(1, 12)]
    of_p2 = [ids[i] for i in (1, 12)]
    by_hash = sorted(of_p2, key=lambda one: shots[ids.index(one)].sha256)
    assert body(first)["poses"][1]["used"] == by_hash


def test_an_answer_the_client_has_is_not_sent_again(api: Any, store: Store) -> None:
    session = new_session(api)
    store(api, session, shoot(cycles=2))
    first = get(api, session)
    url = f"/v1/sessions/{session}/repeatability"
    again = api.client.get(url, headers={"If-None-Match": first.headers["ETag"]})
    assert (again.status_code, again.content) == (304, b"")
    # What the robot was told enters too.
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
    assert [(row["n"], len(row["excluded"])) for row in rows.values()] == [
        (3, 0),
        (3, 0),
        (2, 1),
        (3, 0),
        (1, 0),
        (0, 2),
    ]
    assert rows["P3"]["excluded"] == [
        {"measurement_id": ids[2], "code": "undecodable_image", "detail": "No grid was found."}
    ]
    assert rows["Q1"]["mean"]["position_mm"] is not None
    assert set(rows["Q1"]["repeatability"].values()) == {None}
    assert set(rows["Q2"]["mean"].values()) == {None}
    assert {e["code"] for e in rows["Q2"]["excluded"]} == {"target_not_found"}
    assert "images_excluded" in {warning["code"] for warning in document["warnings"]}
    named = {one for row in rows.values() for one in row["used"]}
    named |= {e["measurement_id"] for row in rows.values() for e in row["excluded"]}
    assert named == set(ids)


def test_poses_of_one_cycle_are_rows_of_nulls(api: Any, store: Store) -> None:
    session = new_session(api)
    store(api, session, shoot(cycles=1))
    document = table(api, session)
    assert [row["n"] for row in document["poses"]] == [1] * 5
    assert "too_few_cycles" in {warning["code"] for warning in document["warnings"]}


def test_an_outlier_is_left_out_in_the_open(api: Any, store: Store) -> None:
    shots = shoot(seed=10, poses=4, cycles=12)
    rng = np.random.default_rng(1)
    knocked = compose(transform(np.eye(3), np.array([0.0, 9.0, 0.0])), shots[8].T_target_camera)
    shots[8] = dataclasses.replace(shots[8], points=look(rng, invert(knocked)))
    session = new_session(api)
    ids = store(api, session, shots)
    row = table(api, session)["poses"][0]
    (outlier,) = row["excluded"]
    assert (outlier["measurement_id"], outlier["code"], row["n"]) == (ids[8], "position_outlier", 11)
    assert "RP_l would be" in outlier["detail"]
    assert row["with_excluded"]["position_mm"] > 5.0 > row["repeatability"]["position_mm"]


def test_views_that_one_image_is_refused_for_are_measured_by_the_pool(api: Any, store: Store) -> None:
    session = new_session(api)
    shots = shoot(seed=11, poses=3, cycles=10)
    flat = [
        dataclasses.replace(shot, pose_id="F" + shot.pose_id)
        for shot in shoot(seed=12, poses=2, cycles=10, tilt_deg=1.0)
    ]
    store(api, session, [*shots, *flat])
    rows = {row["pose_id"]: row for row in table(api, session)["poses"]}
    assert [rows[name]["n"] for name in ("FP1", "FP2", "P1")] == [10, 10, 10]
    alone = {row["pose_id"]: row for row in table(api, session, estimator="per_image")["poses"]}
    assert {e["code"] for e in alone["FP1"]["excluded"]} == {"focal_not_observable"}
    assert alone["FP1"]["n"] + len(alone["FP1"]["excluded"]) == 10


def test_a_pose_is_given_in_one_target_s_frame(api: Any, store: Store) -> None:
    second = TargetSpec("chessboard", 8, 5, 10.0)
    session = new_session(api, BOARD, second)
    first_id, second_id = api.client.get(f"/v1/sessions/{session}").json()["target_ids"]
    shots = shoot(seed=13, poses=3, cycles=3)
    store(api, session, shots, first_id)
    rng = np.random.default_rng(5)
    also = [
        dataclasses.replace(s, cycle=9, points=look(rng, invert(s.T_target_camera), board=second))
        for s in shots[:2]
    ]
    others = store(api, session, also, second_id)
    rows = table(api, session)["poses"]
    assert [(row["n"], [e["code"] for e in row["excluded"]]) for row in rows] == [
        (3, ["other_target"]),
        (3, ["other_target"]),
        (3, []),
    ]
    assert rows[0]["excluded"][0]["measurement_id"] == others[0]


def commanded(api: Any, session: str, told: dict[str, Any], *, angles: bool = True) -> None:
    """Store what the robot was told, in its base frame."""
    for pose_id, T in told.items():
        roll, pitch, yaw = np.degrees(rotation_to_rpy(T[:3, :3])).tolist()
        fields: dict[str, Any] = {"position_mm": T[:3, 3].tolist()}
        if angles:
            fields |= {"roll_deg": roll, "pitch_deg": pitch, "yaw_deg": yaw}
        response = api.client.put(f"/v1/sessions/{session}/poses/{pose_id}", json=fields)
        assert response.status_code == 200, response.text


def turned(rng: np.random.Generator, shots: list[Shot], board: TargetSpec) -> list[Shot]:
    """The same images as a detector reads them that cannot tell which way round the board is."""
    turns = turns_alike(board)
    seen = []
    for shot in shots:
        turn = turns[int(rng.integers(len(turns)))]
        assert shot.points is not None
        exact = project(
            transform_points(compose(invert(shot.T_target_camera), turn), board.points_target()), CAMERA
        )
        noise = rng.normal(0.0, 0.02, exact.shape)
        seen.append(
            dataclasses.replace(
                shot, points=dataclasses.replace(shot.points, points_px=exact + noise, origin="turned")
            )
        )
    return seen


def test_a_board_that_looks_the_same_turned_is_read_alike(api: Any, store: Store) -> None:
    board = TargetSpec("chessboard", 10, 6, 12.0)
    rng = np.random.default_rng(14)
    shots = turned(rng, shoot(seed=14, cycles=10, board=board), board)
    session = new_session(api, board)
    store(api, session, shots)
    document = table(api, session)
    assert all(row["repeatability"]["position_mm"] < 0.5 for row in document["poses"])
    (warning,) = [w for w in document["warnings"] if w["code"] == "orientation_ambiguous"]
    assert "turns least" in warning["detail"]
    mounting = transform(so3_exp(np.array([0.3, -2.0, 0.4])), np.array([20.0, 10.0, 80.0]))
    base = transform(so3_exp(np.array([-0.5, 0.2, 1.4])), np.array([700.0, -100.0, 300.0]))
    told = {shot.pose_id: compose(base, shot.T_target_camera, mounting) for shot in shots[:5]}
    commanded(api, session, told)
    document = table(api, session)
    assert "orientation_ambiguous" not in {w["code"] for w in document["warnings"]}
    means = [np.array(row["mean"]["position_mm"]) for row in document["poses"]]
    true = [shot.T_target_camera[:3, 3] for shot in shots[:5]]
    # Distances between poses are the robot's, whichever way the whole was read.
    for i in range(5):
        for j in range(i):
            assert np.linalg.norm(means[i] - means[j]) == pytest.approx(
                np.linalg.norm(true[i] - true[j]), abs=0.3
            )


def robot(seed: int, poses: int, deviation_mm: float) -> tuple[list[Shot], dict[str, Any], dict[str, Any]]:
    """Images of poses all round the board, what was commanded, and by how much the robot was off at each."""
    rng = np.random.default_rng(seed)
    X = transform(so3_exp(np.array([0.1, 0.2, -0.5])), np.array([30.0, -20.0, 60.0]))
    Z = transform(so3_exp(np.array([0.0, math.pi, 0.3])), np.array([800.0, 50.0, 200.0]))
    shots, told, off = [], {}, {}
    for index in range(poses):
        name = f"P{index + 1}"
        T_target_camera = invert(draw_pose(rng, BOARD, CAMERA, WIDTH, math.radians(30.0)))
        attained = compose(Z, T_target_camera, invert(X))
        off[name] = rng.normal(0.0, deviation_mm, 3)
        told[name] = transform(attained[:3, :3], attained[:3, 3] - off[name])
        for cycle in range(1, 6):
            true = transform(T_target_camera[:3, :3], T_target_camera[:3, 3] + rng.normal(0.0, 0.02, 3))
            shots.append(Shot(name, cycle, look(rng, invert(true)), true))
    return shots, told, off


@pytest.mark.parametrize("angles", [True, False])
def test_accuracy_against_the_commanded_poses(api: Any, store: Store, angles: bool) -> None:
    shots, told, off = robot(15, 24, 0.5)
    session = new_session(api)
    store(api, session, shots)
    commanded(api, session, told, angles=angles)
    document = table(api, session)
    errors = []
    for row in document["poses"]:
        found = row["accuracy"]
        attained = np.array([found[name] for name in ("x_mm", "y_mm", "z_mm")])
        errors.append(attained - off[row["pose_id"]])
        assert found["position_mm"] == pytest.approx(float(np.linalg.norm(attained)))
        assert (found["yaw_deg"] is None) == (not angles)
    # The frames are tied by 24 poses that are themselves off by .5 mm an axis: about a fifth of that remains.
    assert np.sqrt(np.mean(np.square(errors))) < 0.3
    assert "accuracy_unavailable" not in {w["code"] for w in document["warnings"]}


def test_without_motion_there_is_no_accuracy_and_a_reason(api: Any, store: Store) -> None:
    session = new_session(api)
    shots = shoot(seed=16, poses=1, cycles=3)
    store(api, session, shots)
    commanded(api, session, {"P1": shots[0].T_target_camera})
    document = table(api, session)
    assert document["poses"][0]["accuracy"] is None
    (warning,) = [w for w in document["warnings"] if w["code"] == "accuracy_unavailable"]
    assert warning["advice"]


def test_drift_is_told_over_blocks_of_cycles(api: Any, store: Store) -> None:
    shots = []
    rng = np.random.default_rng(2)
    for shot in shoot(seed=17, poses=2, cycles=24):
        assert shot.cycle is not None
        moved = transform(np.eye(3), np.array([0.02 * shot.cycle, 0.0, 0.0]))
        true = compose(moved, shot.T_target_camera)
        shots.append(dataclasses.replace(shot, points=look(rng, invert(true)), T_target_camera=true))
    session = new_session(api)
    store(api, session, shots)
    drift = table(api, session)["drift"]
    for pose in drift["poses"]:
        # The second block has 14 cycles: from the mean of 1-10 to that of 11-24.
        assert pose["shift_mm"][0] == pytest.approx(0.02 * 12.0, abs=0.08)
        assert [(b["first_cycle"], b["last_cycle"]) for b in pose["blocks"]] == [(1, 10), (11, 24)]


def test_bad_input_is_refused_with_advice(api: Any, store: Store) -> None:
    session = new_session(api)
    problem(get(api, session), 409, "too_few_measurements")
    store(api, session, [dataclasses.replace(shot, points=None) for shot in shoot(cycles=1)])
    assert problem(get(api, session), 409, "nothing_usable")["advice"]
    missing = problem(get(api, session, source="measured_poses"), 409, "measured_poses_missing")
    assert "source" in missing["advice"]
    problem(get(api, session, estimator="given"), 409, "intrinsics_missing")
    problem(get(api, session, source="tracker"), 422, "invalid_request")
    problem(get(api, session, estimator=""), 422, "invalid_request")
    misspelt = problem(get(api, session, estimater="given", source="images"), 422, "invalid_request")
    assert misspelt["errors"] == [{"field": "estimater", "message": "is not known"}]
    twice = api.client.get(f"/v1/sessions/{session}/repeatability?estimator=pooled&estimator=given").json()
    assert twice["errors"] == [{"field": "estimator", "message": "is given more than once"}]
    assert "estimator, source" in misspelt["advice"]
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
    assert sum(row["n"] for row in document["poses"]) == 7


def test_a_computation_that_dies_is_a_503_and_the_next_one_works(
    api: Any, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = new_session(api)
    store(api, session, shoot(cycles=2))
    with monkeypatch.context() as broken:
        broken.setattr("app.services.analyses.desk.compute", die)
        gone = problem(get(api, session), 503, "analysis_interrupted")
        assert "ended unexpectedly" in gone["detail"]
        assert "Ask again" in gone["advice"]
    assert get(api, session).status_code == 200


def test_an_image_of_a_target_that_is_not_the_sessions_is_left_out_and_named(api: Any, store: Store) -> None:
    session, shots = new_session(api), shoot(cycles=4)
    store(api, session, shots[:-1])
    (foreign,) = store(api, session, shots[-1:], target_id=api.make_target(name="another"))
    document = body(api.client.get(f"/v1/sessions/{session}/repeatability"))
    left = [(e["measurement_id"], e["code"]) for pose in document["poses"] for e in pose["excluded"]]
    assert left == [(foreign, "target_not_in_session")]
    assert sum(pose["n"] for pose in document["poses"]) == len(shots) - 1
    for analysis in ("intrinsics", "comparison"):
        body(api.client.get(f"/v1/sessions/{session}/{analysis}"))
