"""The geometry of a found lattice of corners."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from core.jit import jit
from core.numerics import median

_MAX_KINK = 0.35  # of the longer of two successive steps


@dataclass(frozen=True, slots=True)
class Lattice:
    """Corners of a lattice in pixels of the full image, NaN where none was found, in a right-handed order.

    `gap`: by how much the darker bright square is brighter than the brighter dark one at each corner, grey levels;
    `outside`: which places next to known corners lie outside the image; `origin_is_bright` refers to the square between
    grid[0, 0] and grid[1, 1]; `cut_short` of a lattice that has more corners, but was grown no further.
    """

    grid: Float[np.ndarray, "rows columns 2"]
    gap: Float[np.ndarray, "rows columns"]
    outside: Bool[np.ndarray, "rows columns"]
    origin_is_bright: bool
    cut_short: bool = False

    @property
    def known(self) -> Bool[np.ndarray, "rows columns"]:
        """Where a corner was found."""
        return np.asarray(np.isfinite(self.gap))

    @property
    def square_px(self) -> float:
        """The side of the squares, px: the root of the median of their areas; 0 of a lattice without any."""
        grid = self.grid
        across, down = grid[:-1, 1:] - grid[:-1, :-1], grid[1:, :-1] - grid[:-1, :-1]
        areas = np.abs(across[..., 0] * down[..., 1] - across[..., 1] * down[..., 0])
        areas = areas[np.isfinite(areas)]
        return math.sqrt(median(areas)) if len(areas) else 0.0

    def cut(self, top: int, bottom: int, left: int, right: int) -> Lattice:
        """Return rows `top` to `bottom` and columns `left` to `right`, the latter of each exclusive."""
        return Lattice(
            self.grid[top:bottom, left:right],
            self.gap[top:bottom, left:right],
            self.outside[top:bottom, left:right],
            self.origin_is_bright == ((top + left) % 2 == 0),
            self.cut_short,
        )

    def quarter_turn(self) -> Lattice:
        """Return the same lattice with the last column as its first row; it stays right-handed."""
        is_bright = self.origin_is_bright == (self.gap.shape[1] % 2 == 0)
        return Lattice(  # `np.rot90` of the three, in a tenth of its time
            self.grid[:, ::-1].swapaxes(0, 1),
            self.gap[:, ::-1].T,
            self.outside[:, ::-1].T,
            is_bright,
            self.cut_short,
        )


@jit("f8[:, :, ::1]")
def bent_points(grid: Float[np.ndarray, "rows columns 2"]) -> Bool[np.ndarray, "rows columns"]:
    """Return at which points a line bends more than any lens makes it."""
    rows, columns, _ = grid.shape
    bad = np.zeros((rows, columns), dtype=np.bool_)
    for j in range(rows):
        for i in range(columns):
            for dj, di in ((1, 0), (0, 1)):
                if j < dj or i < di or j + dj >= rows or i + di >= columns:
                    continue
                before_u, before_v = grid[j, i] - grid[j - dj, i - di]
                after_u, after_v = grid[j + dj, i + di] - grid[j, i]
                longer = max(math.hypot(before_u, before_v), math.hypot(after_u, after_v))
                # where points are missing nothing is known against their neighbours: NaN is not larger
                if math.hypot(after_u - before_u, after_v - before_v) > _MAX_KINK * longer:
                    bad[j, i] = True
    return bad


@jit("b1[:, ::1]")
def poorly_connected(known: Bool[np.ndarray, "rows columns"]) -> Bool[np.ndarray, "rows columns"]:
    """Return which known points have fewer than two known neighbours."""
    rows, columns = known.shape
    alone = np.zeros((rows, columns), dtype=np.bool_)
    for j in range(rows):
        for i in range(columns):
            neighbours = (j > 0 and known[j - 1, i]) + (j + 1 < rows and known[j + 1, i])
            neighbours += (i > 0 and known[j, i - 1]) + (i + 1 < columns and known[j, i + 1])
            alone[j, i] = known[j, i] and neighbours < 2
    return alone
