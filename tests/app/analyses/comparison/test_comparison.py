"""The comparison over HTTP: every method its row on the same images, every failure in words, the same bytes always."""

from __future__ import annotations

import dataclasses
import json
import random
from typing import Any

import numpy as np
import pytest

from app.api.schemas.analyses.comparison import ComparisonAnalysis
from core.comparison import METHODS
from core.targets.specification import TargetSpec
from tests.support.sessions.repeatability import KEYS
from tests.support.sessions.stored_sessions import (
    BOARD,
    Shot,
    Store,
    body,
    new_session,
    problem,
    same_but_for_ids,
    shoot,
    with_fields,
)

CALIBRATING = METHODS[:8]


def get(api: Any, session: str, **headers: str) -> Any:
    return api.client.get(f"/v1/sessions/{session}/comparison", headers=headers)


def tables(api: Any, session: str) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    """The document, its rows of Table II and of Table III by method, checked for what every one of them keeps."""
    document = body(get(api, session))
    ComparisonAnalysis.model_validate(document, extra="forbid")
    for part in ("calibrations", "repeatabilities"):
        assert [row["method"] for row in document[part]] == list(METHODS)
    for row in document["calibrations"]:
        assert row["calibrated"] + row["failed"] == document["image_count"]
        assert (row["failure"] is not None) == (row["calibrated"] == 0)
        for figures in ("reprojection", "intrinsics", "distortion"):
            assert (row[figures] is None) == (row["calibrated"] == 0)
        if row["calibrated"] and row["failed"]:
            assert sum(failure["image_count"] for failure in row["failures"]) == row["failed"]
    for row in document["repeatabilities"]:
        for pose in row["poses"]:
            assert list(pose["repeatability"]) == KEYS
            assert (
                (None in pose["repeatability"].values())
                == (pose["cycles"] < 2)
                == (pose["failure"] is not None)
            )
    second, third = ({row["method"]: row for row in document[p]} for p in ("calibrations", "repeatabilities"))
    return document, second, third


def rp(row: dict[str, Any]) -> float:
    return float(np.mean([pose["repeatability"]["rp_l_mm"] for pose in row["poses"]]))


@pytest.mark.slow
def test_all_methods_on_the_same_images(api: Any, store: Store) -> None:
    session = new_session(api)
    store(api, session, shoot(repeatability_mm=0.02))
    document, second, third = tables(api, session)
    assert (document["image_count"], document["focus_group"], document["pending"]) == (60, "default", 0)
    for method in CALIBRATING:
        row = second[method]
        assert row["calibrated"] + row["failed"] == 60
        assert row["camera_of"] == ("all_images" if method == "zhang" else "each_image")
        assert (row["standard_deviation"] is None) == (method == "zhang")
    # nothing but corner noise of .02 px is left where the model has all that the lens does
    for method in ("proposed_vanishing_point", "zhang", "opencv_single_image", "pooled"):
        assert second[method]["calibrated"] == 60
        assert second[method]["reprojection"]["mean_px"] == pytest.approx(0.02 * np.sqrt(np.pi / 2), rel=0.1)
    assert second["zhang"]["intrinsics"]["fx_px"] == pytest.approx(1160.0, rel=2e-3)
    assert second["pooled"]["intrinsics"]["fx_px"] == pytest.approx(1160.0, rel=2e-3)
    assert second["opencv_single_image"]["standard_deviation"]["fx_px"] > 1.0
    for method in ("aruco_marker", "aruco_board"):
        for table in (second, third):
            assert table[method]["failure"]["code"] == "target_without_markers"
            assert "ChArUco" in table[method]["failure"]["advice"]
    assert [pose["pose_id"] for pose in third["tsai"]["poses"]] == ["P1", "P2", "P3", "P4", "P5"]
    # RP_l of .02 mm in each axis is some .07 mm; the floor of images with a camera each is many times that, but for the
    # DLT, which holds the principal point
    assert rp(third["pooled"]) < 0.15
    assert rp(third["zhang"]) == pytest.approx(rp(third["pooled"]), rel=0.1)
    for method in ("proposed_vanishing_point", "opencv_single_image"):
        assert rp(third[method]) > 3.0 * rp(third["pooled"])
    assert rp(third["dlt"]) > rp(third["pooled"])
    for method, row in third.items():
        assert all((pose["noise_floor"] is not None) == (method == "pooled") for pose in row["poses"])


def test_the_pooled_row_is_the_repeatability_document(api: Any, store: Store) -> None:
    session = new_session(api)
    store(api, session, shoot(seed=2, poses=2))
    _, _, third = tables(api, session)
    known = body(api.client.get(f"/v1/sessions/{session}/repeatability"))
    for pose, other in zip(third["pooled"]["poses"], known["poses"], strict=True):
        assert (pose["pose_id"], pose["cycles"]) == (other["pose_id"], other["cycles"])
        for part in ("repeatability", "noise_floor"):
            assert pose[part] == pytest.approx(other[part], rel=1e-3)  # of which only one has an interval


def test_the_same_bytes_whatever_the_order_and_304(api: Any, store: Store) -> None:
    shots = shoot(seed=3, poses=2, cycles=4)
    first, second = new_session(api), new_session(api)
    ids = store(api, first, shots)
    order = random.Random(1).sample(range(len(shots)), len(shots))
    others = dict(zip(order, store(api, second, [shots[i] for i in order]), strict=True))
    answer, other = get(api, first), get(api, second)
    assert same_but_for_ids(
        answer.text.replace(first, "session"),
        ids,
        other.text.replace(second, "session"),
        [others[i] for i in range(len(shots))],
    )
    again = get(api, first, **{"If-None-Match": answer.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")
    assert get(api, first).content == answer.content
    store(api, first, [dataclasses.replace(shots[0], cycle=99)])
    assert get(api, first).headers["etag"] != answer.headers["etag"]


def test_failures_are_said_per_method_and_image(api: Any, store: Store) -> None:
    session = new_session(api)
    ids = store(api, session, shoot(seed=4, poses=1, cycles=3))
    flat = [
        dataclasses.replace(shot, pose_id="P2") for shot in shoot(seed=5, poses=1, cycles=3, tilt_deg=0.0)
    ]
    flat_ids = store(api, session, flat)
    _, second, third = tables(api, session)
    for method, code in (
        ("tsai", "degenerate_geometry"),
        ("proposed_vanishing_point", "focal_not_observable"),
    ):
        row = second[method]
        assert (row["calibrated"], row["failed"], row["failure"]) == (3, 3, None)
        assert {failure["code"] for failure in row["failures"]} <= {code, "degenerate_geometry"}
        assert sorted(i for failure in row["failures"] for i in failure["measurement_ids"]) == sorted(
            flat_ids
        )
        assert all(failure["advice"] for failure in row["failures"])
        seen, blind = third[method]["poses"]
        assert (seen["cycles"], seen["failures"]) == (3, [])
        assert (blind["cycles"], blind["failure"]["code"]) == (0, "too_few_images")
        assert blind["failures"] == row["failures"]
    assert "perpendicular" in second["tsai"]["failures"][0]["detail"]
    for method in ("zhang", "pooled"):  # the tilted images determine the camera, the others their pose
        assert second[method]["calibrated"] == 6
        assert all(pose["failure"] is None for pose in third[method]["poses"])
    warned = {warning["code"]: warning for warning in second["opencv_single_image"]["warnings"]}
    assert warned["focal_not_observable"]["image_count"] == 3
    assert set(ids).isdisjoint(flat_ids)


def test_one_image(api: Any, store: Store) -> None:
    session = new_session(api)
    store(api, session, shoot(seed=6, poses=1, cycles=1))
    document, second, third = tables(api, session)
    assert second["zhang"]["failure"]["code"] == "degenerate_geometry"
    assert "two views" in second["zhang"]["failure"]["detail"]
    assert second["proposed_vanishing_point"]["calibrated"] == 1
    assert second["proposed_vanishing_point"]["standard_deviation"] is None
    for method in ("proposed_vanishing_point", "pooled"):
        assert [pose["failure"]["code"] for pose in third[method]["poses"]] == ["too_few_images"]
    assert "single_image" in [w["code"] for w in document["warnings"]]


def test_where_even_pooling_fails_the_others_answer(api: Any, store: Store) -> None:
    session = new_session(api)
    store(api, session, shoot(seed=7, poses=1, cycles=3, tilt_deg=0.0))
    _, second, _ = tables(api, session)
    assert second["pooled"]["failure"]["code"] == "focal_not_observable"
    assert second["opencv_single_image"]["calibrated"] == 3


def test_images_without_points_are_counted(api: Any, store: Store) -> None:
    session = new_session(api)
    shots = shoot(seed=8, poses=1, cycles=4)
    lost = Shot("P1", 5, None, None)
    store(api, session, [*shots, lost])
    document, _, _ = tables(api, session)
    assert document["image_count"] == 4
    (warning,) = [w for w in document["warnings"] if w["code"] == "images_without_points"]
    assert "target_not_found (1)" in warning["detail"]


def test_boards_that_look_the_same_turned_are_read_one_way(api: Any, store: Store) -> None:
    """Each image numbered from either end by chance; a method that mixed them would read a board's length."""
    board = TargetSpec("chessboard", 8, 6, 12.0)
    session = new_session(api, board)
    shots = []
    for i, shot in enumerate(shoot(seed=9, poses=2, cycles=5, board=board, repeatability_mm=0.02)):
        points = shot.points
        assert points is not None
        points = dataclasses.replace(points, labelling="up_to_symmetry")
        if i % 3 == 1:
            order = slice(None, None, -1)
            points = dataclasses.replace(
                points,
                column=7 - points.column[order],
                row=5 - points.row[order],
                points_px=points.points_px[order],
            )
        shots.append(dataclasses.replace(shot, points=points))
    store(api, session, shots)
    _, second, third = tables(api, session)
    for method in ("zhang", "opencv_single_image", "proposed_vanishing_point", "pooled"):
        assert second[method]["calibrated"] == 10
        assert max(pose["repeatability"]["rp_l_mm"] for pose in third[method]["poses"]) < 20.0
    assert rp(third["pooled"]) < 0.2


def test_one_camera_setting_is_compared_and_the_others_named(api: Any, store: Store) -> None:
    session = new_session(api)
    store(api, session, shoot(seed=10, poses=2, cycles=4))
    others = shoot(seed=11, poses=1, cycles=3)
    store(
        api, session, with_fields([dataclasses.replace(s, pose_id="P9") for s in others], focus_group="near")
    )
    document, _, third = tables(api, session)
    assert (document["focus_group"], document["image_count"]) == ("default", 8)
    (warning,) = [w for w in document["warnings"] if w["code"] == "images_of_other_focus_group"]
    assert "'near' of 1224 x 1024 px (3)" in warning["detail"]
    assert "which has the most" in warning["detail"]
    assert [pose["pose_id"] for pose in third["pooled"]["poses"]] == ["P1", "P2"]


def test_nothing_to_compare_is_a_conflict(api: Any, store: Store) -> None:
    session = new_session(api)
    refusal = problem(get(api, session), 409, "too_few_measurements")
    assert refusal["advice"]
    store(api, session, [Shot("P1", 1, None, None)])
    problem(get(api, session), 409, "no_usable_images")
    problem(get(api, "ses_nobody"), 404, "session_not_found")


def test_the_document_holds_no_nan(api: Any, store: Store) -> None:
    """Points of which some are px off: some methods go astray, none of them into NaN."""
    rng = np.random.default_rng(12)
    session = new_session(api)
    shots = []
    for shot in shoot(seed=12, poses=1, cycles=4):
        assert shot.points is not None
        px = shot.points.points_px.copy()
        px[::9] += rng.normal(0.0, 30.0, px[::9].shape)
        shots.append(dataclasses.replace(shot, points=dataclasses.replace(shot.points, points_px=px)))
    store(api, session, shots)
    answer = get(api, session)
    assert answer.status_code == 200, answer.text
    json.loads(answer.text, parse_constant=pytest.fail)
    assert BOARD.size == 54
