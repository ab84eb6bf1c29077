"""What to say where the board of dots asked for was not found: what the image shows instead."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from core.errors import DetectionError, TargetMirrored, TargetMismatch, TargetNotFound
from core.targets.circles.board_matching import MIN_FILL
from core.targets.circles.lattice import DotLattice
from core.targets.circles.partial_view import along_grid_lines, ends_in_image
from core.targets.grid_index import is_staggered, lines
from core.targets.specification import GridPoints, TargetSpec

_MIN_SHARE = 0.75  # of the places within a lattice's outermost lines
_MIN_LINES, _MIN_DOTS = 3, 12  # each way, and of all, of a grid worth a name
_MUCH_LARGER = 1.25  # extent of a mirrored board, of that of one seen directly


@dataclass(frozen=True, slots=True)
class SeenGrid:
    """A lattice of dots by its number of lines, the longer and the shorter way; `ends` says whether its dots are round
    and all of its ends in view."""

    lines: tuple[int, int]
    ends: bool


@dataclass(frozen=True, slots=True)
class MirroredBoard:
    """A board of dots that is in view mirrored, with its extent in the image, px."""

    extent_px: float
    failure: TargetMirrored


def seen_grid(
    lattice: DotLattice,
    points_px: Float[np.ndarray, "n 2"],
    fill: Float[np.ndarray, " n"],
    shape: tuple[int, int],
    target: TargetSpec,
) -> SeenGrid | None:
    """Return the grid that a lattice shows, None where too many of its dots are missing for one, or staggered ones are
    not round: squares and the bits of markers make lattices as well. `fill` is that of `Dots`."""
    extent = along_grid_lines(lattice, target).max(axis=0) + 1
    places = extent[0] * extent[1] / (2 if is_staggered(target) else 1)
    if len(lattice.dots) < _MIN_SHARE * places:
        return None
    size = (int(extent.max()), int(extent.min()))
    is_round = len(fill) >= _MIN_DOTS and bool(np.median(fill) >= MIN_FILL)
    if is_staggered(target) and not is_round:
        return None
    return SeenGrid(size, is_round and ends_in_image(lattice, points_px, shape, target))


def mirrored_board(points_px: Float[np.ndarray, "n 2"], failure: TargetMirrored) -> MirroredBoard:
    """Return what is mirrored in view, given its dots."""
    return MirroredBoard(float(np.ptp(points_px, axis=0).max()), failure)


def seen_directly(points: GridPoints, mirrored: Sequence[MirroredBoard]) -> GridPoints:
    """Return the points of a board that is in view directly, next to mirrored ones.

    Raises TargetMismatch where a mirrored one is much larger: then the camera may mirror, and these be the reflection.
    """
    extent = float(np.ptp(points.points_px, axis=0).max())
    if any(board.extent_px > _MUCH_LARGER * extent for board in mirrored):
        raise TargetMismatch(
            "The board of dots is in view twice, once mirrored, and larger so.",
            "Cover mirrors and reflecting surfaces; switch the camera's image mirroring off.",
        )
    return points


def outermost_hidden(target: TargetSpec) -> TargetNotFound:
    """Return the error for a board with enough dots to measure, but not on each of its outermost lines."""
    return TargetNotFound(
        f"A grid of {target.columns} x {target.rows} dots is in view, but too many dots of its outermost lines are "
        "hidden or not clear.",
        "Bring the outermost lines of dots into view, sharp, and free of reflections and of anything in front of them.",
    )


def not_found(seen: Sequence[SeenGrid], target: TargetSpec) -> DetectionError:
    """Return the error for an image without the board; it states what was found instead."""
    asked = f"{target.columns} x {target.rows}"
    sizes = [_sizes(grid, target) for grid in seen]
    named = [(grid, size) for grid, size in zip(seen, sizes, strict=True) if size]
    if not named:
        return TargetNotFound(f"No grid of {asked} dots was found.")
    grid, size = max(named, key=lambda one: one[0].lines[0] * one[0].lines[1])
    shown = " or ".join(f"{columns} x {rows}" for columns, rows in size)
    if grid.lines == tuple(sorted(lines(target), reverse=True)) and _is_size(size, target):
        return outermost_hidden(target)
    most = lines(target)
    if grid.lines[0] > max(most) or grid.lines[1] > min(most):
        return TargetMismatch(
            f"A grid of {shown} dots is in view, {asked} was asked for.",
            "Check columns and rows; keep other grids out of view.",
        )
    if grid.ends and min(grid.lines) >= _MIN_LINES:
        return TargetMismatch(
            f"A grid of {shown} dots is in view, {asked} was asked for.",
            "Check columns and rows; if they are right, take away what lies across the board and hides the rest.",
        )
    return TargetNotFound(f"Only {shown} dots of a grid are wholly in view, {asked} were asked for.")


def _sizes(grid: SeenGrid, target: TargetSpec) -> list[tuple[int, int]]:
    """Return the columns and rows that a grid may have; of staggered dots none where it is no such board."""
    if not is_staggered(target):
        return [grid.lines]
    ways = dict.fromkeys((grid.lines, grid.lines[::-1]))
    return [(across // 2, down) for across, down in ways if across % 2 == 0]


def _is_size(sizes: Sequence[tuple[int, int]], target: TargetSpec) -> bool:
    return not is_staggered(target) or (target.columns, target.rows) in sizes
