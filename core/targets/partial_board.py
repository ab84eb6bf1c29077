"""A chessboard of which a part is in view: which part, where the picture tells it.

A found lattice is part of the board asked for if it can lie on it: in one of four turns, with the colours right, each
side that is an end of the board on the board's outermost line, and no end of the board's where the lattice goes on.
Marked squares (`core.targets.marked_squares`) then say which part it is. Without them it counts as a part only where
each missing side leaves the picture, and nobody can say which part: its columns and rows count from the part's own
corner. Of the turns in which it fits the target, the one whose x axis points most nearly toward +u is taken. Columns
and rows begin with 0; where the square diagonally beyond the part's corner is white, columns begin with 1 (or rows,
where that leaves no room), so that square (i, j) is black where i + j is even, as on the whole board.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Shaped

from core.errors import TargetMirrored, TargetMismatch
from core.targets.lattice import Lattice
from core.targets.marked_reading import Reading, read_marks
from core.targets.marked_squares import marked_squares
from core.targets.orientation import rightward
from core.targets.specification import TargetSpec
from core.targets.squares import ENOUGH_SQUARES, ENOUGH_VISIBLE, MOST_BEYOND, Board

_ENOUGH_KNOWN = 0.5  # of the corners within the part's outermost lines
_LEAST_CORNERS, _ENOUGH_CORNERS, _ENOUGH_OF_BOARD = 12, 25, 0.25
_NEAR_BORDER = 0.5  # of a step: nearer to it a corner's squares are cut off


@dataclass(frozen=True, slots=True)
class Part:
    """A part of the board asked for: a lattice in the board's order, whose first point is the board's (`column`,
    `row`); where it `is_named`, beyond doubt."""

    lattice: Lattice
    column: int
    row: int
    is_named: bool


@dataclass(frozen=True, slots=True)
class _Placement:
    turns: int
    column: int
    row: int


def find_part(image: Shaped[np.ndarray, "h w"], boards: Sequence[Board], target: TargetSpec) -> Part | None:
    """Return the part of the target that boards found on one level show, or None.

    Raises
    ------
    TargetMismatch
        Two lattices may be parts of it, or the marks of one say that it is part of another board.
    TargetMirrored
        The marks are those of a mirrored print.
    """
    found = []
    for board in boards:
        if _is_worth_it(board, target):
            part = _part(image, board, target)
            if part is not None:
                found.append(part)
    named = [part for part in found if part.is_named]
    best = named or found
    if len(best) > 1:
        raise TargetMismatch(
            f"{len(best)} grids in view may be parts of a {target.columns} x {target.rows} board.",
            "Cover the others, or show the whole board.",
        )
    return best[0] if best else None


def is_mirrored(readings: Sequence[Reading], lattice: Lattice, target: TargetSpec) -> bool:
    """Tell whether a whole board's marks stand where they would on a mirrored print."""
    return any(r.is_mirrored and _is_at_home(r, lattice, target) for r in readings)


def turned_by_marks(readings: Sequence[Reading], lattice: Lattice, target: TargetSpec) -> Lattice | None:
    """Return a whole board's lattice in the order its marks tell, or None where they tell none."""
    right = [r for r in readings if not r.is_mirrored and _is_at_home(r, lattice, target)]
    return _turned(lattice, right[0].turns) if len(right) == 1 else None


def _is_at_home(reading: Reading, lattice: Lattice, target: TargetSpec) -> bool:
    shape = lattice.gap.shape if reading.turns % 2 == 0 else lattice.gap.shape[::-1]
    marks = marked_squares(target)
    return (
        shape == (target.rows, target.columns) and bool(marks) and (reading.column, reading.row) == marks[0]
    )


def _turned(lattice: Lattice, turns: int) -> Lattice:
    for _ in range(turns):
        lattice = lattice.quarter_turn()
    return lattice


def _is_worth_it(board: Board, target: TargetSpec) -> bool:
    """Tell whether enough of a board is seen, and well enough, to be a part of the target."""
    known = board.lattice.known
    enough = max(_LEAST_CORNERS, min(_ENOUGH_CORNERS, _ENOUGH_OF_BOARD * target.size))
    if board.is_whole or board.lattice.cut_short or not board.is_resolved:
        return False
    return bool(known.mean() >= _ENOUGH_KNOWN and known.sum() >= enough)


def _part(image: Shaped[np.ndarray, "h w"], board: Board, target: TargetSpec) -> Part | None:
    places = _placements(board, target)
    readings = read_marks(image, board.lattice)
    straight = [r for r in readings if not r.is_mirrored]
    if len(straight) == 1:
        elbow = marked_squares(target)[:1]
        told = [_Placement(r.turns, i - r.column, j - r.row) for r in straight for i, j in elbow]
        fitting = [place for place in told if place in places]
        if not fitting:
            raise TargetMismatch(
                f"Part of a marked board is in view, but not of one of {target.columns} x {target.rows}."
            )
        place = fitting[0]
        return Part(_turned(board.lattice, place.turns), place.column, place.row, is_named=True)
    if readings and not straight:
        raise TargetMirrored("The marks of the chessboard in view are those of a mirrored print.")
    if not places or not _ends_with_the_picture(board, image.shape):
        return None
    turns = {place.turns: _turned(board.lattice, place.turns) for place in places}
    chosen = max(turns, key=lambda k: (rightward(turns[k]), -k))
    lattice = turns[chosen]
    # every placement in that turn is as good as another: colours are those of the first squares alone
    starts = ((0, 1), (1, 0)) if lattice.origin_is_bright else ((0, 0),)
    rows, columns = lattice.gap.shape
    row, column = min(
        (
            (row, column)
            for row, column in starts
            if column + columns <= target.columns and row + rows <= target.rows
        ),
    )
    return Part(lattice, column, row, is_named=False)


def _placements(board: Board, target: TargetSpec) -> list[_Placement]:
    """Return where on the target a part can lie."""
    found = []
    for turns in range(4):
        lattice = _turned(board.lattice, turns)
        rows, columns = lattice.gap.shape
        top, bottom, left, right = (board.sides[side] for side in _SIDES[turns])
        for row in range(target.rows - rows + 1):
            for column in range(target.columns - columns + 1):
                if lattice.origin_is_bright == ((row + column) % 2 == 0):
                    continue
                at_end = (
                    row == 0,
                    row + rows == target.rows,
                    column == 0,
                    column + columns == target.columns,
                )
                if all(
                    (ends or not side.is_an_end) and not (ends and side.beyond > MOST_BEYOND)
                    for ends, side in zip(at_end, (top, bottom, left, right), strict=True)
                ):
                    found.append(_Placement(turns, column, row))
    return found


_SIDES = ((0, 1, 2, 3), (3, 2, 0, 1), (1, 0, 3, 2), (2, 3, 1, 0))
"""Which of a board's sides (top, bottom, left, right) are those of its lattice after so many quarter turns."""


def _ends_with_the_picture(board: Board, shape: tuple[int, int]) -> bool:
    """Tell whether each side is an end of the board, or the picture ends there: nothing hides any of them.

    Of an outermost line that leaves the picture on its way, the part in the picture must be an end, or go on.
    """
    lattice = board.lattice
    left = ~lattice.known & _beyond_the_picture(lattice, shape)
    for side, known, gone in zip(board.sides, _outermost(lattice.known), _outermost(left), strict=True):
        if side.is_an_end or side.visible < ENOUGH_VISIBLE:
            continue
        missing = np.count_nonzero(~known)
        looked_at = side.visible * np.count_nonzero(known) + missing
        ends = side.squares * looked_at >= ENOUGH_SQUARES * (looked_at - np.count_nonzero(gone))
        if not (np.all(known | gone) if side.beyond > MOST_BEYOND else ends):
            return False
    return True


def _outermost(of: Bool[np.ndarray, "rows columns"]) -> tuple[Bool[np.ndarray, " n"], ...]:
    """Return the top, bottom, left and right line."""
    return of[0], of[-1], of[:, 0], of[:, -1]


def _beyond_the_picture(lattice: Lattice, shape: tuple[int, int]) -> Bool[np.ndarray, "rows columns"]:
    """Return which places of a lattice lie outside the picture, or too near its border to be found, by a plane through
    the corners that are known."""
    row, column = np.nonzero(lattice.known)
    places = np.stack([column, row], axis=1).astype(np.float64)
    H: np.ndarray | None = cv2.findHomography(places, lattice.grid[row, column])[0]
    if H is None:
        return np.zeros(lattice.gap.shape, dtype=np.bool_)
    j, i = np.mgrid[0 : lattice.gap.shape[0], 0 : lattice.gap.shape[1]]
    u, v, ahead = (H[k, 0] * i + H[k, 1] * j + H[k, 2] for k in range(3))
    margin = _NEAR_BORDER * float(np.nanmedian(np.linalg.norm(np.diff(lattice.grid, axis=1), axis=2)))
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v = u / ahead, v / ahead
        inside = (u > margin) & (v > margin) & (u < shape[1] - 1 - margin) & (v < shape[0] - 1 - margin)
    return np.asarray(~inside | (ahead <= 0.0))
