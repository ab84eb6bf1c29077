"""The table of repeatability over HTTP: it holds the truth, whichever estimator and target it is of."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from core.geometry.roll_pitch_yaw import rpy_to_rotation
from core.geometry.se3 import compose, invert, transform
from core.targets.specification import TargetSpec
from tests.support.sessions.repeatability import KEYS, table
from tests.support.sessions.stored_sessions import (
    BOARD,
    CAMERA,
    Store,
    body,
    look,
    new_session,
    shoot,
)

# RP_l of isotropic scatter σ: the mean of |d| and three times its standard deviation, Maxwell's law.
RP_OF_SIGMA = math.sqrt(8.0 / math.pi) + 3.0 * math.sqrt(3.0 - 8.0 / math.pi)


def test_cameras_are_as_uncertain_as_on_their_own_page(api: Any, store: Store) -> None:
    session = new_session(api)
    store(api, session, shoot(cycles=3))
    (camera,) = body(api.client.get(f"/v1/sessions/{session}/intrinsics"))["groups"]
    (group,) = table(api, session)["groups"]
    assert group == {name: camera[name] for name in group}


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
    assert sorted(one for row in document["poses"] for one in row["measurement_ids"]) == sorted(ids)
    sigma, degrees = 0.05, math.degrees(0.05e-3)
    true = {"rp_l_mm": RP_OF_SIGMA * sigma} | dict.fromkeys(KEYS[1:4], 3.0 * sigma)
    inside = []
    for row in document["poses"]:
        assert (row["cycles"], row["verdict"], row["excluded"], row["without_outliers"]) == (
            30,
            "robot",
            [],
            None,
        )
        verdicts = {one["figure"]: one["verdict"] for one in row["verdicts"]}
        assert list(verdicts) == KEYS
        assert verdicts["rp_l_mm"] == row["verdict"]
        assert set(verdicts.values()) <= {"robot", "instrument_limited"}
        # The robot turns by .05 mrad about each axis; the noise adds to it.
        assert 2.0 * degrees < min(row["orientation_scatter"]["rotation_vector_deg"])
        assert row["noise_floor"]["rp_l_mm"] < 0.25 * row["repeatability"]["rp_l_mm"]
        for name, value in true.items():
            low, high = row["interval"][name]
            inside.append(low < value < high)
        assert row["corrected"]["rp_l_mm"] == pytest.approx(true["rp_l_mm"], rel=0.35)
        rotation = rpy_to_rotation(
            np.radians([row["mean"][f"{name}_deg"] for name in ("roll", "pitch", "yaw")])
        )
        assert rotation[2, 2] > 0.7  # the camera looks at the board
        # Angles scatter by the robot's 3 σ, as the mapping to roll, pitch and yaw magnifies it, and the noise.
        assert 2.0 * degrees < row["repeatability"]["rp_yaw_deg"] < 6.0 * degrees
    # 20 intervals of 95 %: fewer than 15 inside has a probability of 3e-4, were they independent.
    assert sum(inside) >= 15
    (group,) = document["groups"]
    assert (group["focus_group"], group["image_count"]) == ("default", 150)
    # The distances between poses are absolute figures; nothing was commanded.
    codes = {warning["code"] for warning in document["warnings"]}
    assert codes == {"accuracy_unavailable", "scale_taken_as_exact"}, (
        "no word of an uncertainty that is not given"
    )
    assert document["poses"][0]["accuracy"] is None


def test_a_motionless_robot_is_not_measured_by_its_camera(api: Any, store: Store) -> None:
    session = new_session(api)
    store(api, session, shoot(seed=4, poses=4, cycles=12, repeatability_mm=0.0))
    for row in table(api, session)["poses"]:
        assert row["verdict"] == "instrument_limited"
        assert row["noise_floor"]["rp_l_mm"] == pytest.approx(row["repeatability"]["rp_l_mm"], rel=0.5)
        assert row["corrected"]["rp_l_mm"] < row["repeatability"]["rp_l_mm"]


@pytest.mark.slow
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
    assert {"intrinsics_vary_between_images", "intrinsics_drift"} <= set(codes)
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
    assert "intrinsics_vary_between_images" in [warning["code"] for warning in steady["warnings"]]
    assert "intrinsics_drift" not in [warning["code"] for warning in steady["warnings"]]
    assert {row["verdict"] for row in steady["poses"]} == {"robot"}


@pytest.mark.slow
@pytest.mark.parametrize("estimator", ["pooled_free_focal", "per_image", "per_image_fixed_pp", "given"])
def test_every_estimator_gives_a_table(api: Any, store: Store, estimator: str) -> None:
    session = new_session(api, intrinsics=dataclasses.asdict(CAMERA))
    store(api, session, shoot(seed=5, cycles=10))
    document = table(api, session, estimator=estimator)
    assert document["estimator"] == estimator
    floors = [row["noise_floor"]["rp_l_mm"] for row in document["poses"]]
    pooled = [row["noise_floor"]["rp_l_mm"] for row in table(api, session)["poses"]]
    if estimator == "given":
        assert floors == pytest.approx(pooled, rel=0.01)
    else:
        assert np.mean(floors) > 1.5 * np.mean(pooled)


def test_poses_of_one_cycle_are_rows_of_nulls(api: Any, store: Store) -> None:
    session = new_session(api)
    store(api, session, shoot(cycles=1))
    document = table(api, session)
    assert [row["cycles"] for row in document["poses"]] == [1] * 5
    assert {row["orientation_scatter"] for row in document["poses"]} == {None}
    first = document["warnings"][0]
    assert first["code"] == "too_few_cycles", "before all others: nothing else is to be read without it"
    assert first["detail"].startswith("Nothing was repeated")


def test_images_without_cycles_are_said_to_be_taken_for_visits(api: Any, store: Store) -> None:
    session = new_session(api)
    shots = shoot(seed=2, poses=3, cycles=2)
    store(api, session, [dataclasses.replace(shot, cycle=None) for shot in shots])
    document = table(api, session)
    assert [row["cycles"] for row in document["poses"]] == [2] * 3
    first = document["warnings"][0]
    assert first["code"] == "cycles_not_stated"
    assert "all poses" in first["detail"]
    session = new_session(api)
    store(api, session, shots)
    assert not {warning["code"] for warning in table(api, session)["warnings"]} & {
        "cycles_not_stated",
        "too_few_cycles",
    }


def test_an_outlier_counts_and_is_named(api: Any, store: Store) -> None:
    shots = shoot(seed=10, poses=4, cycles=12)
    rng = np.random.default_rng(1)
    knocked = compose(transform(np.eye(3), np.array([0.0, 9.0, 0.0])), shots[8].T_target_camera)
    shots[8] = dataclasses.replace(shots[8], points=look(rng, invert(knocked)))
    session = new_session(api)
    ids = store(api, session, shots)
    row = table(api, session)["poses"][0]
    (outlier,) = row["outliers"]
    assert outlier["measured_pose_id"] is None
    assert (outlier["measurement_id"], outlier["code"], outlier["cycle"]) == (
        ids[8],
        "position_outlier",
        shots[8].cycle,
    )
    assert outlier["distance_mm"] == pytest.approx(9.0, abs=0.5)
    assert (row["cycles"], row["excluded"]) == (12, [])
    assert row["repeatability"]["rp_l_mm"] > 5.0 > row["without_outliers"]["rp_l_mm"]


@pytest.mark.slow
def test_views_that_one_image_is_refused_for_are_measured_by_the_pool(api: Any, store: Store) -> None:
    session = new_session(api)
    shots = shoot(seed=11, poses=3, cycles=10)
    flat = [
        dataclasses.replace(shot, pose_id="F" + shot.pose_id)
        for shot in shoot(seed=12, poses=2, cycles=10, tilt_deg=1.0)
    ]
    store(api, session, [*shots, *flat])
    rows = {row["pose_id"]: row for row in table(api, session)["poses"]}
    assert [rows[name]["cycles"] for name in ("FP1", "FP2", "P1")] == [10, 10, 10]
    alone = {row["pose_id"]: row for row in table(api, session, estimator="per_image")["poses"]}
    assert {e["code"] for e in alone["FP1"]["excluded"]} == {"focal_not_observable"}
    assert alone["FP1"]["cycles"] + len(alone["FP1"]["excluded"]) == 10


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
    assert [(row["cycles"], [e["code"] for e in row["excluded"]]) for row in rows] == [
        (3, ["images_of_other_target"]),
        (3, ["images_of_other_target"]),
        (3, []),
    ]
    assert rows[0]["excluded"][0]["measurement_id"] == others[0]


@pytest.mark.slow
def test_the_budget_explains_each_figure(api: Any, store: Store) -> None:
    session = new_session(api)
    store(api, session, shoot(seed=3, cycles=12))
    document = table(api, session, method="monte_carlo")
    rows = {row["pose_id"]: row for row in document["poses"]}
    totals = document["budget_totals"]
    assert {one["figure"] for one in totals} == {
        "repeatability.rp_l_mm",
        "noise_floor.rp_l_mm",
        "corrected.rp_l_mm",
    }
    for total in totals:
        part, name = total["figure"].split(".")
        assert total["value_mm"] == rows[total["pose_id"]][part][name]
        inputs = [
            one
            for one in document["budget"]
            if (one["figure"], one["pose_id"]) == (total["figure"], total["pose_id"])
        ]
        assert sum(one["share"] for one in inputs) == pytest.approx(1.0, rel=1e-5)
        added = math.sqrt(sum((one["sensitivity"] * one["input_uncertainty"]) ** 2 for one in inputs))
        assert added == pytest.approx(total["standard_uncertainty_mm"], rel=1e-3)
        assert total["expanded_uncertainty_mm"] == pytest.approx(
            total["coverage_factor"] * total["standard_uncertainty_mm"], rel=1e-3
        )
        sampled = total["monte_carlo"]
        # The interval of twelve cycles lies about 1.2 to 1.4 times the reading, and draws scatter by as much more.
        assert 0.9 < sampled["standard_uncertainty_mm"] / total["standard_uncertainty_mm"] < 1.5
        assert sampled["agrees"] is (sampled["difference_mm"] <= sampled["tolerance_mm"])
    plain = table(api, session)
    assert {one["monte_carlo"] for one in plain["budget_totals"]} == {None}
    assert plain["budget"] == document["budget"]
    text = api.client.get(
        f"/v1/sessions/{session}/repeatability", params={"table": "budget"}, headers={"Accept": "text/csv"}
    ).text
    assert text.splitlines()[0] == (
        "figure,pose_id,to_pose_id,source,type,distribution,input_uncertainty,input_unit,sensitivity,"
        "standard_uncertainty_mm,degrees_of_freedom,share"
    )
    assert len(text.splitlines()) == len(document["budget"]) + 1
