"""Find a chessboard: its corners, the lattice they make, and whether it is the board asked for.

On one pyramid level after the other, coarse to fine, corners are detected and linked to patches of lattice. Each
patch is grown on the full image as far as it goes, and its ends are classified (`core.targets.lattice`). The search
ends at the first level with every corner of the board; where none has a board of its size, a still coarser one is
looked at, for boards blurred by motion. Fiducial dots (`fiducial_dots`) determine its origin, or else its colours do
(`orientation`). If no level has the whole board, a partial view with fiducial dots serves (`partial_view`). Then the
corners are refined (`core.targets.subpixel`).

Of several boards in view the one asked for is found if it alone has that size. Two of that size are a mismatch,
unless one is so much smaller that it can only be a print or a reflection of a board.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8, UInt16

from core.errors import (
    Advisory,
    TargetMirrored,
    TargetMismatch,
    TargetNotFound,
)
from core.targets.candidates import patch_corners, whole_lattices
from core.targets.chessboard.crossing import with_crossed_sides
from core.targets.chessboard.fiducial_dots import decode_fiducial_dots
from core.targets.chessboard.orientation import orient
from core.targets.chessboard.partial_view import (
    PartialView,
    is_mirrored,
    match_partial_view,
    turned_by_marks,
)
from core.targets.chessboard.refusals import MIN_SEEN_SHARE, fits, not_found
from core.targets.lattice import (
    Board,
    Lattice,
    Level,
    Patches,
    Saddles,
    blurred_levels,
    bounded,
    find_saddles,
    levels,
    link,
)
from core.targets.specification import GridPoints, TargetSpec
from core.targets.subpixel import refine_corners
from core.targets.surveyed_points import measured_points

_MAX_PATCHES = 8  # of a level, the largest
_SAME = 0.3  # of a patch's own spacing: corners that near are one
_MIN_EXTENT = 0.25  # of the largest board's: a smaller one is ignored


@dataclass(frozen=True, slots=True)
class Step:
    """What was found on one level; `boards` holds a board for each patch that makes one."""

    level: Level
    saddles: Saddles
    patches: Patches
    boards: tuple[Board, ...]


@dataclass(frozen=True, slots=True)
class Trace:
    """How a board was found.

    `steps` are the levels looked at; `lattice` is the board before refinement with the target's rows and columns,
    though not in its final order (`core.targets.chessboard.orientation.orient` gives that), or None if it was
    not found.
    """

    steps: tuple[Step, ...]
    lattice: Lattice | None


def detect_chessboard(
    image: UInt8[np.ndarray, "h w"] | UInt16[np.ndarray, "h w"], target: TargetSpec
) -> GridPoints:
    """Find the inner corners of a chessboard; see `core.targets.detection.detect`."""
    image = _plain(image)
    trace = trace_detection(image, target)
    if trace.lattice is not None:
        return _whole(image, trace.lattice, target)
    parts = [
        part for step in trace.steps if (part := match_partial_view(image, step.boards, target)) is not None
    ]
    if parts:
        return _grid_points(image, max(parts, key=lambda part: int(part.lattice.known.sum())), target)
    raise not_found((board for step in trace.steps for board in step.boards), target)


def trace_detection(image: UInt8[np.ndarray, "h w"] | UInt16[np.ndarray, "h w"], target: TargetSpec) -> Trace:
    """Find the board, short of refinement, and return what was seen on the way; for drawing as well.

    Raises
    ------
    TargetMismatch
        Two boards of the size asked for are in view.
    """
    image = _plain(image)
    steps: list[Step] = []
    best: Lattice | None = None
    for step in _search(image, levels(image)):
        steps.append(step)
        lattice = _the_one(step.boards, target)
        if lattice is not None and (best is None or lattice.known.sum() > best.known.sum()):
            best = lattice
        if best is not None and best.known.all():
            break
    # A board of that size that finer levels show, whole or not, is not blurred: they show why it is refused.
    if best is None and not any(fits(board, target) for step in steps for board in step.boards):
        for step in _search(image, blurred_levels(image)):
            best = _the_one(step.boards, target)
            if best is not None:  # otherwise too blurred to indicate the size
                steps.append(step)
    return Trace(tuple(steps), best)


def boards_in_view(image: UInt8[np.ndarray, "h w"] | UInt16[np.ndarray, "h w"]) -> tuple[Board, ...]:
    """Return the lattices of squares that an image shows, of any size; one may be returned twice, from two levels."""
    image = _plain(image)
    return tuple(board for step in _search(image, levels(image)) for board in step.boards)


def _plain(image: np.ndarray) -> np.ndarray:
    """Return the image as the kernels take it: contiguous and writeable, since others are of another type for them."""
    if image.flags.c_contiguous and image.flags.writeable and image.flags.aligned:
        return image
    return image.copy(order="C")


def _search(image: np.ndarray, pyramid: Iterable[Level]) -> Iterator[Step]:
    """Yield what each level shows."""
    for level in pyramid:
        saddles = find_saddles(level)
        patches = link(saddles)
        yield Step(level, saddles, patches, _boards(image, level, saddles, patches))


def _boards(image: np.ndarray, level: Level, saddles: Saddles, patches: Patches) -> tuple[Board, ...]:
    """Return the boards that a level's patches are parts of, each once."""
    corners = patch_corners(level, saddles, patches, _MAX_PATCHES)
    bounds = (bounded(image, lattice) for lattice in whole_lattices(image, corners, _own_corners))
    return tuple(with_crossed_sides(image, board) for board in bounds if board is not None)


def _own_corners(points: Float[np.ndarray, "n 2"], _: Lattice) -> float:
    """Return how near to a corner of a lattice one of a patch is the same corner."""
    return _SAME * float(np.min(np.linalg.norm(points[1:] - points[0], axis=1)))


def _the_one(boards: tuple[Board, ...], target: TargetSpec) -> Lattice | None:
    """Return the lattice of the board asked for, rows and columns as the target's; None if it is not among them.

    Raises TargetMismatch where there are two of it.
    """
    fitting = [board for board in boards if fits(board, target) and board.is_whole and board.is_resolved]
    fitting = [board for board in fitting if board.lattice.known.mean() >= MIN_SEEN_SHARE]
    if not fitting:
        return None
    if len(fitting) > 1:
        largest = max(_extent_px(board) for board in fitting)
        fitting = [board for board in fitting if _extent_px(board) > _MIN_EXTENT * largest]
    if len(fitting) > 1:
        raise TargetMismatch(
            f"{len(fitting)} grids of {target.columns} x {target.rows} are in view, one was asked for.",
            "Cover the others, or use boards of different sizes.",
        )
    lattice = fitting[0].lattice
    return lattice if lattice.gap.shape == (target.rows, target.columns) else lattice.quarter_turn()


def _extent_px(board: Board) -> float:
    """Return the board's extent in the image, px."""
    return float(
        np.max(np.nanmax(board.lattice.grid, axis=(0, 1)) - np.nanmin(board.lattice.grid, axis=(0, 1)))
    )


def _whole(image: np.ndarray, lattice: Lattice, target: TargetSpec) -> GridPoints:
    """Return the refined corners of a board seen whole, in the order that marks, colours or direction give it."""
    readings = decode_fiducial_dots(image, lattice)
    if is_mirrored(readings, lattice, target):
        raise TargetMirrored("The chessboard's marks are those of a mirrored print.")
    turned = turned_by_marks(readings, lattice, target)
    if turned is not None:
        return _grid_points(image, PartialView(turned, 0, 0), target)
    ordered, warnings = orient(lattice)
    return _grid_points(image, PartialView(ordered, 0, 0), target, warnings)


def _grid_points(
    image: np.ndarray, part: PartialView, target: TargetSpec, warnings: tuple[Advisory, ...] = ()
) -> GridPoints:
    """Return the refined corners of a board or a part of it, without those that are not trusted.

    Raises TargetNotFound where too few are left.
    """
    lattice = part.lattice
    row, column = np.nonzero(lattice.known)
    refined = refine_corners(
        image, column, row, lattice.grid[row, column], origin_is_black=not lattice.origin_is_bright
    )
    trusted = refined.trusted
    is_part = lattice.gap.shape != (target.rows, target.columns)
    enough = MIN_SEEN_SHARE * (len(trusted) if is_part else target.size)
    if trusted.sum() < enough:
        raise TargetNotFound(
            f"A {target.columns} x {target.rows} grid is in view, but {target.size - int(trusted.sum())} of its "
            f"{target.size} corners are too poor to measure."
        )
    reason = "corners are missing: the image does not show them as corners of squares."
    if is_part:
        reason = "corners are missing: they are out of view, hidden, or not clear enough."
    column, row = column + part.column, row + part.row
    return measured_points(
        image,
        target,
        column,
        row,
        refined,
        trusted,
        reason,
        warnings=warnings,
        labelling="up_to_symmetry" if warnings else "absolute",
    )
