"""Where a found lattice ends, and whether it is the board that ends there.

A board's outermost corners are followed by one more square, then by the margin. A lattice whose next line is out of the
picture, or hidden, may go on there: nobody can tell how large it is. So on each side three things are looked at: how
much of the outermost line of corners is seen, whether the squares beyond it all end at one depth (often less than a
whole square: boards are cut to fit their plates; what hides a board does not end so evenly), and whether corners follow
at their other end.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Shaped

from core.targets.lattice import Lattice

_LEAST_OF_LINE = 0.3  # of a line's corners; a line with fewer is none of the lattice
_ENOUGH_OF_LINE = 0.5
_LEAST_CORNERS = 2
ENOUGH_VISIBLE = 0.5
_ENOUGH_SQUARES = 0.65
_MOST_BEYOND = 0.12  # of the places beyond: chance makes corners of clutter, a board makes all of them
_DEPTHS = np.arange(0.4, 0.95, 0.1)  # of a step, where the outermost squares are looked at
_BESIDE = 0.3  # of a step, to both sides of the edge between two of them
_LEAST_STEP = 0.25  # of the contrast at the board's corners
_MARGIN_PX = 2.0
_LEAST_SQUARE_PX = 6.0


@dataclass(frozen=True, slots=True)
class Side:
    """One side of a lattice, all as shares from 0 to 1.

    `seen` of its outermost corners; `visible` of the places of the line beyond, where the outermost squares end: those
    in the picture; `squares` of the outermost squares in the picture: those that reach as deep as most do; `beyond` of
    the visible places: those that are corners again.
    """

    seen: float
    visible: float
    squares: float
    beyond: float

    @property
    def goes_on(self) -> bool:
        """Whether there are more lines than were found, or may be: the picture ends here."""
        return self.visible < ENOUGH_VISIBLE or self.beyond > _MOST_BEYOND

    @property
    def is_an_end(self) -> bool:
        """Whether the board ends here beyond doubt."""
        return not self.goes_on and self.seen >= _ENOUGH_OF_LINE and self.squares >= _ENOUGH_SQUARES


@dataclass(frozen=True, slots=True)
class Board:
    """A lattice without the stray corners around it, and its four sides: top, bottom, left, right."""

    lattice: Lattice
    sides: tuple[Side, Side, Side, Side]

    @property
    def size(self) -> tuple[int, int]:
        """Number of lines the longer and the shorter way."""
        long, short = sorted(self.lattice.gap.shape, reverse=True)
        return long, short

    @property
    def is_cropped(self) -> bool:
        """Whether some of its corners lie outside the picture."""
        return bool(self.lattice.outside.any())

    @property
    def square_px(self) -> float:
        """The distance of neighbouring lines, px: the median of all squares, in the direction in which it is less."""
        grid = self.lattice.grid
        across, down = np.diff(grid, axis=1)[:-1], np.diff(grid, axis=0)[:, :-1]
        area = np.abs(across[..., 0] * down[..., 1] - across[..., 1] * down[..., 0])
        longer = np.maximum(np.hypot(across[..., 0], across[..., 1]), np.hypot(down[..., 0], down[..., 1]))
        height = (area / longer)[np.isfinite(area)]
        return float(np.median(height)) if len(height) else 0.0

    @property
    def is_resolved(self) -> bool:
        """Whether its squares are large enough in the picture to tell its ends."""
        return self.square_px >= _LEAST_SQUARE_PX

    @property
    def is_whole(self) -> bool:
        """Whether all of it is in the picture and all four sides are the board's ends."""
        whole = not self.is_cropped and not self.lattice.cut_short
        return whole and all(side.is_an_end for side in self.sides)

    @property
    def goes_on(self) -> bool:
        """Whether it has more corners, or may have them, than were found."""
        return self.is_cropped or self.lattice.cut_short or any(side.goes_on for side in self.sides)


def bounded(image: Shaped[np.ndarray, "h w"], lattice: Lattice) -> Board | None:
    """Return the board that a lattice shows, or None where it is too small for any."""
    box = _box(lattice.known)
    top, bottom, left, right = box
    if bottom - top < 3 or right - left < 3:
        return None
    part = lattice.cut(*box)
    known = lattice.known
    grid, gap = part.grid, part.gap
    across, gap_across = np.swapaxes(grid, 0, 1), gap.T
    rows, columns = gap.shape
    bright = part.origin_is_bright
    none_above = np.zeros(columns, dtype=bool)
    none_beside = np.zeros(rows, dtype=bool)
    beyond = (
        known[top - 1, left:right] if top > 0 else none_above,
        known[bottom, left:right] if bottom < known.shape[0] else none_above,
        known[top:bottom, left - 1] if left > 0 else none_beside,
        known[top:bottom, right] if right < known.shape[1] else none_beside,
    )
    # the outermost square after a line's first corner: (0, -1) above, (0, rows - 1) below, (-1, 0) to the left,
    # (columns - 1, 0) to the right; of the origin's colour where that sum is even
    return Board(
        part,
        (
            _side(image, grid[:3], gap[0], not bright, beyond[0]),
            _side(image, grid[::-1][:3], gap[-1], bright == (rows % 2 == 1), beyond[1]),
            _side(image, across[:3], gap_across[0], not bright, beyond[2]),
            _side(image, across[::-1][:3], gap_across[-1], bright == (columns % 2 == 1), beyond[3]),
        ),
    )


def _box(known: Shaped[np.ndarray, "rows columns"]) -> tuple[int, int, int, int]:
    """Return top, bottom, left, right (exclusive) of what is left without outermost lines of few corners."""
    top, bottom, left, right = 0, known.shape[0], 0, known.shape[1]
    while bottom > top and right > left:
        part = known[top:bottom, left:right]
        shares = (part[0].mean(), part[-1].mean(), part[:, 0].mean(), part[:, -1].mean())
        counts = (part[0].sum(), part[-1].sum(), part[:, 0].sum(), part[:, -1].sum())
        side = int(np.argmin(shares))
        if shares[side] >= _LEAST_OF_LINE and counts[side] >= _LEAST_CORNERS:
            break
        top, bottom = top + (side == 0), bottom - (side == 1)
        left, right = left + (side == 2), right - (side == 3)
    return top, bottom, left, right


def _side(
    image: Shaped[np.ndarray, "h w"],
    lines: Float[np.ndarray, "three n 2"],
    gap: Float[np.ndarray, " n"],
    first_is_bright: bool,
    beyond: Shaped[np.ndarray, " n"],
) -> Side:
    """Look at the side whose outermost three lines are given, the outermost first; `first_is_bright` tells of the
    square outward of it and after its first corner."""
    seen = float(np.isfinite(gap).mean())
    outer, inner = lines[0], lines[1]
    straight = 2.0 * outer - inner
    bent = 3.0 * outer - 3.0 * inner + lines[2]  # a parabola through the three: perspective bends little
    places = np.where(np.isfinite(bent), bent, straight)
    good = np.isfinite(places[:, 0])
    if int(good.sum()) < _LEAST_CORNERS:
        return Side(seen, 0.0, 0.0, 0.0)
    number = np.flatnonzero(good)
    places, outer, levels_apart = places[good], outer[good], gap[good]
    height, width = image.shape
    limit = np.array([width, height]) - 1.0 - _MARGIN_PX
    visible = np.all((places >= _MARGIN_PX) & (places <= limit), axis=1)
    ends = np.minimum(np.arange(len(number)) + 1, len(number) - 1), np.maximum(np.arange(len(number)) - 1, 0)
    aside = _BESIDE * (outer[ends[0]] - outer[ends[1]]) / (number[ends[0]] - number[ends[1]])[:, None]
    middle = outer + _DEPTHS[:, None, None] * (places - outer)
    step = levels_at(image, middle + aside) - levels_at(image, middle - aside)
    sign = np.where((number % 2 == 0) == first_is_bright, 1.0, -1.0)
    differ = step * sign > _LEAST_STEP * levels_apart
    depth = np.logical_and.accumulate(differ, axis=0).sum(axis=0)
    right = visible & (np.abs(depth - np.sort(depth)[len(depth) // 2]) <= 1)
    count = max(int(visible.sum()), 1)
    hidden = len(gap) - len(number)
    return Side(
        seen,
        float(visible.mean()),
        float(right.sum()) / (count + hidden),
        float((beyond[good] & visible).sum()) / count,
    )


def levels_at(image: Shaped[np.ndarray, "h w"], places: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n"]:
    """Return the grey values at the pixels nearest to the places, those beyond the border as at it."""
    height, width = image.shape
    nearest = np.rint(places).astype(np.intp)
    u = np.minimum(np.maximum(nearest[..., 0], 0), width - 1)
    v = np.minimum(np.maximum(nearest[..., 1], 0), height - 1)
    return image[v, u].astype(np.float64)
