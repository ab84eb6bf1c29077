"""Grid points named by another image of the same pose: parts of boards, and boards that look the same when turned."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeGuard

import numpy as np
import pytest

from core.calibration.naming_parts import Named, name_points, stands_with
from core.calibration.readings import quarter_turns, turned_cells
from core.camera import Camera, project
from core.simulation import Scene, render
from core.targets import detect
from core.targets.specification import GridPoints, TargetSpec
from core.transforms import so3_exp, transform, transform_points

CAMERA = Camera(1500.0, 1500.0, 640.0, 480.0, -0.1, 0.02)
KINDS = [
    ("chessboard", 10, 6),
    ("chessboard", 8, 8),
    ("chessboard", 7, 7),
    ("circles", 9, 6),
    ("circles", 7, 7),
]


def picture(
    target: TargetSpec, seed: int, shake_mm: float = 0.1, tilt: float = 0.5, roll: float = 1.2
) -> GridPoints:
    """A whole board, at a pose that differs from seed to seed as a robot's does."""
    rng = np.random.default_rng(seed)
    R = so3_exp(np.array([tilt, 0.2 if roll else 0.0, roll]))
    middle = np.array([5.0, -3.0, 400.0]) + rng.normal(0.0, shake_mm, 3)
    T = transform(R, middle - R @ target.points_target().mean(axis=0))
    px = project(transform_points(T, target.points_target()), CAMERA) + rng.normal(
        0.0, 0.05, (target.size, 2)
    )
    row, column = (a.ravel() for a in np.mgrid[0 : target.rows, 0 : target.columns])
    return GridPoints(target, 1280, 960, column, row, px, np.full(target.size, 0.05))


def chosen(points: GridPoints, keep: np.ndarray) -> GridPoints:
    return replace(
        points,
        column=points.column[keep],
        row=points.row[keep],
        points_px=points.points_px[keep],
        standard_uncertainty_px=points.standard_uncertainty_px[keep],
    )


def part(points: GridPoints, columns: slice, rows: slice, quarters: int) -> GridPoints:
    """What a detector reports of a part: counted from the part's own corner, its axes turned by quarter turns; of a
    chessboard from one column on where that makes square (i, j) black for even i + j."""
    wide = np.arange(points.target.columns)[columns]
    high = np.arange(points.target.rows)[rows]
    seen = within(points, columns, rows)
    c, r = seen.column - wide[0], seen.row - high[0]
    last_c, last_r = len(wide) - 1, len(high) - 1
    column, row = ((c, r), (last_r - r, c), (last_c - c, last_r - r), (r, last_c - c))[quarters]
    first = (column <= 1) & (row <= 1)
    is_bright = int(seen.column[first].min() + seen.row[first].min()) % 2 == 1
    if points.target.kind == "chessboard" and is_bright:
        column = column + 1
    return replace(seen, column=column, row=row, origin="unknown")


def within(points: GridPoints, columns: slice, rows: slice) -> GridPoints:
    wide = np.arange(points.target.columns)[columns]
    high = np.arange(points.target.rows)[rows]
    return chosen(points, np.isin(points.column, wide) & np.isin(points.row, high))


def is_named(found: Named | str) -> TypeGuard[Named]:
    return isinstance(found, Named)


@pytest.mark.parametrize("quarters", range(4))
@pytest.mark.parametrize(("kind", "columns", "rows"), [("chessboard", 9, 6), *KINDS])
def test_a_part_is_named_by_a_picture_of_the_same_part(
    kind: str, columns: int, rows: int, quarters: int
) -> None:
    """By one that shows its origin, as marked squares do."""
    target = TargetSpec(kind, columns, rows, 10.0)
    for wide, high in (
        (slice(0, 4), slice(0, 4)),
        (slice(2, 6), slice(1, 5)),
        (slice(1, None), slice(0, None)),
    ):
        seen = part(picture(target, 2), wide, high, quarters)
        reference = within(picture(target, 1), wide, high)
        named = name_points(seen, reference)
        assert is_named(named)
        np.testing.assert_array_equal(named.column, reference.column)
        np.testing.assert_array_equal(named.row, reference.row)
        counts = (seen.column, seen.row)
        same = all(
            np.array_equal(*pair) for pair in zip(counts, (reference.column, reference.row), strict=True)
        )
        assert named.changed != same


def test_holes_in_either_picture_and_gross_errors_do_not_matter() -> None:
    rng = np.random.default_rng(3)
    target = TargetSpec("chessboard", 10, 6, 10.0)
    true = within(picture(target, 2), slice(3, 9), slice(1, 6))
    seen = part(picture(target, 2), slice(3, 9), slice(1, 6), 1)
    reference = within(picture(target, 1), slice(3, 9), slice(1, 6))
    keep = rng.random(len(seen)) > 0.2
    px = seen.points_px.copy()
    px[:3] += 25.0
    named = name_points(
        chosen(replace(seen, points_px=px), keep), chosen(reference, rng.random(len(reference)) > 0.2)
    )
    assert is_named(named)
    np.testing.assert_array_equal(named.column, true.column[keep])
    np.testing.assert_array_equal(named.row, true.row[keep])


def test_a_part_from_another_pose_is_not_named() -> None:
    target = TargetSpec("chessboard", 10, 6, 10.0)
    reference = picture(target, 1)
    seen = part(picture(target, 2), slice(2, 7), slice(0, 5), 0)
    # Half a square aside: as near to one name as to the next.
    step = np.median(np.diff(reference.points_px.reshape(6, 10, 2), axis=1), axis=(0, 1))
    assert name_points(replace(seen, points_px=seen.points_px + 0.5 * step), reference) == "unlike"
    # From nearer, so that only points in the middle agree.
    middle = seen.points_px.mean(axis=0)
    nearer = replace(seen, points_px=middle + 1.5 * (seen.points_px - middle))
    assert name_points(nearer, reference) == "unlike"
    # What would lie beyond the board's end is no part of it.
    beyond = replace(seen, points_px=seen.points_px + 4.0 * step)
    assert name_points(beyond, reference) == "aside"
    assert name_points(chosen(seen, np.zeros(len(seen), dtype=np.bool_)), reference) == "unlike"


def at_the_left_border(points: GridPoints, steps: float) -> GridPoints:
    """The picture cut so that its left border lies so many steps before the grid's first column."""
    grid = points.points_px.reshape(points.target.rows, points.target.columns, 2)
    step = float(np.median(grid[:, 1, 0] - grid[:, 0, 0]))
    return replace(points, points_px=points.points_px - [grid[:, 0, 0].mean() - steps * step, 0.0])


@pytest.mark.parametrize("kind", ["chessboard", "circles"])
@pytest.mark.parametrize("quarters", range(4))
def test_a_part_ends_with_the_picture_or_with_the_board(kind: str, quarters: int) -> None:
    target = TargetSpec(kind, 9, 6, 10.0)
    whole = picture(target, 1, tilt=0.0, roll=0.0)
    seen = part(at_the_left_border(whole, 0.6), slice(1, None), slice(None), quarters)
    # The column that is missing lies at the border, where a little less of it is not found.
    named = name_points(seen, at_the_left_border(whole, 0.6))
    assert is_named(named)
    assert named.column.min() == 1
    # Two columns further from the border it would be seen: what ends there is the board.
    farther = part(at_the_left_border(whole, 2.6), slice(1, None), slice(None), quarters)
    assert name_points(farther, at_the_left_border(whole, 2.6)) == "aside"
    # So does a board that hangs out of the picture by two columns and is seen where it had not.
    gone = part(at_the_left_border(whole, -1.4), slice(2, None), slice(None), quarters)
    for reference in (at_the_left_border(whole, 0.6), at_the_left_border(whole, 1.6)):
        assert name_points(gone, reference) == "aside"


@pytest.mark.parametrize("quarters", range(4))
@pytest.mark.parametrize("columns", [9, 10])
@pytest.mark.parametrize("aside", [-1, 1])
def test_squares_of_the_other_colour_are_no_place_for_a_part(columns: int, aside: int, quarters: int) -> None:
    """A picture so narrow that no end of the board is in it, before which the board moved by a square."""
    names = {}
    for kind in ("circles", "chessboard"):
        target = TargetSpec(kind, columns, 6, 10.0)
        whole = picture(target, 1, tilt=0.0, roll=0.0)
        step = float(np.median(np.diff(whole.points_px.reshape(6, columns, 2)[..., 0], axis=1)))
        reference = within(whole, slice(2, 7), slice(None))
        left = reference.points_px[:, 0].min() - 0.6 * step
        narrow = round(reference.points_px[:, 0].max() + 0.6 * step - left)
        reference = replace(
            reference, image_width_px=narrow, points_px=reference.points_px - np.array([left, 0.0])
        )
        moved = replace(
            whole, image_width_px=narrow, points_px=whole.points_px - np.array([left - aside * step, 0.0])
        )
        first = 2 if aside > 0 else 3
        names[kind] = name_points(part(moved, slice(first, first + 4), slice(None), quarters), reference)
    # Nothing tells of dots; of squares the colours do.
    assert is_named(names["circles"])
    assert names["chessboard"] == "aside"


def test_named_pictures_stand_together_or_not() -> None:
    target = TargetSpec("chessboard", 10, 6, 10.0)
    reference, again = picture(target, 1), picture(target, 2)
    step = np.median(np.diff(reference.points_px.reshape(6, 10, 2), axis=1), axis=(0, 1))
    assert stands_with(again, reference)
    assert stands_with(replace(again, points_px=again.points_px + 0.15 * step), reference)
    for aside in (0.35, 1.0, 2.0):
        assert not stands_with(replace(again, points_px=again.points_px + aside * step), reference)
    # A corner or two astray are no board elsewhere; half a board is.
    px = again.points_px.copy()
    px[:2] += 40.0
    assert stands_with(replace(again, points_px=px), reference)
    px[:30] += 40.0
    assert not stands_with(replace(again, points_px=px), reference)
    # Nor is one that shows other points.
    assert not stands_with(chosen(again, again.column > 5), chosen(reference, reference.column < 6))


@pytest.mark.parametrize(("kind", "columns", "rows"), [*KINDS, ("asymmetric_circles", 4, 10)])
def test_a_board_that_looks_the_same_turned_takes_the_references_reading(
    kind: str, columns: int, rows: int
) -> None:
    target = TargetSpec(kind, columns, rows, 10.0)
    reference = picture(target, 1)
    for quarters in quarter_turns(target):
        whole = picture(target, 2, shake_mm=3.0)
        column, row = turned_cells(target, whole.column, whole.row, quarters)
        named = name_points(replace(whole, column=column, row=row, origin="turned"), reference)
        assert is_named(named)
        np.testing.assert_array_equal(named.column, whole.column)
        np.testing.assert_array_equal(named.row, whole.row)
        assert named.changed == (quarters != 0)


def test_what_is_known_stays_and_what_no_turn_brings_near_is_not_named() -> None:
    target = TargetSpec("chessboard", 10, 6, 10.0)
    reference = picture(target, 1)
    known = picture(target, 2, tilt=-0.4)
    named = name_points(known, reference)
    assert is_named(named)
    assert not named.changed
    aside = replace(known, points_px=known.points_px + np.array([900.0, 300.0]), origin="turned")
    assert name_points(aside, reference) == "unlike"
    little = chosen(reference, reference.column < 3)
    assert name_points(replace(picture(target, 2), origin="turned"), little) == "unlike"


def test_a_rendered_board_that_moved_by_two_squares_is_not_named_by_where_it_stood() -> None:
    target = TargetSpec("chessboard", 9, 6, 20.0)
    camera = Camera(1000.0, 1000.0, 503.0, 396.0, -0.1, 0.05)
    R = so3_exp(np.array([0.35, -0.2, 0.1]))
    scene = Scene(target, camera, np.eye(4), 1000, 800, noise_levels=3.0, clutter=0.5, seed=5)

    def taken(right_mm: float, marks: bool = False) -> GridPoints:
        middle = np.array([right_mm, 4.0, 420.0])
        T = transform(R, middle - R @ target.points_target().mean(axis=0))
        return detect(render(replace(scene, T_camera_target=T, marks=marks)), target)

    along = float(R[0, 0]) * target.pitch_mm
    reference = taken(100.0)
    assert (reference.origin, len(reference)) == ("known", target.size)
    moved = taken(100.0 + 2.0 * along)
    # It hangs out of the picture, and covers the same pixels with the same pattern.
    assert moved.origin == "unknown"
    assert name_points(moved, reference) == "aside"
    # Where one that shows its origin has it, it is named.
    marked = taken(100.0 + 2.0 * along, marks=True)
    assert (marked.origin, marked.column.min()) == ("known", 0)
    assert len(marked) < target.size
    named = name_points(moved, marked)
    assert is_named(named)
    px = np.full((6, 9, 2), np.nan)
    px[marked.row, marked.column] = marked.points_px
    away = np.linalg.norm(px[named.row, named.column] - moved.points_px, axis=1)
    assert np.nanmax(away) < 2.0
