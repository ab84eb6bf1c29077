"""Boards that look the same when turned: one reading over all images of a session."""

from __future__ import annotations

import math

import numpy as np
import pytest

from core.calibration.multi_view.board_symmetry import (
    nearest_turn,
    quarter_turns,
    resolve_symmetry,
    symmetry_rotations,
    turned_cells,
)
from core.calibration.multi_view.view_stack import stack_views
from core.geometry.roll_pitch_yaw import rpy_to_rotation
from core.geometry.se3 import so3_exp, transform_points
from core.targets.specification import GridPoints, TargetSpec


@pytest.mark.parametrize(
    ("kind", "columns", "rows", "turns"),
    [
        ("chessboard", 9, 6, 1),
        ("chessboard", 10, 6, 2),
        ("chessboard", 9, 9, 2),
        ("chessboard", 8, 8, 4),
        ("charuco", 10, 6, 1),
        ("circles", 9, 6, 2),
        ("circles", 7, 7, 4),
        ("asymmetric_circles", 4, 11, 1),
        ("asymmetric_circles", 4, 10, 2),
        ("aprilgrid", 6, 6, 1),
    ],
)
def test_a_turn_maps_the_grid_onto_itself(kind: str, columns: int, rows: int, turns: int) -> None:
    target = TargetSpec(kind, columns, rows, 10.0)
    found = symmetry_rotations(target)
    assert len(found) == turns
    np.testing.assert_array_equal(found[0], np.eye(4))
    grid = {tuple(p) for p in np.round(target.points_target(), 6) + 0.0}
    for T in found:
        assert {tuple(p) for p in np.round(transform_points(T, target.points_target()), 6) + 0.0} == grid


def orientations(rng: np.random.Generator, poses: int) -> np.ndarray:
    """Cameras that look at a board, turned about its normal by anything."""
    return np.array(
        [
            so3_exp(np.array([0.0, 0.0, rng.uniform(-math.pi, math.pi)]))
            @ so3_exp(np.array([*rng.uniform(-0.6, 0.6, 2), 0.0]))
            for _ in range(poses)
        ]
    )


@pytest.mark.parametrize(("columns", "rows"), [(10, 6), (8, 8)])
def test_commanded_orientations_decide_between_poses(columns: int, rows: int) -> None:
    rng = np.random.default_rng(1)
    turns = symmetry_rotations(TargetSpec("chessboard", columns, rows, 10.0))
    for _ in range(20):
        true = orientations(rng, 8)
        mounting, base = so3_exp(rng.normal(size=3)), so3_exp(rng.normal(size=3))
        commanded = {i: base @ R @ mounting for i, R in enumerate(true)}
        seen, poses, expected = [], [], []
        for i, R in enumerate(true):
            for _ in range(3):
                read = int(rng.integers(len(turns)))
                seen.append(turns[read][:3, :3] @ so3_exp(rng.normal(0.0, 1e-3, 3)) @ R)
                poses.append(i)
                expected.append(read)
        readings = resolve_symmetry(np.array(seen), poses, turns, commanded)
        assert readings.settled
        assert readings.ambiguous == ()
        # All are turned back, but for one turn that all have in common.
        back = [turns[t][:3, :3].T @ R for t, R in zip(readings.turns, seen, strict=True)]
        common = [b @ true[pose].T for b, pose in zip(back, poses, strict=True)]
        assert np.max(np.abs(np.array(common) - common[0])) < 0.02


def test_without_commands_the_least_turn_is_taken_and_uncertainty_is_reported() -> None:
    turns = symmetry_rotations(TargetSpec("chessboard", 10, 6, 10.0))
    about = [so3_exp(np.array([0.0, 0.0, math.radians(angle)])) for angle in (0.0, 170.0, -20.0, 265.0)]
    readings = resolve_symmetry(np.array(about), ["a", "b", "c", "d"], turns, {})
    assert list(readings.turns) == [0, 1, 0, 0]
    assert not readings.settled
    assert readings.ambiguous == ("d",)


def test_commands_of_some_poses_only() -> None:
    turns = symmetry_rotations(TargetSpec("chessboard", 10, 6, 10.0))
    tilted = rpy_to_rotation(np.array([0.3, -0.2, 0.0]))
    true = {"a": tilted, "b": so3_exp(np.array([0.0, 0.1, math.radians(150.0)])) @ tilted, "c": tilted}
    seen = [true["a"], turns[1][:3, :3] @ true["b"], turns[1][:3, :3] @ true["c"]]
    commanded = {"a": true["a"], "b": true["b"]}
    readings = resolve_symmetry(np.array(seen), ["a", "b", "c"], turns, commanded)
    assert list(readings.turns) == [0, 1, 1]
    assert not readings.settled


def test_images_that_show_their_origin_are_never_turned_and_anchor_the_others() -> None:
    rng = np.random.default_rng(4)
    turns = symmetry_rotations(TargetSpec("circles", 7, 7, 10.0))
    true = orientations(rng, 8)
    mounting, base = so3_exp(rng.normal(size=3)), so3_exp(rng.normal(size=3))
    commanded = {i: base @ R @ mounting for i, R in enumerate(true)}
    for trial in range(20):
        seen, poses, expected, known = [], [], [], []
        for i, R in enumerate(true):
            for cycle in range(3):
                sure = i == trial % 8 and cycle == 2
                read = 0 if sure else int(rng.integers(4))
                seen.append(turns[read][:3, :3] @ so3_exp(rng.normal(0.0, 1e-3, 3)) @ R)
                poses.append(i)
                expected.append(read)
                known.append(sure)
        readings = resolve_symmetry(np.array(seen), poses, turns, commanded, known)
        # One sure image settles all: here not even a common turn is left open.
        assert readings.turns.tolist() == expected
        assert readings.settled
        assert not readings.unclear.any()


def test_a_board_that_shows_its_origin_is_compared_with_commands_all_the_same() -> None:
    rng = np.random.default_rng(5)
    turns = symmetry_rotations(TargetSpec("chessboard", 9, 6, 10.0))
    true = orientations(rng, 6)
    mounting = so3_exp(rng.normal(size=3))
    commanded = {f"P{i}": R @ mounting for i, R in enumerate(true)}
    names = [f"P{i}" for i in range(6)]
    fine = resolve_symmetry(true, names, turns, commanded, [True] * 6)
    assert (fine.contradicting, fine.ambiguous, fine.settled) == ((), (), True)
    commanded["P3"] = so3_exp(np.array([0.0, 0.7, 0.4])) @ commanded["P3"]
    assert resolve_symmetry(true, names, turns, commanded, [True] * 6).contradicting == ("P3",)
    # Of three, none can be said to be the wrong one.
    few = {name: commanded[name] for name in ("P2", "P3", "P4")}
    assert resolve_symmetry(true, names, turns, few, [True] * 6).contradicting == ()


def test_an_image_of_another_orientation_is_unclear_within_its_pose() -> None:
    turns = symmetry_rotations(TargetSpec("chessboard", 10, 6, 10.0))
    about = [so3_exp(np.array([0.0, 0.0, math.radians(angle)])) for angle in (0.0, 180.5, 88.0)]
    readings = resolve_symmetry(np.array(about), ["a", "a", "a"], turns, {})
    assert readings.unclear.tolist() == [False, False, True]
    assert readings.turns.tolist()[:2] == [0, 1]


def test_a_thousand_poses_are_read_like_a_few() -> None:
    """In rounds, so that many poses take no more than a few looks at all of them."""
    rng = np.random.default_rng(6)
    turns = symmetry_rotations(TargetSpec("chessboard", 10, 6, 10.0))
    true = orientations(rng, 1200)
    mounting = so3_exp(rng.normal(size=3))
    read = rng.integers(2, size=len(true))
    seen = np.array([turns[t][:3, :3] @ R for t, R in zip(read, true, strict=True)])
    commanded = {i: R @ mounting for i, R in enumerate(true)}
    readings = resolve_symmetry(seen, list(range(len(true))), turns, commanded)
    assert readings.settled
    assert np.all(readings.turns == read) or np.all(readings.turns != read)


@pytest.mark.parametrize(
    ("kind", "size"), [("chessboard", (10, 6)), ("chessboard", (8, 8)), ("circles", (7, 7))]
)
def test_labels_of_one_pose_match_by_the_turn_between_them(kind: str, size: tuple[int, int]) -> None:
    target = TargetSpec(kind, *size, 10.0)
    row, column = (a.ravel() for a in np.mgrid[0 : target.rows, 0 : target.columns])
    px = 300.0 + 4.0 * target.points_target()[:, :2]
    reference = GridPoints(target, 1000, 800, column, row, px, np.ones(len(px)))
    for quarters in quarter_turns(target):
        cells = turned_cells(target, column, row, quarters)
        view = GridPoints(target, 1000, 800, *cells, px + 1.5, np.ones(len(px)))
        turn = nearest_turn(stack_views([reference, view]), 0, 1)
        assert turn is not None
        back = turned_cells(target, view.column, view.row, -turn % 4)
        np.testing.assert_array_equal(np.stack(back), np.stack([column, row]))
    elsewhere = GridPoints(target, 1000, 800, column, row, px + 400.0, np.ones(len(px)))
    assert nearest_turn(stack_views([reference, elsewhere]), 0, 1) is None
