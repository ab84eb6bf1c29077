"""Whether a placed lattice ends where the board asked for ends.

Ids alone do not tell: a board with more rows, or fewer, has the same markers at the same places as far as both go.
Corners beyond the board's last line are those of a larger board. Where the lattice ends before it, something may be in
front of the rest; but where the last squares are seen whole, dark ones to their very ends, and paper as bright as
their own follows in place of the next dark squares, the board that is printed is smaller.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

_BEYOND, _LEAST_BEYOND = 0.3, 2  # of the corners of the line before; clutter makes some of them
_LEAST_LINE = 2  # corners of a lattice's last line
_LEAST_TOLD, _ENOUGH_TOLD = 2, 0.8  # squares beside white ones that must be paper, and of all in the picture
_LAST, _NEXT = 0.85, 1.2  # squares outward of the last line of corners: still in the last squares, and beyond
_AS_BRIGHT = 0.25  # of the contrast


def goes_beyond(across: Int[np.ndarray, " n"], along: Int[np.ndarray, " n"], size: tuple[int, int]) -> bool:
    """Tell whether there is a line of corners beyond the board's first or last one, as there is on a larger board.

    `across` counts the lines, of which a board has `size[0]`, `along` the corners of a line.
    """
    inside = (along >= 0) & (along < size[1])
    for last, beyond in ((0, -1), (size[0] - 1, size[0])):
        further = int(np.count_nonzero(inside & (across == beyond)))
        if further >= _LEAST_BEYOND and further > _BEYOND * np.count_nonzero(inside & (across == last)):
            return True
    return False


def ends_early(
    image: np.ndarray,
    places_px: Float[np.ndarray, "rows columns 2"],
    known: Bool[np.ndarray, "rows columns"],
    black: Bool[np.ndarray, "lines gaps"],
    margin: float,
) -> bool:
    """Tell whether the board is seen to end before its last line of corners, on any side.

    `places_px` are the grid points from (-1, -1) on, NaN where nothing is known; those that are not `known` are only
    foreseen. `black` as in `CharucoLayout`; `margin` is the white around a marker, in squares.
    """
    for axis in range(2):
        grid, seen, dark = (
            (places_px, known, black) if axis == 0 else (np.swapaxes(places_px, 0, 1), known.T, black.T)
        )
        for way in (1, -1):
            if _ends_before(image, grid[::way], seen[::way], dark[::way], margin):
                return True
    return False


def _ends_before(
    image: np.ndarray,
    places_px: Float[np.ndarray, "rows columns 2"],
    known: Bool[np.ndarray, "rows columns"],
    black: Bool[np.ndarray, "lines gaps"],
    margin: float,
) -> bool:
    """Tell whether the board ends before its last row; the arrays' rows may be its columns, or run backward."""
    lines = np.flatnonzero(known.sum(axis=1) >= _LEAST_LINE)
    if len(lines) == 0 or lines[-1] >= len(known) - 2:  # the last but one is the board's last line of corners
        return False
    line = int(lines[-1])
    inner, outer = places_px[line], places_px[line + 1]
    middle = 0.5 * (inner[:-1] + inner[1:])
    outward = 0.5 * (outer[:-1] + outer[1:]) - middle
    is_black = black[line]
    white_levels = _levels(image, middle + (1.0 - 0.5 * margin) * outward)
    dark_levels = _levels(image, middle + _LAST * outward)
    next_levels = _levels(image, middle + _NEXT * outward)
    whites = ~is_black & np.isfinite(white_levels) & np.isfinite(next_levels)
    darks = is_black & np.isfinite(dark_levels)
    if np.count_nonzero(whites) < _LEAST_TOLD or not darks.any():
        return False
    bright, dark = float(np.max(white_levels[whites])), float(np.median(dark_levels[darks]))
    contrast = bright - dark
    if not contrast > 0.0 or np.mean(dark_levels[darks] < dark + 0.5 * contrast) < _ENOUGH_TOLD:
        return False
    # of a square whose margin is soiled that of the brightest one is taken
    white = np.where(white_levels > dark + 0.5 * contrast, white_levels, bright)[whites]
    alike = np.abs(next_levels[whites] - white) < _AS_BRIGHT * contrast
    return bool(np.mean(alike) >= _ENOUGH_TOLD)


def _levels(image: np.ndarray, places: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
    """Return the grey values at the pixels nearest to places, NaN outside of the picture."""
    height, width = image.shape
    levels = np.full(len(places), np.nan)
    with np.errstate(invalid="ignore"):
        inside = (places >= 0.0).all(axis=1) & (places[:, 0] <= width - 1.0) & (places[:, 1] <= height - 1.0)
    u, v = np.rint(places[inside]).astype(np.intp).T
    levels[inside] = image[v, u]
    return levels
