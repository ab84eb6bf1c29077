"""The target's own shape over HTTP: a bent board found, the camera before it right, and refusals in words."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from app.api.schemas.analyses import IntrinsicsAnalysis
from core.calibration.multi_view.board_symmetry import symmetry_rotations
from core.geometry.camera import CAMERA_PARAMETERS, project
from core.geometry.se3 import compose, invert, transform_points
from core.targets.specification import GridPoints, TargetSpec
from tests.support.sessions.stored_sessions import (
    BOARD,
    CAMERA,
    HEIGHT,
    MEASURED_BOARD,
    WIDTH,
    Shot,
    Store,
    body,
    commanded_pose,
    draw_board_pose,
    new_session,
    problem,
    put_pose,
    shoot,
)

SIGMA_PX = 0.02


def bent(board: TargetSpec, bow_mm: float) -> np.ndarray:
    """The board's points, its middle column pushed out by `bow_mm`."""
    places = board.points_target()
    x = places[:, 0] - places[:, 0].mean()
    places[:, 2] += bow_mm * (1.0 - (x / x.max()) ** 2)
    return places


def session_of(
    seed: int, places: np.ndarray, board: TargetSpec = BOARD, *, count: int = 14, turned: bool = False
) -> list[Shot]:
    """Images of these points from random sides; `turned`: read by chance as a board that looks the same when turned."""
    rng = np.random.default_rng(seed)
    row, column = (a.ravel() for a in np.mgrid[0 : board.rows, 0 : board.columns])
    shots = []
    for i in range(count):
        T = draw_board_pose(rng, 30.0, board)
        exact = project(transform_points(T, places), CAMERA)
        seen = exact + rng.normal(0.0, SIGMA_PX, exact.shape)
        if turned and rng.random() < 0.5:
            seen = seen[::-1]  # half a turn of the grid
            T = compose(T, symmetry_rotations(board)[1])
        points = GridPoints(
            board,
            WIDTH,
            HEIGHT,
            column,
            row,
            seen.copy(),
            np.full(len(seen), SIGMA_PX),
            labelling="up_to_symmetry" if turned else "absolute",
        )
        shots.append(Shot(f"P{i}", 1, points, invert(T)))
    return shots


def get(api: Any, session: str, **query: Any) -> Any:
    return api.client.get(f"/v1/sessions/{session}/intrinsics", params=query)


def test_a_bent_board_is_found_and_the_camera_with_it(api: Any, store: Store) -> None:
    session = new_session(api)
    store(api, session, session_of(1, bent(BOARD, 0.25)))
    flat = body(get(api, session))
    assert flat["target_shape"] is None
    document = body(get(api, session, refine_target="true"))
    IntrinsicsAnalysis.model_validate(document, extra="forbid")
    shape = document["target_shape"]
    assert (shape["image_count"], shape["view_directions"], shape["used_for_calibration"]) == (14, 14, True)
    sigma = shape["standard_uncertainty"]
    assert shape["bow_x_mm"] == pytest.approx(0.25, abs=4.0 * sigma["bow_x_mm"])
    assert sigma["bow_x_mm"] < 0.02
    assert abs(shape["bow_y_mm"]) < 4.0 * sigma["bow_y_mm"]
    assert shape["out_of_plane"]["significant"]
    assert not shape["in_plane"]["significant"]
    assert shape["rms_px"] < 0.5 * shape["rms_before_px"]
    assert len(shape["points"]) == BOARD.size
    (group,) = document["groups"]
    assert group["reduced_chi2"] < 1.3 < flat["groups"][0]["reduced_chi2"]
    found = {**group["intrinsics"], **group["distortion"]}
    for name in CAMERA_PARAMETERS[:8]:
        assert abs(found[name] - getattr(CAMERA, name)) < 4.0 * group["standard_uncertainty"][name], name
    # Another question, another answer.
    assert document["inputs_sha256"] != flat["inputs_sha256"]
    assert body(get(api, session, refine_target="false")) == flat


def test_a_board_that_looks_the_same_turned_is_refined_under_one_reading(api: Any, store: Store) -> None:
    board = TargetSpec("chessboard", 10, 6, 12.0)
    places = bent(board, 0.25)
    places[0] += [0.2, 0.0, 0.0]  # one corner distinguishes the ends
    session = new_session(api, board)
    shots = session_of(2, places, board, turned=True)
    store(api, session, shots)
    for shot in shots:  # commanded orientations settle which reading is which
        T = invert(shot.T_target_camera)
        assert shot.points is not None
        upright = np.allclose(
            shot.points.points_px, project(transform_points(T, places), CAMERA), atol=8 * SIGMA_PX
        )
        commanded = (
            shot.T_target_camera if upright else compose(symmetry_rotations(board)[1], shot.T_target_camera)
        )
        put_pose(api, session, shot.pose_id, commanded_pose(commanded))
    shape = body(get(api, session, refine_target="true"))["target_shape"]
    assert shape["bow_x_mm"] == pytest.approx(0.25, abs=0.05)
    assert shape["reduced_chi2"] < 1.3
    largest = max(shape["points"], key=lambda p: math.hypot(*p["deviation_mm"][:2]))
    assert (largest["column"], largest["row"]) in {(0, 0), (9, 5)}
    assert math.hypot(*largest["deviation_mm"][:2]) == pytest.approx(0.2, abs=0.06)


def test_a_perfect_board_stays_as_it_is(api: Any, store: Store) -> None:
    session = new_session(api)
    store(api, session, session_of(3, BOARD.points_target()))
    flat, refined = body(get(api, session)), body(get(api, session, refine_target="true"))
    assert refined["target_shape"]["used_for_calibration"] is False
    assert refined["groups"] == flat["groups"]


def test_the_shape_reaches_accuracy(api: Any, store: Store) -> None:
    """The commands are where the cameras were: what accuracy reads is the board's."""
    session = new_session(api, MEASURED_BOARD)
    shots = session_of(7, bent(BOARD, 0.25))
    store(api, session, shots)
    for shot in {shot.pose_id: shot for shot in shots}.values():
        put_pose(api, session, shot.pose_id, commanded_pose(shot.T_target_camera))
    read = {}
    for refine in ("false", "true"):
        response = api.client.get(f"/v1/sessions/{session}/repeatability", params={"refine_target": refine})
        poses = body(response)["poses"]
        read[refine] = [row["accuracy"]["ap_p_mm"] for row in poses]
        assert all(row["accuracy"]["tie"] == "best_fit" for row in poses)
        assert all(row["accuracy"]["interval"]["ap_p_mm"] is not None for row in poses)
    assert read["true"] != read["false"]
    # Fourteen views show the bow: absolute figures allow for it without the shape, too.
    for ap in read.values():
        assert np.sqrt(np.mean(np.square(ap))) < 0.05
    assert (
        api.client.get(f"/v1/sessions/{session}/dh", params={"refine_target": "perhaps"}).status_code == 422
    )


def test_what_images_do_not_determine_is_refused_with_advice(api: Any, store: Store) -> None:
    session = new_session(api)
    store(api, session, shoot(poses=5, cycles=6))
    refused = problem(get(api, session, refine_target="true"), 409, "target_shape_not_observable")
    assert "5 directions" in refused["detail"]
    assert "tilted" in refused["advice"]
    problem(get(api, session, refine_target="perhaps"), 422, "invalid_request")


def test_two_targets_and_two_focus_groups(api: Any, store: Store) -> None:
    second = TargetSpec("chessboard", 8, 5, 10.0)
    session = new_session(api, BOARD, second)
    first_id, second_id = api.client.get(f"/v1/sessions/{session}").json()["target_ids"]
    shots = session_of(4, bent(BOARD, 0.25), count=18)
    shots[12:] = [dataclasses.replace(s, fields={"focus_group": "near"}) for s in shots[12:]]
    store(api, session, shots, first_id)
    others = [
        dataclasses.replace(s, pose_id=f"Q{i}", fields={"focus_group": "other"})
        for i, s in enumerate(session_of(5, second.points_target(), second, count=5))
    ]
    store(api, session, others, second_id)
    document = body(get(api, session, refine_target="true"))
    assert document["target_shape"]["target_id"] == first_id
    assert document["target_shape"]["focus_group"] == "default"
    assert [g["focus_group"] for g in document["groups"]] == ["default", "near", "other"]
    assert all(g["reduced_chi2"] < 1.4 for g in document["groups"])
    codes = {w["code"] for w in document["warnings"]}
    assert {"only_one_target_refined", "target_shape_uncertainty_ignored"} <= codes


def test_the_shape_of_a_print_is_not_that_of_another_print_of_the_same_board(api: Any, store: Store) -> None:
    session = new_session(api, BOARD, BOARD)
    flat_id, bent_id = api.client.get(f"/v1/sessions/{session}").json()["target_ids"]
    store(api, session, session_of(4, BOARD.points_target(), count=10), flat_id)
    others = session_of(5, bent(BOARD, 0.25), count=16)
    store(api, session, [dataclasses.replace(s, pose_id=f"Q{i}") for i, s in enumerate(others)], bent_id)
    document = body(get(api, session, refine_target="true"))
    assert document["target_shape"]["target_id"] == bent_id
    (group,) = document["groups"]
    assert group["image_count"] == 26
    assert group["reduced_chi2"] < 1.4
    off = group["intrinsics"]["fx_px"] - CAMERA.fx_px
    assert abs(off) < 4.0 * group["standard_uncertainty"]["fx_px"] < 1.0
