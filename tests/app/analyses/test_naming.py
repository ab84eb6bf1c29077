"""Sessions whose images name the same board differently: turned, or in part; no figure ever mixes two readings."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from core.calibration.readings import quarter_turns, turned_cells
from core.camera import project
from core.targets.specification import GridPoints, Origin, TargetSpec
from core.transforms import invert, rotation_to_rpy, so3_exp, transform, transform_points
from tests.app.analyses.conftest import CAMERA, HEIGHT, WIDTH, Shot, Store, body, look

NOISE = 0.02


def new_session(api: Any, board: TargetSpec) -> str:
    fields = {"kind": board.kind, "columns": board.columns, "rows": board.rows, "pitch_mm": board.pitch_mm}
    return str(api.make_session(api.make_target(**fields)))


def upright(rng: np.random.Generator, board: TargetSpec, tilt: float) -> np.ndarray:
    """T_camera_target with the board's x axis within the robot's scatter of the vertical: its reading flips."""
    R = so3_exp(np.array([tilt, 0.3 * tilt, 0.0])) @ so3_exp(np.array([0.0, 0.0, 0.5 * math.pi]))
    middle = np.array([*rng.uniform(-15.0, 15.0, 2), 330.0])
    return transform(R, middle - R @ board.points_target().mean(axis=0))


def read(points: GridPoints, quarters: int, origin: Origin) -> GridPoints:
    """The same picture as a detector that reads the board turned reports it, row by row."""
    column, row = turned_cells(points.target, points.column, points.row, quarters)
    order = np.lexsort((column, row))
    return dataclasses.replace(
        points,
        column=column[order],
        row=row[order],
        points_px=points.points_px[order],
        standard_uncertainty_px=points.standard_uncertainty_px[order],
        origin=origin,
    )


def session_of(
    board: TargetSpec,
    seed: int,
    *,
    poses: int = 4,
    cycles: int = 10,
    flips: bool = True,
    scatter_mm: float = 0.05,
) -> list[Shot]:
    """A robot's session; where `flips`, every image is read one of the ways that look the same, by chance."""
    rng, chance = np.random.default_rng(seed), np.random.default_rng(seed + 1000)
    turns = quarter_turns(board)
    shots = []
    tilts = np.linspace(0.45, 0.75, poses) * np.where(np.arange(poses) % 2, -1.0, 1.0)
    for index, tilt in enumerate(tilts):
        told = invert(upright(rng, board, float(tilt)))
        for cycle in range(1, cycles + 1):
            true = transform(told[:3, :3], told[:3, 3] + rng.normal(0.0, scatter_mm, 3))
            points = look(rng, invert(true), board=board, sigma_px=NOISE)
            quarters = int(chance.choice(turns)) if flips and len(turns) > 1 else 0
            origin: Origin = "turned" if len(turns) > 1 else "known"
            shots.append(Shot(f"P{index + 1}", cycle, read(points, quarters, origin), true))
    return shots


def table(api: Any, session: str, **query: str) -> dict[str, Any]:
    return body(api.client.get(f"/v1/sessions/{session}/repeatability", params=query))


def codes(document: dict[str, Any]) -> set[str]:
    return {warning["code"] for warning in document["warnings"]}


def figures(document: dict[str, Any]) -> list[float]:
    return [
        row[kind]["position_mm"] for row in document["poses"] for kind in ("repeatability", "noise_floor")
    ]


AMBIGUOUS = [
    ("chessboard", 10, 6),
    ("chessboard", 8, 6),
    ("chessboard", 8, 8),
    ("circles", 9, 6),
    ("circles", 7, 7),
    ("asymmetric_circles", 4, 10),
]


@pytest.mark.parametrize(
    ("kind", "columns", "rows", "estimator"),
    [*((*board, "pooled") for board in AMBIGUOUS), ("chessboard", 8, 8, "per_image_fixed_pp")],
)
def test_images_that_flip_within_a_pose_are_read_alike(
    api: Any, store: Store, kind: str, columns: int, rows: int, estimator: str
) -> None:
    board = TargetSpec(kind, columns, rows, 12.0)
    documents = []
    for flips in (True, False):
        session = new_session(api, board)
        store(api, session, session_of(board, 31, flips=flips))
        documents.append(table(api, session, estimator=estimator))
    flipped, steady = documents
    # To the last digits the figures are those of images that all were read one way: nothing is left of the flips.
    assert figures(flipped) == pytest.approx(figures(steady), rel=1e-3)
    assert all(row["n"] == 10 for row in flipped["poses"])
    largest = 0.6 if estimator == "pooled" else 6.0  # a flip moves the camera by some hundred millimetres
    assert all(row["repeatability"]["position_mm"] < largest for row in flipped["poses"])
    assert "orientation_unclear" not in codes(flipped)


def test_boards_that_show_their_origin_are_never_turned_nor_doubted(api: Any, store: Store) -> None:
    """A larger dot at the origin or marked squares: by its kind alone such a board would be ambiguous."""
    for board in (TargetSpec("circles", 9, 6, 12.0), TargetSpec("chessboard", 10, 6, 12.0)):
        rng = np.random.default_rng(32)
        shots = [
            dataclasses.replace(shot, points=dataclasses.replace(shot.points, origin="known"))
            for shot in session_of(board, 32, flips=False)
        ]
        # One pose sees the board the other way round, which a guess by the least turn would undo.
        about = np.array([*board.points_target().mean(axis=0)[:2], 0.0])
        half = so3_exp(np.array([0.0, 0.0, math.pi]))
        around = transform(half, about - half @ about)
        turned = []
        for shot in shots[:10]:
            true = around @ shot.T_target_camera
            points = look(rng, invert(true), board=board, sigma_px=NOISE)
            turned.append(Shot("P9", shot.cycle, points, true))
        session = new_session(api, board)
        store(api, session, [*shots, *turned])
        document = table(api, session)
        assert "orientation_ambiguous" not in codes(document)
        row = next(row for row in document["poses"] if row["pose_id"] == "P9")
        mean = np.mean([shot.T_target_camera[:3, 3] for shot in turned], axis=0)
        assert np.linalg.norm(np.array(row["mean"]["position_mm"]) - mean) < 2.0
        other = np.mean([shot.T_target_camera[:3, 3] for shot in shots[:10]], axis=0)
        assert np.linalg.norm(mean - other) > 50.0


def test_one_image_that_shows_the_origin_anchors_the_session(api: Any, store: Store) -> None:
    """Of a board of dots whose larger dot a cable hides in all images but one."""
    board = TargetSpec("circles", 9, 6, 12.0)
    shots = session_of(board, 33)
    index = 15
    rng = np.random.default_rng(1)
    sure = look(rng, invert(shots[index].T_target_camera), board=board, sigma_px=NOISE)
    shots[index] = dataclasses.replace(shots[index], points=sure)
    session = new_session(api, board)
    store(api, session, shots)
    document = table(api, session)
    # Its own pose is sure; the others follow by the least turn, which is said.
    row = document["poses"][1]
    true = np.mean([shot.T_target_camera[:3, 3] for shot in shots if shot.pose_id == "P2"], axis=0)
    assert np.linalg.norm(np.array(row["mean"]["position_mm"]) - true) < 2.0
    assert row["n"] == 10
    assert all(row["repeatability"]["position_mm"] < 0.6 for row in document["poses"])


def test_an_image_under_the_wrong_pose_is_no_visit_to_it(api: Any, store: Store) -> None:
    board = TargetSpec("chessboard", 10, 6, 12.0)
    shots = session_of(board, 34)
    rng = np.random.default_rng(2)
    quarter = invert(shots[0].T_target_camera) @ transform(
        so3_exp(np.array([0.0, 0.0, 0.5 * math.pi])), np.zeros(3)
    )
    points = look(rng, quarter, board=board, sigma_px=NOISE)
    stray = Shot("P1", 11, dataclasses.replace(points, origin="turned"), invert(quarter))
    session = new_session(api, board)
    ids = store(api, session, [*shots, stray])
    document = table(api, session)
    row = document["poses"][0]
    assert [(e["measurement_id"], e["code"]) for e in row["excluded"]] == [(ids[-1], "orientation_unclear")]
    assert row["n"] == 10
    (warning,) = [w for w in document["warnings"] if w["code"] == "orientation_unclear"]
    assert "P1" in warning["detail"]


def told(shots: list[Shot], scramble: str | None = None) -> dict[str, dict[str, Any]]:
    """What the robot was commanded, in its base; at the pose `scramble` something else."""
    base = transform(so3_exp(np.array([-0.5, 0.2, 1.4])), np.array([700.0, -100.0, 300.0]))
    mounting = transform(so3_exp(np.array([0.3, -2.0, 0.4])), np.array([20.0, 10.0, 80.0]))
    fields = {}
    for shot in shots:
        T = base @ shot.T_target_camera @ mounting
        if shot.pose_id == scramble:
            T = T @ transform(so3_exp(np.array([0.9, -0.8, 0.7])), np.zeros(3))
        roll, pitch, yaw = np.degrees(rotation_to_rpy(T[:3, :3])).tolist()
        fields[shot.pose_id] = {
            "position_mm": T[:3, 3].tolist(),
            "roll_deg": roll,
            "pitch_deg": pitch,
            "yaw_deg": yaw,
        }
    return fields


@pytest.mark.parametrize(("kind", "columns", "rows"), [("chessboard", 9, 6), ("chessboard", 10, 6)])
def test_a_pose_that_contradicts_its_command_is_named(
    api: Any, store: Store, kind: str, columns: int, rows: int
) -> None:
    board = TargetSpec(kind, columns, rows, 12.0)
    shots = session_of(board, 35, poses=6, cycles=4)
    session = new_session(api, board)
    store(api, session, shots)
    for pose_id, fields in told(shots).items():
        api.client.put(f"/v1/sessions/{session}/poses/{pose_id}", json=fields)
    assert not {"pose_contradicts_command", "orientation_ambiguous"} & codes(table(api, session))
    for pose_id, fields in told(shots, scramble="P4").items():
        api.client.put(f"/v1/sessions/{session}/poses/{pose_id}", json=fields)
    (warning,) = [w for w in table(api, session)["warnings"] if w["code"] == "pose_contradicts_command"]
    assert warning["detail"].endswith(": P4.")


def beyond(points: GridPoints, first_column: int, first_row: int) -> GridPoints:
    """A board that runs out of the picture, and shows its origin all the same, as marked squares do."""
    keep = (points.column >= first_column) & (points.row >= first_row)
    return dataclasses.replace(
        points,
        column=points.column[keep],
        row=points.row[keep],
        points_px=points.points_px[keep],
        standard_uncertainty_px=points.standard_uncertainty_px[keep],
        origin="known",
    )


def in_part(points: GridPoints, first_column: int, first_row: int, quarters: int) -> GridPoints:
    """What a detector reports of a board that runs out of the picture, its origin unknown: counted from the part's own
    corner, so that square (i, j) is black where i + j is even."""
    seen = beyond(points, first_column, first_row)
    wide, high = points.target.columns - first_column, points.target.rows - first_row
    c, r = seen.column - first_column, seen.row - first_row
    column, row = ((c, r), (high - 1 - r, c), (wide - 1 - c, high - 1 - r), (r, wide - 1 - c))[quarters]
    first = (column <= 1) & (row <= 1)
    column = column + int(seen.column[first].min() + seen.row[first].min()) % 2
    order = np.lexsort((column, row))
    return dataclasses.replace(
        seen,
        column=column[order],
        row=row[order],
        points_px=seen.points_px[order],
        standard_uncertainty_px=seen.standard_uncertainty_px[order],
        origin="unknown",
    )


def moved_by(shot: Shot, columns: float) -> Shot:
    """The same shot of a board that stands so many of its columns aside, the camera where it was."""
    assert shot.points is not None
    board = shot.points.target
    aside = transform(np.eye(3), np.array([columns * board.pitch_mm, 0.0, 0.0]))
    points = look(np.random.default_rng(5), invert(shot.T_target_camera) @ aside, board=board, sigma_px=NOISE)
    return dataclasses.replace(shot, points=points)


@pytest.mark.parametrize(("columns", "rows"), [(9, 6), (10, 6)])
def test_parts_of_a_board_count_by_the_named_images_of_their_pose(
    api: Any, store: Store, columns: int, rows: int
) -> None:
    board = TargetSpec("chessboard", columns, rows, 12.0)
    whole = session_of(board, 36, flips=False)
    shots = []
    for index, shot in enumerate(whole):
        assert shot.points is not None
        cut = (3, index // 10 % 2)
        points = in_part(shot.points, *cut, index % 4) if index % 3 == 1 else beyond(shot.points, *cut)
        shots.append(dataclasses.replace(shot, points=points))
    session = new_session(api, board)
    ids = store(api, session, shots)
    parts = [
        measurement for measurement, shot in zip(ids, shots, strict=True) if shot.points.origin == "unknown"
    ]
    for measurement in parts:
        stored = api.client.get(f"/v1/measurements/{measurement}").json()
        assert (stored["status"], stored["failure"]["code"]) == ("failed", "origin_unknown")
    document = table(api, session)
    assert all(row["n"] == 10 and not row["excluded"] for row in document["poses"])
    assert all(row["repeatability"]["position_mm"] < 0.6 for row in document["poses"])
    (remark,) = [w for w in document["warnings"] if w["code"] == "parts_named"]
    assert remark["detail"].startswith(f"{len(parts)} images show part of a board")
    true = [shot.T_target_camera[:3, 3] for shot in whole if shot.pose_id == "P1"]
    mean = np.array(document["poses"][0]["mean"]["position_mm"])
    assert np.linalg.norm(mean - np.mean(true, axis=0)) < 2.0
    intrinsics = body(api.client.get(f"/v1/sessions/{session}/intrinsics"))
    assert intrinsics["groups"][0]["images"] == len(shots)


@pytest.mark.parametrize(("aside", "strays"), [(2.0, 1), (2.0, 7), (1.0, 4), (0.4, 1)])
def test_parts_whose_pose_stands_in_two_places_are_left_out(
    api: Any, store: Store, aside: float, strays: int
) -> None:
    """Be it one image of many that stands aside: nobody can say with which the parts go."""
    board = TargetSpec("chessboard", 9, 6, 12.0)
    shots = []
    for index, shot in enumerate(session_of(board, 40, flips=False)):
        moved = moved_by(shot, aside) if 10 <= index < 10 + strays else shot
        assert moved.points is not None
        points = (
            in_part(moved.points, 2, 0, index % 4) if index % 10 in (8, 9) else beyond(moved.points, 2, 0)
        )
        shots.append(dataclasses.replace(moved, points=points))
    session = new_session(api, board)
    ids = store(api, session, shots)
    document = table(api, session)
    (warning,) = [w for w in document["warnings"] if w["code"] == "parts_disputed"]
    assert warning["detail"].startswith("2 images show part of a board")
    assert warning["detail"].endswith(": pose P2.")
    assert "pose_id of their own" in warning["advice"]
    assert "origin_unknown" not in codes(document)
    row = document["poses"][1]
    excluded = {e["measurement_id"]: e["code"] for e in row["excluded"]}
    assert {excluded[measurement] for measurement in ids[18:20]} == {"origin_unknown"}
    # The other poses' parts count as before.
    assert [row["n"] for row in document["poses"] if row["pose_id"] != "P2"] == [10, 10, 10]
    (named,) = [w for w in document["warnings"] if w["code"] == "parts_named"]
    assert named["detail"].startswith("6 images show part of a board")
    assert "poses P1, P3, P4." in named["detail"]


def test_a_part_whose_board_ends_where_the_others_show_more_of_it_is_left_out(api: Any, store: Store) -> None:
    board = TargetSpec("chessboard", 9, 6, 12.0)
    shots = []
    for index, shot in enumerate(session_of(board, 41, flips=False)):
        if index in (13, 17):
            moved = moved_by(shot, 2.0)
            assert moved.points is not None
            # Of the board as it stands now, the first columns are where the others' third and fourth are.
            seen = in_part(moved.points, 0, 0, 0)
            keep = seen.column < 7
            points = dataclasses.replace(
                seen,
                column=seen.column[keep],
                row=seen.row[keep],
                points_px=seen.points_px[keep],
                standard_uncertainty_px=seen.standard_uncertainty_px[keep],
            )
            shot = dataclasses.replace(moved, points=points)
        shots.append(shot)
    session = new_session(api, board)
    ids = store(api, session, shots)
    document = table(api, session)
    (warning,) = [w for w in document["warnings"] if w["code"] == "parts_aside"]
    assert "2 images show part of a board" in warning["detail"]
    assert warning["detail"].endswith(": pose P2.")
    assert not {"origin_unknown", "parts_named", "parts_disputed"} & codes(document)
    row = document["poses"][1]
    assert {e["measurement_id"] for e in row["excluded"]} == {ids[13], ids[17]}
    assert [row["n"] for row in document["poses"]] == [10, 8, 10, 10]


def test_a_part_that_counts_from_its_second_column_is_no_whole_board(api: Any, store: Store) -> None:
    """It reaches the target's last column by its count, but has one fewer: which one is out of view is open."""
    board = TargetSpec("chessboard", 9, 6, 12.0)
    shots = []
    for shot in session_of(board, 42, flips=False):
        assert shot.points is not None
        points = in_part(shot.points, 1, 0, 2) if shot.pose_id == "P3" else shot.points
        assert shot.pose_id != "P3" or (points.column.min(), points.column.max()) == (1, 8)
        shots.append(dataclasses.replace(shot, points=points))
    session = new_session(api, board)
    store(api, session, shots)
    document = table(api, session)
    assert {e["code"] for e in document["poses"][2]["excluded"]} == {"origin_unknown"}
    assert [row["n"] for row in document["poses"]] == [10, 10, 0, 10]


def test_parts_that_no_image_names_are_left_out_with_advice(api: Any, store: Store) -> None:
    board = TargetSpec("chessboard", 9, 6, 12.0)
    shots = session_of(board, 37, flips=False)
    lonely = [
        dataclasses.replace(shot, points=in_part(shot.points, 3, 0, 0)) if shot.pose_id == "P3" else shot
        for shot in shots
        if shot.points is not None
    ]
    session = new_session(api, board)
    store(api, session, lonely)
    document = table(api, session)
    row = document["poses"][2]
    assert row["n"] == 0
    assert {e["code"] for e in row["excluded"]} == {"origin_unknown"}
    (warning,) = [w for w in document["warnings"] if w["code"] == "origin_unknown"]
    assert "P3" in warning["detail"]
    assert "whole board" in warning["advice"]
    assert [row["n"] for row in document["poses"]] == [10, 10, 0, 10]


@pytest.mark.parametrize(("columns", "rows"), [(9, 6), (10, 6)])
def test_boards_of_which_only_the_outermost_squares_are_cut_off_are_whole(
    api: Any, store: Store, columns: int, rows: int
) -> None:
    """All of their grid points are in view, in an order that the colours tell."""
    board = TargetSpec("chessboard", columns, rows, 12.0)
    shots = [
        dataclasses.replace(shot, points=dataclasses.replace(shot.points, origin="unknown"))
        for shot in session_of(board, 39)
        if shot.points is not None
    ]
    session = new_session(api, board)
    store(api, session, shots)
    document = table(api, session)
    assert all(row["n"] == 10 and not row["excluded"] for row in document["poses"])
    assert all(row["repeatability"]["position_mm"] < 0.6 for row in document["poses"])
    assert not {"parts_named", "origin_unknown"} & codes(document)
    assert ("orientation_ambiguous" in codes(document)) == (columns == 10)


def test_a_session_of_parts_alone_is_refused_with_the_reason(api: Any, store: Store) -> None:
    board = TargetSpec("chessboard", 9, 6, 12.0)
    shots = [
        dataclasses.replace(shot, points=in_part(shot.points, 3, 0, 0))
        for shot in session_of(board, 38, poses=2, cycles=2, flips=False)
        if shot.points is not None
    ]
    session = new_session(api, board)
    store(api, session, shots)
    for analysis in ("repeatability", "intrinsics", "comparison"):
        response = api.client.get(f"/v1/sessions/{session}/{analysis}")
        assert response.status_code == 409, response.text
        assert "origin_unknown" in response.text


def test_the_picture_is_as_large_as_the_sessions_say() -> None:
    """The scenes here: boards wholly within the image."""
    rng = np.random.default_rng(0)
    for _, columns, rows in AMBIGUOUS:
        board = TargetSpec("chessboard", columns, rows, 12.0)
        px = project(transform_points(upright(rng, board, 0.75), board.points_target()), CAMERA)
        assert np.all((px > 0.0) & (px < [WIDTH, HEIGHT]))
