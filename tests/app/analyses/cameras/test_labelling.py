"""Sessions whose images label the same board differently, turned; no figure ever mixes two readings."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
import sqlalchemy as sa

from app.records.tables import Measurement, Result
from core.calibration.multi_view.board_symmetry import quarter_turns, turned_cells
from core.geometry.camera import project
from core.geometry.se3 import invert, so3_exp, transform, transform_points
from core.targets.specification import GridPoints, Labelling, TargetSpec
from tests.support.sessions.repeatability import table
from tests.support.sessions.stored_sessions import (
    CAMERA,
    HEIGHT,
    WIDTH,
    Shot,
    Store,
    codes,
    commanded_pose,
    look,
)

NOISE = 0.02


def new_session(api: Any, board: TargetSpec) -> str:
    fields = {"kind": board.kind, "columns": board.columns, "rows": board.rows, "pitch_mm": board.pitch_mm}
    return str(api.make_session(api.make_target(**fields)))


def upright(rng: np.random.Generator, board: TargetSpec, tilt: float) -> np.ndarray:
    """T_camera_target with the board's x axis within the robot's scatter of the vertical: its reading flips."""
    R = so3_exp(np.array([tilt, 0.3 * tilt, 0.0])) @ so3_exp(np.array([0.0, 0.0, 0.5 * math.pi]))
    middle = np.array([*rng.uniform(-15.0, 15.0, 2), 330.0])
    return transform(R, middle - R @ board.points_target().mean(axis=0))


def read(points: GridPoints, quarters: int, labelling: Labelling) -> GridPoints:
    """The same image as a detector that reads the board turned reports it, row by row."""
    column, row = turned_cells(points.target, points.column, points.row, quarters)
    order = np.lexsort((column, row))
    turned = dataclasses.replace(points, column=column, row=row, labelling=labelling)
    return turned.take(order)


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
        commanded = invert(upright(rng, board, float(tilt)))
        for cycle in range(1, cycles + 1):
            true = transform(commanded[:3, :3], commanded[:3, 3] + rng.normal(0.0, scatter_mm, 3))
            points = look(rng, invert(true), board=board, sigma_px=NOISE)
            quarters = int(chance.choice(turns)) if flips and len(turns) > 1 else 0
            labelling: Labelling = "up_to_symmetry" if len(turns) > 1 else "absolute"
            shots.append(Shot(f"P{index + 1}", cycle, read(points, quarters, labelling), true))
    return shots


def figures(document: dict[str, Any]) -> list[float]:
    return [row[kind]["rp_l_mm"] for row in document["poses"] for kind in ("repeatability", "noise_floor")]


AMBIGUOUS = [
    ("chessboard", 10, 6),
    ("chessboard", 8, 6),
    ("chessboard", 8, 8),
    ("circles", 9, 6),
    ("circles", 7, 7),
    ("asymmetric_circles", 4, 10),
]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "columns", "rows", "estimator"),
    [*((*board, "pooled") for board in AMBIGUOUS), ("chessboard", 8, 8, "per_image_fixed_pp")],
)
def test_images_that_flip_within_a_pose_get_one_labelling(
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
    assert all(row["cycles"] == 10 for row in flipped["poses"])
    largest = 0.6 if estimator == "pooled" else 6.0  # a flip moves the camera by some hundred millimetres
    assert all(row["repeatability"]["rp_l_mm"] < largest for row in flipped["poses"])
    assert "orientation_inconsistent" not in codes(flipped)


@pytest.mark.slow
def test_boards_that_show_their_origin_are_never_turned_nor_called_ambiguous(api: Any, store: Store) -> None:
    """A larger dot at the origin or marked squares: by its kind alone such a board would be ambiguous."""
    for board in (TargetSpec("circles", 9, 6, 12.0), TargetSpec("chessboard", 10, 6, 12.0)):
        rng = np.random.default_rng(32)
        shots = [
            dataclasses.replace(shot, points=dataclasses.replace(shot.points, labelling="absolute"))
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
        assert "board_symmetry_unresolved" not in codes(document)
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
    assert row["cycles"] == 10
    assert all(row["repeatability"]["rp_l_mm"] < 0.6 for row in document["poses"])


def test_an_image_under_the_wrong_pose_is_no_visit_to_it(api: Any, store: Store) -> None:
    board = TargetSpec("chessboard", 10, 6, 12.0)
    shots = session_of(board, 34)
    rng = np.random.default_rng(2)
    quarter = invert(shots[0].T_target_camera) @ transform(
        so3_exp(np.array([0.0, 0.0, 0.5 * math.pi])), np.zeros(3)
    )
    points = look(rng, quarter, board=board, sigma_px=NOISE)
    stray = Shot("P1", 11, dataclasses.replace(points, labelling="up_to_symmetry"), invert(quarter))
    session = new_session(api, board)
    ids = store(api, session, [*shots, stray])
    document = table(api, session)
    row = document["poses"][0]
    assert [(e["measurement_id"], e["code"]) for e in row["excluded"]] == [
        (ids[-1], "orientation_inconsistent")
    ]
    assert row["cycles"] == 10
    (warning,) = [w for w in document["warnings"] if w["code"] == "orientation_inconsistent"]
    assert "P1" in warning["detail"]


def commanded_poses(shots: list[Shot], scramble: str | None = None) -> dict[str, dict[str, Any]]:
    """What the robot was commanded, in its base; at the pose `scramble` something else."""
    base = transform(so3_exp(np.array([-0.5, 0.2, 1.4])), np.array([700.0, -100.0, 300.0]))
    mounting = transform(so3_exp(np.array([0.3, -2.0, 0.4])), np.array([20.0, 10.0, 80.0]))
    fields = {}
    for shot in shots:
        T = base @ shot.T_target_camera @ mounting
        if shot.pose_id == scramble:
            T = T @ transform(so3_exp(np.array([0.9, -0.8, 0.7])), np.zeros(3))
        fields[shot.pose_id] = commanded_pose(T)
    return fields


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "columns", "rows"), [("chessboard", 9, 6), ("chessboard", 10, 6)])
def test_a_pose_that_contradicts_its_command_is_named(
    api: Any, store: Store, kind: str, columns: int, rows: int
) -> None:
    board = TargetSpec(kind, columns, rows, 12.0)
    shots = session_of(board, 35, poses=6, cycles=4)
    session = new_session(api, board)
    store(api, session, shots)
    for pose_id, fields in commanded_poses(shots).items():
        api.client.put(f"/v1/sessions/{session}/poses/{pose_id}", json=fields)
    assert {"commanded_pose_inconsistent", "board_symmetry_unresolved"}.isdisjoint(codes(table(api, session)))
    for pose_id, fields in commanded_poses(shots, scramble="P4").items():
        api.client.put(f"/v1/sessions/{session}/poses/{pose_id}", json=fields)
    (warning,) = [w for w in table(api, session)["warnings"] if w["code"] == "commanded_pose_inconsistent"]
    assert warning["detail"].endswith(": P4.")


def test_a_partial_view_that_an_earlier_build_stored_is_excluded(api: Any, store: Store) -> None:
    """Its points count from its own corner: they label nothing."""
    board = TargetSpec("chessboard", 9, 6, 12.0)
    session = new_session(api, board)
    ids = store(api, session, session_of(board, 42, poses=2, cycles=4, flips=False))
    with api.installation.database.write() as records:
        records.execute(
            sa.update(Measurement)
            .where(Measurement.id == ids[0])
            .values(status="failed", failure_code="labelling_ambiguous", failure_detail="A partial view.")
        )
        records.execute(sa.update(Result).where(Result.measurement_id == ids[0]).values(labelling="partial"))
    row = table(api, session)["poses"][0]
    assert [(e["measurement_id"], e["code"]) for e in row["excluded"]] == [(ids[0], "labelling_ambiguous")]
    assert row["cycles"] == 3


def test_the_image_is_as_large_as_the_sessions_say() -> None:
    """The scenes here: boards wholly within the image."""
    rng = np.random.default_rng(0)
    for _, columns, rows in AMBIGUOUS:
        board = TargetSpec("chessboard", columns, rows, 12.0)
        px = project(transform_points(upright(rng, board, 0.75), board.points_target()), CAMERA)
        assert np.all((px > 0.0) & (px < [WIDTH, HEIGHT]))
