"""Grid points named by another image of the same pose: parts of boards, and boards that look the same when turned."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from core.calibration.naming_parts import name_points
from core.calibration.readings import quarter_turns, turned_cells
from core.camera import Camera, project
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


def picture(target: TargetSpec, seed: int, shake_mm: float = 0.1, tilt: float = 0.5) -> GridPoints:
    """A whole board, at a pose that differs from seed to seed as a robot's does."""
    rng = np.random.default_rng(seed)
    R = so3_exp(np.array([tilt, 0.2, 1.2]))
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
    """What a detector reports of a part: counted from the part's own corner, its axes turned by quarter turns."""
    wide = np.arange(points.target.columns)[columns]
    high = np.arange(points.target.rows)[rows]
    seen = chosen(points, np.isin(points.column, wide) & np.isin(points.row, high))
    c, r = seen.column - wide[0], seen.row - high[0]
    last_c, last_r = len(wide) - 1, len(high) - 1
    column, row = ((c, r), (last_r - r, c), (last_c - c, last_r - r), (r, last_c - c))[quarters]
    return replace(seen, column=column, row=row, origin="unknown")


@pytest.mark.parametrize("quarters", range(4))
@pytest.mark.parametrize(("kind", "columns", "rows"), [("chessboard", 9, 6), *KINDS])
def test_a_part_is_named_by_a_picture_of_the_whole(kind: str, columns: int, rows: int, quarters: int) -> None:
    target = TargetSpec(kind, columns, rows, 10.0)
    reference = picture(target, 1)
    for wide, high in (
        (slice(0, 4), slice(0, 4)),
        (slice(2, 6), slice(1, 5)),
        (slice(1, None), slice(0, None)),
    ):
        seen = part(picture(target, 2), wide, high, quarters)
        named = name_points(seen, reference)
        assert named is not None
        true = chosen(
            reference,
            np.isin(reference.column, np.arange(columns)[wide])
            & np.isin(reference.row, np.arange(rows)[high]),
        )
        np.testing.assert_array_equal(named.column, true.column)
        np.testing.assert_array_equal(named.row, true.row)
        assert named.changed == (quarters != 0 or (wide.start, high.start) != (0, 0))


def test_holes_in_either_picture_and_gross_errors_do_not_matter() -> None:
    rng = np.random.default_rng(3)
    target = TargetSpec("chessboard", 10, 6, 10.0)
    reference = chosen(picture(target, 1), rng.random(target.size) > 0.2)
    seen = part(picture(target, 2), slice(3, 9), slice(1, 6), 1)
    whole = picture(target, 2)
    true = chosen(whole, np.isin(whole.column, np.arange(3, 9)) & np.isin(whole.row, np.arange(1, 6)))
    keep = rng.random(len(seen)) > 0.2
    px = seen.points_px.copy()
    px[:3] += 25.0
    named = name_points(chosen(replace(seen, points_px=px), keep), reference)
    assert named is not None
    np.testing.assert_array_equal(named.column, true.column[keep])
    np.testing.assert_array_equal(named.row, true.row[keep])


def test_a_part_from_another_pose_is_not_named() -> None:
    target = TargetSpec("chessboard", 10, 6, 10.0)
    reference = picture(target, 1)
    seen = part(picture(target, 2), slice(2, 7), slice(0, 5), 0)
    # Half a square aside: as near to one name as to the next.
    step = np.median(np.diff(reference.points_px.reshape(6, 10, 2), axis=1), axis=(0, 1))
    assert name_points(replace(seen, points_px=seen.points_px + 0.5 * step), reference) is None
    # From nearer, so that only points in the middle agree.
    middle = seen.points_px.mean(axis=0)
    nearer = replace(seen, points_px=middle + 1.5 * (seen.points_px - middle))
    assert name_points(nearer, reference) is None
    # What would lie beyond the board's end is no part of it.
    beyond = replace(seen, points_px=seen.points_px + 5.0 * step)
    assert name_points(beyond, reference) is None
    assert name_points(chosen(seen, np.zeros(len(seen), dtype=np.bool_)), reference) is None


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
        assert named is not None
        np.testing.assert_array_equal(named.column, whole.column)
        np.testing.assert_array_equal(named.row, whole.row)
        assert named.changed == (quarters != 0)


def test_what_is_known_stays_and_what_no_turn_brings_near_is_not_named() -> None:
    target = TargetSpec("chessboard", 10, 6, 10.0)
    reference = picture(target, 1)
    known = picture(target, 2, tilt=-0.4)
    named = name_points(known, reference)
    assert named is not None
    assert not named.changed
    aside = replace(known, points_px=known.points_px + np.array([900.0, 300.0]), origin="turned")
    assert name_points(aside, reference) is None
    little = chosen(reference, reference.column < 3)
    assert name_points(replace(picture(target, 2), origin="turned"), little) is None
