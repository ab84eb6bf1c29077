"""Whether a placed lattice ends where the board asked for ends.

Ids alone do not determine it: a board with more rows, or fewer, has the same markers at the same places as far as
both go. Corners beyond the board's last line are those of a larger board. Where the lattice ends before it,
something may be in front of the rest; but where the last squares are seen whole, dark ones to their very ends, and
paper as bright as their own follows in place of the next dark squares, the board that is printed is smaller.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from core.targets.subpixel import nearest_levels

_BEYOND, _MIN_BEYOND = 0.3, 2  # of the corners of the line before; clutter makes some of them
_MIN_LINE = 2  # corners of a lattice's last line
_MIN_WHITE_SQUARES = 2  # of the board's last line in view, whose outer neighbours are compared with paper
_MIN_AGREEING_SHARE = 0.8  # of the squares compared
_LAST, _NEXT = 0.85, 1.2  # squares outward of the last line of corners: still in the last squares, and beyond
_AS_BRIGHT = 0.25  # of the contrast


def extends_beyond(
    across: Int[np.ndarray, " n"], along: Int[np.ndarray, " n"], size: tuple[int, int]
) -> bool:
    """Return whether there is a line of corners beyond the board's first or last one, as there is on a larger board.

    `across` counts the lines, of which a board has `size[0]`, `along` the corners of a line.
    """
    inside = (along >= 0) & (along < size[1])
    for last, beyond in ((0, -1), (size[0] - 1, size[0])):
        further = int(np.count_nonzero(inside & (across == beyond)))
        if further >= _MIN_BEYOND and further > _BEYOND * np.count_nonzero(inside & (across == last)):
            return True
    return False


@dataclass(frozen=True, slots=True)
class PlacedCorners:
    """The grid points of a board in the image.

    `places_px` are the grid points from (-1, -1) on, NaN where nothing is known; those that are not `known` are only
    foreseen. `black` as in `CharucoLayout`.
    """

    places_px: Float[np.ndarray, "rows columns 2"]
    known: Bool[np.ndarray, "rows columns"]
    black: Bool[np.ndarray, "lines gaps"]

    def from_each_side(self) -> Iterator[PlacedCorners]:
        """Yield the board four times, with the rows counted toward each of its sides."""
        columns = PlacedCorners(np.swapaxes(self.places_px, 0, 1), self.known.T, self.black.T)
        for board in (self, columns):
            for way in (1, -1):
                yield PlacedCorners(board.places_px[::way], board.known[::way], board.black[::way])


def is_too_short(image: np.ndarray, board: PlacedCorners, margin: float) -> bool:
    """Return whether the board is seen to end before its last line of corners, on any side; `margin` is the white
    around a marker, in squares.
    """
    return any(_ends_before(image, seen, margin) for seen in board.from_each_side())


def _ends_before(image: np.ndarray, board: PlacedCorners, margin: float) -> bool:
    """Return whether the board ends before its last row."""
    places_px, known, black = board.places_px, board.known, board.black
    lines = np.flatnonzero(known.sum(axis=1) >= _MIN_LINE)
    if len(lines) == 0 or lines[-1] >= len(known) - 2:  # the last but one is the board's last line of corners
        return False
    line = int(lines[-1])
    inner, outer = places_px[line], places_px[line + 1]
    middle = 0.5 * (inner[:-1] + inner[1:])
    outward = 0.5 * (outer[:-1] + outer[1:]) - middle
    is_black = black[line]
    white_levels = nearest_levels(image, middle + (1.0 - 0.5 * margin) * outward)
    dark_levels = nearest_levels(image, middle + _LAST * outward)
    next_levels = nearest_levels(image, middle + _NEXT * outward)
    whites = ~is_black & np.isfinite(white_levels) & np.isfinite(next_levels)
    darks = is_black & np.isfinite(dark_levels)
    if np.count_nonzero(whites) < _MIN_WHITE_SQUARES or not darks.any():
        return False
    bright, dark = float(np.max(white_levels[whites])), float(np.median(dark_levels[darks]))
    contrast = bright - dark
    if not contrast > 0.0 or np.mean(dark_levels[darks] < dark + 0.5 * contrast) < _MIN_AGREEING_SHARE:
        return False
    # of a square whose margin is soiled that of the brightest one is taken
    white = np.where(white_levels > dark + 0.5 * contrast, white_levels, bright)[whites]
    is_paper = np.abs(next_levels[whites] - white) < _AS_BRIGHT * contrast
    return bool(np.mean(is_paper) >= _MIN_AGREEING_SHARE)
