"""Where a found lattice ends, and whether it is the board that ends there.

A board's outermost corners are followed by one more square, then by the margin. A lattice whose next line is out of the
image, or hidden, may continue there: its size is undetermined. So three things are examined on each side: how
much of the outermost line of corners is seen, whether the squares beyond it all end at one depth (often less than a
whole square: boards are cut to fit their plates; what hides a board does not end so evenly), and whether corners follow
at their other end.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Shaped

from core.jit import jit
from core.numerics import median
from core.targets.lattice.lattice import Lattice

_MIN_LINE_SHARE = 0.3  # of a line's corners; a line with fewer is not part of the lattice
_MIN_END_SHARE = 0.5
_MIN_CORNERS = 2
_MIN_PLACES = 3  # beyond a side: of fewer, all corners that follow there may be missed
MIN_VISIBLE_SHARE = 0.3  # a print is a rectangle: where a third of a side ends, the rest does
MIN_SQUARES_SHARE = 0.65
MAX_BEYOND_SHARE = 0.12  # of the places beyond: chance makes corners of clutter, a board makes all of them
_DEPTHS = (0.4, 0.5, 0.6, 0.7, 0.8, 0.9)  # of a step, where the outermost squares are looked at
_DEPTH_BEYOND = 1.3  # of a step: beyond the next line, where squares are of the other colour
_SIDE_OFFSET = 0.3  # of a step, to both sides of the edge between two of them
_MIN_STEP = 0.25  # of the contrast at the board's corners
_MIN_STEP_BEYOND = 0.5  # the same beyond the next line: clutter makes a corner there, hardly a square as well
_MARGIN_PX = 2.0
_MIN_SQUARE_PX = 6.0


@dataclass(frozen=True, slots=True)
class Side:
    """One side of a lattice, all as shares from 0 to 1.

    `seen` of its outermost corners; `visible` of the places of the line beyond, where the outermost squares end: those
    in the image, 0 where one or two are and these are less than half, or do not show that no squares follow; `squares`
    of the outermost squares in the image: those that reach as deep as most do; `beyond` of the visible places: those
    that are corners again, followed by squares of the other colour.
    `is_crossed`: the squares go on beyond something that lies across them.
    """

    seen: float
    visible: float
    squares: float
    beyond: float
    is_crossed: bool = False

    @property
    def goes_on(self) -> bool:
        """Whether more lines than were found are seen."""
        return self.is_crossed or self.beyond > MAX_BEYOND_SHARE

    @property
    def continues(self) -> bool:
        """Whether there are more lines than were found, or may be: the image ends here."""
        return self.visible < MIN_VISIBLE_SHARE or self.goes_on

    @property
    def is_boundary(self) -> bool:
        """Whether the board certainly ends here."""
        return not self.continues and self.seen >= _MIN_END_SHARE and self.squares >= MIN_SQUARES_SHARE


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
        """Whether some of its corners lie outside the image."""
        return bool(self.lattice.outside.any())

    @property
    def square_px(self) -> float:
        """The distance of neighbouring lines, px: the median of all squares, in the direction in which it is less."""
        heights = square_heights(np.ascontiguousarray(self.lattice.grid))
        return median(heights) if len(heights) else 0.0

    @property
    def is_resolved(self) -> bool:
        """Whether its squares are large enough in the image to determine its ends."""
        return self.square_px >= _MIN_SQUARE_PX

    @property
    def is_whole(self) -> bool:
        """Whether all of it is in the image and all four sides are the board's ends."""
        whole = not self.is_cropped and not self.lattice.cut_short
        return whole and all(side.is_boundary for side in self.sides)

    @property
    def continues(self) -> bool:
        """Whether it has more corners, or may have them, than were found."""
        return self.is_cropped or self.lattice.cut_short or any(side.continues for side in self.sides)


def bounded(image: Shaped[np.ndarray, "h w"], lattice: Lattice) -> Board | None:
    """Return the board that a lattice shows, or None where it is too small for any."""
    known = lattice.known
    top, bottom, left, right = bounding_box(known)
    if bottom - top < 3 or right - left < 3:
        return None
    part = lattice.cut(top, bottom, left, right)
    grid, gap = np.ascontiguousarray(part.grid), np.ascontiguousarray(part.gap)
    around = known_around(known, top, bottom, left, right)
    shares = look_at_sides(image, grid, gap, part.origin_is_bright, around)
    above, below, before, after = (Side(*four) for four in shares.tolist())
    return Board(part, (above, below, before, after))


@jit("f8[:, :, ::1]")
def square_heights(grid: Float[np.ndarray, "rows columns 2"]) -> Float[np.ndarray, " n"]:
    """Return the area of each square whose first three corners are known, over its longer side, px."""
    rows, columns, _ = grid.shape
    heights = np.empty(rows * columns)
    count = 0
    for j in range(rows - 1):
        for i in range(columns - 1):
            across_u, across_v = grid[j, i + 1] - grid[j, i]
            down_u, down_v = grid[j + 1, i] - grid[j, i]
            area = abs(across_u * down_v - across_v * down_u)
            if math.isfinite(area):
                heights[count] = area / max(math.hypot(across_u, across_v), math.hypot(down_u, down_v))
                count += 1
    return heights[:count]


@jit("b1[:, ::1]")
def bounding_box(known: Bool[np.ndarray, "rows columns"]) -> tuple[int, int, int, int]:
    """Return top, bottom, left, right (exclusive) of what is left without outermost lines of few corners."""
    top, bottom, left, right = 0, known.shape[0], 0, known.shape[1]
    while bottom > top and right > left:
        worst, fewest, side = 2.0, 0, 0
        for k in range(4):
            if k < 2:
                count, length = np.sum(known[top if k == 0 else bottom - 1, left:right]), right - left
            else:
                count, length = np.sum(known[top:bottom, left if k == 2 else right - 1]), bottom - top
            if count / length < worst:
                worst, fewest, side = count / length, count, k
        if worst >= _MIN_LINE_SHARE and fewest >= _MIN_CORNERS:
            break
        top, bottom = top + (side == 0), bottom - (side == 1)
        left, right = left + (side == 2), right - (side == 3)
    return top, bottom, left, right


@jit("b1[:, ::1], i8, i8, i8, i8")
def known_around(
    known: Bool[np.ndarray, "rows columns"], top: int, bottom: int, left: int, right: int
) -> Bool[np.ndarray, "4 longer"]:
    """Return which corners are known on the lines next to a part of the lattice: above, below, left, right of it."""
    around = np.zeros((4, max(bottom - top, right - left)), dtype=np.bool_)
    for i in range(right - left):
        around[0, i] = top > 0 and known[top - 1, left + i]
        around[1, i] = bottom < known.shape[0] and known[bottom, left + i]
    for j in range(bottom - top):
        around[2, j] = left > 0 and known[top + j, left - 1]
        around[3, j] = right < known.shape[1] and known[top + j, right]
    return around


@jit(
    "u1[:, ::1], f8[:, :, ::1], f8[:, ::1], b1, b1[:, ::1]",
    "u2[:, ::1], f8[:, :, ::1], f8[:, ::1], b1, b1[:, ::1]",
)
def look_at_sides(
    image: Shaped[np.ndarray, "h w"],
    grid: Float[np.ndarray, "rows columns 2"],
    gap: Float[np.ndarray, "rows columns"],
    origin_is_bright: bool,
    beyond: Bool[np.ndarray, "4 longer"],
) -> Float[np.ndarray, "4 4"]:
    """Return the four figures of `Side` for top, bottom, left and right.

    `beyond` holds which corners of the next line on each side are known.
    """
    rows, columns = gap.shape
    shares = np.zeros((4, 4))
    for side in range(4):
        count = columns if side < 2 else rows
        # the outermost square after a line's first corner: (0, -1) above, (0, rows - 1) below, (-1, 0) to the left,
        # (columns - 1, 0) to the right; of the origin's colour where that sum is even
        is_bright = origin_is_bright
        if side == 0 or side == 2 or (rows if side == 1 else columns) % 2 == 0:
            is_bright = not origin_is_bright
        outer, inner, third = np.empty((count, 2)), np.empty((count, 2)), np.empty((count, 2))
        apart = np.empty(count)
        for k in range(count):
            for depth, line in enumerate((outer, inner, third)):
                if side < 2:
                    j, i = depth if side == 0 else rows - 1 - depth, k
                else:
                    j, i = k, depth if side == 2 else columns - 1 - depth
                line[k, 0], line[k, 1] = grid[j, i, 0], grid[j, i, 1]
            if side < 2:
                apart[k] = gap[0 if side == 0 else rows - 1, k]
            else:
                apart[k] = gap[k, 0 if side == 2 else columns - 1]
        look_at_side(image, outer, inner, third, apart, is_bright, beyond[side], shares[side])
    return shares


@jit(
    "u1[:, ::1], f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[::1], b1, b1[::1], f8[::1]",
    "u2[:, ::1], f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[::1], b1, b1[::1], f8[::1]",
)
def look_at_side(
    image: Shaped[np.ndarray, "h w"],
    outer: Float[np.ndarray, "n 2"],
    inner: Float[np.ndarray, "n 2"],
    third: Float[np.ndarray, "n 2"],
    apart: Float[np.ndarray, " n"],
    first_is_bright: bool,
    beyond: Bool[np.ndarray, " longer"],
    shares: Float[np.ndarray, "4"],
) -> None:
    """Write the figures of `Side`, given its outermost three lines, and the gaps of the outermost.

    `first_is_bright` refers to the square outward of the outermost line and after its first corner.
    """
    height, width = image.shape
    count = len(outer)
    places, number = np.empty((count, 2)), np.empty(count, dtype=np.int64)
    good = 0
    for k in range(count):
        for axis in range(2):
            straight = 2.0 * outer[k, axis] - inner[k, axis]
            # a parabola through the three: perspective bends little
            bent = straight + outer[k, axis] - 2.0 * inner[k, axis] + third[k, axis]
            places[good, axis] = bent if math.isfinite(bent) else straight
        if math.isfinite(places[good, 0]):
            number[good] = k
            good += 1
    shares[0] = np.sum(np.isfinite(apart)) / count
    if good < _MIN_CORNERS:
        return
    depths, visible = np.zeros(good, dtype=np.int64), np.zeros(good, dtype=np.bool_)
    follows = np.zeros(good, dtype=np.bool_)
    for n in range(good):
        k, u, v = number[n], places[n, 0], places[n, 1]
        visible[n] = min(u, v) >= _MARGIN_PX and u <= width - 1.0 - _MARGIN_PX
        visible[n] = visible[n] and v <= height - 1.0 - _MARGIN_PX
        before, after = number[max(n - 1, 0)], number[min(n + 1, good - 1)]
        side_u = _SIDE_OFFSET * (outer[after, 0] - outer[before, 0]) / (after - before)
        side_v = _SIDE_OFFSET * (outer[after, 1] - outer[before, 1]) / (after - before)
        sign = 1.0 if (k % 2 == 0) == first_is_bright else -1.0
        away_u, away_v = u - outer[k, 0], v - outer[k, 1]
        for depth in _DEPTHS:
            middle_u, middle_v = outer[k, 0] + depth * away_u, outer[k, 1] + depth * away_v
            step = step_across(image, middle_u, middle_v, side_u, side_v)
            if not step * sign > _MIN_STEP * apart[k]:
                break
            depths[n] += 1
        middle_u, middle_v = outer[k, 0] + _DEPTH_BEYOND * away_u, outer[k, 1] + _DEPTH_BEYOND * away_v
        step = step_across(image, middle_u, middle_v, side_u, side_v)
        in_image = min(middle_u, middle_v) >= 0.0 and middle_u <= width - 1.0 and middle_v <= height - 1.0
        # where the gap is unknown, or the place out of the image, nothing is said against it
        follows[n] = not in_image or not -step * sign < _MIN_STEP_BEYOND * apart[k]
    at_least, usual = good, -1  # the median depth: the largest that more than half reach
    while at_least > good - good // 2 - 1:
        usual += 1
        at_least = 0
        for n in range(good):
            at_least += depths[n] > usual
    seen = max(int(np.sum(visible)), 1)
    are_enough = seen >= _MIN_PLACES or (2 * seen >= good and np.sum(visible & follows) < seen)
    shares[1] = np.sum(visible) / good if are_enough else 0.0
    shares[2] = np.sum(visible & (np.abs(depths - usual) <= 1)) / (seen + count - good)
    for n in range(good):
        shares[3] += (visible[n] and beyond[number[n]] and follows[n]) / seen


@jit("u1[:, ::1], f8, f8, f8, f8", "u2[:, ::1], f8, f8, f8, f8")
def step_across(image: Shaped[np.ndarray, "h w"], u: float, v: float, side_u: float, side_v: float) -> float:
    """Return the level to one side of a place less that to the other."""
    return level_at(image, u + side_u, v + side_v) - level_at(image, u - side_u, v - side_v)


@jit("u1[:, ::1], f8, f8", "u2[:, ::1], f8, f8")
def level_at(image: Shaped[np.ndarray, "h w"], u: float, v: float) -> float:
    """Return the grey value at the pixel nearest to a place, of one beyond the border that at it."""
    height, width = image.shape
    nearest_u, nearest_v = round(min(max(u, 0.0), width - 1.0)), round(min(max(v, 0.0), height - 1.0))
    return float(image[int(nearest_v), int(nearest_u)])
