"""The picture around a found grid: are its squares a chessboard's, and does the lattice end where the grid does?"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32

from core.targets.refinement import refine

_LEAST_RIGHT = 0.93
_LEAST_STEP = 0.25  # of the board's contrast: a smaller difference of two squares is none
_INSIDE_SQUARE = (-0.2, 0.0, 0.2)  # of its sides
_QUADRANTS = ((-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0))
_QUADRANT_REACH = 0.3  # of the spacing
_LEAST_GAP = 0.3  # of the board's contrast
_CONTINUES = 0.6  # of a line's visible places
_OUTER_CORNERS = 0.7  # of an outermost line's visible points; highlights may spoil some
_MOST_LINES = 500


@dataclass(frozen=True, slots=True)
class Colours:
    """What the squares between a grid's points look like.

    `contrast` is the median difference of neighbouring squares, grey levels; `right` the share of neighbours that
    differ as those of a chessboard do; `origin_is_black` tells of the square between grid[0, 0] and grid[1, 1].
    """

    origin_is_black: bool
    contrast: float
    right: float

    @property
    def are_a_chessboard(self) -> bool:
        """Whether all but a few neighbours differ as they should; highlights may spoil some."""
        return self.right >= _LEAST_RIGHT


@dataclass(frozen=True, slots=True)
class LineBeyond:
    """The line of points that would come next beyond one side of a grid.

    `places_px` in the grid's order; `is_lattice`: the picture shows chessboard corners there; `is_visible`: all of
    them and the squares around are in the image.
    """

    places_px: Float[np.ndarray, "n 2"]
    is_lattice: bool
    is_visible: bool


def measure_colours(image: Float32[np.ndarray, "h w"], grid: Float[np.ndarray, "rows columns 2"]) -> Colours:
    """Return what the squares between the grid's points look like."""
    corner, right, below, opposite = grid[:-1, :-1], grid[:-1, 1:], grid[1:, :-1], grid[1:, 1:]
    centre = (corner + right + below + opposite) / 4.0
    x_side, y_side = (right - corner + opposite - below) / 2.0, (below - corner + opposite - right) / 2.0
    places = np.stack([centre + a * x_side + b * y_side for a in _INSIDE_SQUARE for b in _INSIDE_SQUARE])
    levels = np.median(sample(image, places)[0], axis=0)
    j, i = np.mgrid[0 : levels.shape[0], 0 : levels.shape[1]]
    lighter_if_odd = np.where((i + j) % 2 == 0, 1.0, -1.0)  # times a step away from this square
    steps = np.concatenate(
        [
            (np.diff(levels, axis=1) * lighter_if_odd[:, :-1]).ravel(),
            (np.diff(levels, axis=0) * lighter_if_odd[:-1]).ravel(),
        ]
    )  # how much lighter the odd one of two neighbours is than the even one
    middle = float(np.median(steps))
    contrast = abs(middle)
    right_steps = steps * np.sign(middle) > _LEAST_STEP * contrast
    return Colours(middle > 0.0, contrast, float(np.mean(right_steps)) if contrast > 0.0 else 0.0)


def lines_beyond(
    image: Float32[np.ndarray, "h w"], grid: Float[np.ndarray, "rows columns 2"], colours: Colours
) -> tuple[LineBeyond, LineBeyond, LineBeyond, LineBeyond]:
    """Return what comes next above, below, left and right of a grid."""
    rows, columns = grid.shape[:2]
    across = np.swapaxes(grid, 0, 1)
    black = colours.origin_is_black
    # The square outward of the next line and after its first point is (0, -2) above, (0, rows) below, (-2, 0) to the
    # left, (columns, 0) to the right: of the origin's colour where that sum is even.
    return (
        _line_beyond(image, grid[:3], black, colours.contrast),
        _line_beyond(image, grid[::-1][:3], black != (rows % 2 == 1), colours.contrast),
        _line_beyond(image, across[:3], black, colours.contrast),
        _line_beyond(image, across[::-1][:3], black != (columns % 2 == 1), colours.contrast),
    )


def outer_lines_are_corners(
    image: Float32[np.ndarray, "h w"], grid: Float[np.ndarray, "rows columns 2"], colours: Colours
) -> bool:
    """Tell whether the grid's outermost points are corners of four squares, not ends of the board's outline."""
    rows, columns = grid.shape[:2]
    across = np.swapaxes(grid, 0, 1)
    black = colours.origin_is_black
    for lines, first_is_black in (
        (grid[:2], not black),
        (grid[::-1][:2], black != (rows % 2 == 0)),
        (across[:2], not black),
        (across[::-1][:2], black != (columns % 2 == 0)),
    ):
        corner, visible = _corners(image, lines[0], lines[0] - lines[1], first_is_black, colours.contrast)
        if int(corner.sum()) < _OUTER_CORNERS * int(visible.sum()):
            return False
    return True


def _line_beyond(
    image: Float32[np.ndarray, "h w"],
    lines: Float[np.ndarray, "three n 2"],
    first_is_black: bool,
    contrast: float,
) -> LineBeyond:
    """Look at the line that comes before three, the outermost first; `first_is_black` as in `_corners`."""
    places = (
        3.0 * lines[0] - 3.0 * lines[1] + lines[2]
    )  # a parabola through the three: perspective bends little
    corner, visible = _corners(image, places, places - lines[0], first_is_black, contrast)
    is_lattice = int(corner.sum()) >= max(2.0, _CONTINUES * int(visible.sum()))
    return LineBeyond(places, is_lattice, bool(visible.all()))


def _corners(
    image: Float32[np.ndarray, "h w"],
    places: Float[np.ndarray, "n 2"],
    outward: Float[np.ndarray, "n 2"],
    first_is_black: bool,
    contrast: float,
) -> tuple[Bool[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Tell which of a line's places are corners of four squares in alternating colours, and which can be judged.

    `first_is_black`: is the quadrant that lies outward, and forward along the line, black at the first place?
    """
    forward = np.gradient(places, axis=0)
    quadrants = np.stack([places + _QUADRANT_REACH * (a * outward + b * forward) for a, b in _QUADRANTS])
    levels, inside = sample(image, quadrants)
    visible: Bool[np.ndarray, " n"] = np.asarray(inside.all(axis=0))
    diagonal, other = levels[[0, 3]], levels[[1, 2]]  # the outward and forward quadrant is the last
    black_diagonal = other.min(axis=0) - diagonal.max(axis=0)
    white_diagonal = diagonal.min(axis=0) - other.max(axis=0)
    is_even = np.arange(len(places)) % 2 == 0
    gap = np.where(is_even == first_is_black, black_diagonal, white_diagonal)
    return (gap > _LEAST_GAP * contrast) & visible, visible


def grow(
    image: Float32[np.ndarray, "h w"], grid: Float[np.ndarray, "rows columns 2"]
) -> Float[np.ndarray, "all_rows all_columns 2"]:
    """Return the whole lattice that a part of it belongs to, as far as it is in the image."""
    while max(grid.shape[:2]) < _MOST_LINES:
        sides = lines_beyond(image, grid, measure_colours(image, grid))
        side = next((k for k, line in enumerate(sides) if line.is_lattice and line.is_visible), None)
        if side is None:
            break
        across = side >= 2
        turned = np.swapaxes(grid, 0, 1) if across else grid
        turned = turned[::-1] if side % 2 == 1 else turned
        refined = refine(image, np.stack([sides[side].places_px, turned[0]]))[:1]
        turned = np.concatenate([refined, turned])
        turned = turned[::-1] if side % 2 == 1 else turned
        grid = np.swapaxes(turned, 0, 1) if across else turned
    return grid


def sample(
    image: Float32[np.ndarray, "h w"], places: Float[np.ndarray, "*n 2"]
) -> tuple[Float32[np.ndarray, "*n"], Bool[np.ndarray, "*n"]]:
    """Return grey values at pixel places by bilinear interpolation, and which of the places are in the image."""
    shape = places.shape[:-1]
    flat = places.reshape(shape[0], -1, 2).astype(np.float32)
    levels = cv2.remap(image, flat[..., 0], flat[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    height, width = image.shape
    inside = np.all((places >= 0.0) & (places <= np.array([width - 1.0, height - 1.0])), axis=-1)
    return np.asarray(levels, dtype=np.float32).reshape(shape), inside
