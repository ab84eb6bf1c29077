"""A partial view of a chessboard with marked squares, and where on the board it lies.

A found lattice is a partial view of the board asked for if it can lie on it: in one of four turns, with the
colours right, each side that is an end of the board on the board's outermost line, and no end of the board's
where the lattice goes on. Marked squares (`core.targets.chessboard.fiducial_dots`) then determine where.
Without them a partial view fits at several places, and is rejected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Shaped

from core.errors import TargetMirrored, TargetMismatch
from core.targets.chessboard.fiducial_dots import Reading, decode_fiducial_dots, marked_squares
from core.targets.lattice import Board, Lattice
from core.targets.specification import TargetSpec

_MIN_KNOWN_SHARE = 0.5  # of the corners within the part's outermost lines
_MIN_CORNERS, _SUFFICIENT_CORNERS, _MIN_BOARD_SHARE = 12, 25, 0.25


@dataclass(frozen=True, slots=True)
class PartialView:
    """All or a part of the board asked for: a lattice in the board's order, whose first point is the board's
    (`column`, `row`)."""

    lattice: Lattice
    column: int
    row: int


@dataclass(frozen=True, slots=True)
class _Placement:
    turns: int
    column: int
    row: int


def match_partial_view(
    image: Shaped[np.ndarray, "h w"], boards: Sequence[Board], target: TargetSpec
) -> PartialView | None:
    """Return the part of the target that the marks of one of the boards found on one level determine, or None.

    Raises
    ------
    TargetMismatch
        Two boards are parts of it, or the marks of one determine that it is part of another board.
    TargetMirrored
        The marks are those of a mirrored print.
    """
    found = [part for board in boards if (part := _part(image, board, target)) is not None]
    if len(found) > 1:
        raise TargetMismatch(
            f"{len(found)} grids in view are parts of a {target.columns} x {target.rows} board.",
            "Cover the others, or show the whole board.",
        )
    return found[0] if found else None


def may_be_part(board: Board, target: TargetSpec) -> bool:
    """Return whether a board may be a partial view of the target, at one place of it or at several."""
    return _is_worth_it(board, target) and bool(_placements(board, target))


def is_mirrored(readings: Sequence[Reading], lattice: Lattice, target: TargetSpec) -> bool:
    """Return whether a whole board's marks lie where they would on a mirrored print."""
    return any(r.is_mirrored and _is_at_home(r, lattice, target) for r in readings)


def turned_by_marks(readings: Sequence[Reading], lattice: Lattice, target: TargetSpec) -> Lattice | None:
    """Return a whole board's lattice in the order that its marks determine, or None where they determine none."""
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
    """Return whether enough of a board is seen, and well enough, to be a part of the target."""
    known = board.lattice.known
    enough = max(_MIN_CORNERS, min(_SUFFICIENT_CORNERS, _MIN_BOARD_SHARE * target.size))
    if board.is_whole or board.lattice.cut_short or not board.is_resolved:
        return False
    return bool(known.mean() >= _MIN_KNOWN_SHARE and known.sum() >= enough)


def _part(image: Shaped[np.ndarray, "h w"], board: Board, target: TargetSpec) -> PartialView | None:
    if not _is_worth_it(board, target):
        return None
    readings = decode_fiducial_dots(image, board.lattice)
    straight = [r for r in readings if not r.is_mirrored]
    if readings and not straight:
        raise TargetMirrored("The marks of the chessboard in view are those of a mirrored print.")
    if len(straight) != 1:
        return None
    (reading,) = straight
    by_dots = [
        _Placement(reading.turns, i - reading.column, j - reading.row) for i, j in marked_squares(target)[:1]
    ]
    fitting = set(by_dots).intersection(_placements(board, target))
    if not fitting:
        raise TargetMismatch(
            f"Part of a marked board is in view, but not of one of {target.columns} x {target.rows}."
        )
    (place,) = fitting
    return PartialView(_turned(board.lattice, place.turns), place.column, place.row)


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
                    (ends or not side.is_boundary) and not (ends and side.goes_on)
                    for ends, side in zip(at_end, (top, bottom, left, right), strict=True)
                ):
                    found.append(_Placement(turns, column, row))
    return found


_SIDES = ((0, 1, 2, 3), (3, 2, 0, 1), (1, 0, 3, 2), (2, 3, 1, 0))
"""Which of a board's sides (top, bottom, left, right) are those of its lattice after so many quarter turns."""
