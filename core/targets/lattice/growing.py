"""Grow a patch of lattice on the full image until it is complete.

Its corners are looked at in the image (`corner_search`), those of its ends predict the next ones, and what does not fit
its neighbours is removed.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from core.numerics import median
from core.targets.lattice.corner_search import grow, update_corners
from core.targets.lattice.lattice import Lattice, bent_points, poorly_connected

MAX_REACH = 0.36  # of a step
_MIN_OF_MEDIAN = 0.15
_ROUNDS = 4
_MARGIN = 4
_RIM = 2  # of the arrays: corners there may have more beyond
MAX_LINES = 520
"""A lattice with more lines than this in one direction is grown no further, and known as cut short."""


def grow_lattice(
    image: Shaped[np.ndarray, "h w"],
    points: Float[np.ndarray, "n 2"],
    place: Int[np.ndarray, "n 2"],
    reach: float = MAX_REACH,
) -> Lattice:
    """Return the lattice that corners (px of the full image, at column and row) belong to, grown to its ends.

    The square between places (0, 0) and (1, 1) is bright. `reach` is how far from a corner, in steps, its squares are
    plain: less where something is printed in them.
    """
    low = place.min(axis=0) - _MARGIN
    columns, rows = place.max(axis=0) - low + 1 + _MARGIN
    grid = np.full((rows, columns, 2), np.nan)
    gap = np.full((rows, columns), np.nan)
    at = place - low
    grid[at[::-1, 1], at[::-1, 0]] = points[::-1]  # of two at one place the first
    bright = bool((low[0] + low[1]) % 2 == 0)
    update_corners(image, grid, gap, bright, reach)
    drop(grid, gap, gap < _MIN_OF_MEDIAN * _median(gap))
    outside = np.zeros(gap.shape, dtype=bool)
    fresh = np.ones(gap.shape, dtype=bool)
    cut_short = False
    while True:
        grow(image, grid, gap, bright, outside, fresh, reach)
        pads = _pads(np.isfinite(gap))
        if not any(map(any, pads)):
            break
        cut_short = max(_bounded(Lattice(grid, gap, outside, bright)).gap.shape) > MAX_LINES
        if cut_short:
            break
        bright = bright == ((pads[0][0] + pads[1][0]) % 2 == 0)
        grid = np.pad(grid, (*pads, (0, 0)), constant_values=np.nan)
        gap = np.pad(gap, pads, constant_values=np.nan)
        fresh = np.pad(np.zeros(outside.shape, dtype=bool), pads, constant_values=True)
        outside = np.pad(outside, pads)
    # what grew from a mistake may have kept the right corners out
    for _ in range(0 if cut_short else _ROUNDS):
        fresh = _prune(grid, gap)
        if not fresh.any():
            break
        grow(image, grid, gap, bright, outside, fresh, reach)
    else:
        _prune(grid, gap)
    return _bounded(Lattice(grid, gap, outside, bright, cut_short))


def drop(
    grid: Float[np.ndarray, "rows columns 2"], gap: Float[np.ndarray, "rows columns"], which: np.ndarray
) -> None:
    """Take corners out of a lattice's arrays."""
    grid[which] = np.nan
    gap[which] = np.nan


def _pads(known: Bool[np.ndarray, "rows columns"]) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return how many lines to add before and after the rows, and the columns, so that there is room to grow on."""
    pad = max(_MARGIN, min(known.shape) // 4)
    rows, columns = np.asarray(known.any(axis=1)), np.asarray(known.any(axis=0))
    return (
        (pad * bool(rows[:_RIM].any()), pad * bool(rows[-_RIM:].any())),
        (pad * bool(columns[:_RIM].any()), pad * bool(columns[-_RIM:].any())),
    )


def _prune(
    grid: Float[np.ndarray, "rows columns 2"], gap: Float[np.ndarray, "rows columns"]
) -> Bool[np.ndarray, "rows columns"]:
    """Remove corners that do not fit their neighbours, or have none to show that they do; return which."""
    known = np.isfinite(gap)
    wrong = bent_points(grid) | poorly_connected(known)
    while wrong.any():
        drop(grid, gap, wrong)
        wrong = poorly_connected(np.isfinite(gap))
    return known & ~np.isfinite(gap)


def _median(gap: Float[np.ndarray, "rows columns"]) -> float:
    known = gap[np.isfinite(gap)]
    return median(known) if len(known) else 0.0


def _bounded(lattice: Lattice) -> Lattice:
    """Return the lattice without the empty lines around it."""
    rows, columns = np.flatnonzero(lattice.known.any(axis=1)), np.flatnonzero(lattice.known.any(axis=0))
    if len(rows) == 0:
        return lattice.cut(0, 0, 0, 0)
    return lattice.cut(int(rows[0]), int(rows[-1]) + 1, int(columns[0]), int(columns[-1]) + 1)
