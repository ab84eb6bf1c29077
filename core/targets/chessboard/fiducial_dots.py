"""Decode the fiducial dots of a chessboard from a lattice of its corners.

The dots determine which part of the board a partial view shows. Four squares near the board's middle carry a round
dot of the opposite colour, in the shape of an L: the elbow, a white square with a black dot; two more along +x from
it; one along +y. Seen from the front, with x to the right and y down (`#` black square, `.` white one, `o` white
dot, `x` black dot):

    . # . # . #
    # x o x # .      the elbow, and two squares to its right
    . o . # . #      one below it
    # . # . # .

No turn maps this L to itself, and no mirror makes it a turned one: the L alone determines origin, turn and mirroring,
whatever else of the board is in view. The square (i, j) is that between the grid points (i, j) and (i + 1, j + 1); the
square diagonally beyond grid point (0, 0) is black, so white squares are those with i + j odd. A dot is .34 pitches
wide, as OpenCV's `gen_pattern.py` draws its markers: its edge stays a third of a pitch away from the edges that corners
are measured by.

A square is sampled in its own coordinates, bilinear between its four corners: its middle against a ring around it. Its
score is their difference, in the sense a dot would make, relative to the contrast at its corners: near one for a dot,
less where blur is as wide as the dot, near zero for a plain square.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Shaped

from core.jit import jit
from core.targets.lattice import Lattice
from core.targets.specification import TargetSpec

_MIDDLE, _RING = 0.08, 0.31  # of the square's side, from its centre
_MIN_SCORE = 0.25
_WORTH_A_LOOK = 0.08  # at a few places
_PLAIN = 0.5  # of the least of four marks: squares next to them score less


@dataclass(frozen=True, slots=True)
class Reading:
    """Where a lattice carries the marks: in the lattice mirrored left to right first where `is_mirrored`, then turned
    `turns` times by `Lattice.quarter_turn`, the elbow is the square after the point (`column`, `row`)."""

    turns: int
    is_mirrored: bool
    column: int
    row: int


def decode_fiducial_dots(image: Shaped[np.ndarray, "h w"], lattice: Lattice) -> tuple[Reading, ...]:
    """Return every way in which a lattice's marked squares are the marks of a board, with plain squares around them."""
    rows, columns = lattice.gap.shape
    if rows < 2 or columns < 2:
        return ()
    scores = dot_scores(
        image,
        np.ascontiguousarray(lattice.grid),
        np.ascontiguousarray(lattice.gap),
        lattice.origin_is_bright,
    )
    if np.count_nonzero(scores > _MIN_SCORE) < len(SHAPE):
        return ()
    j, i = np.mgrid[0 : rows - 1, 0 : columns - 1]
    bright = ((i + j) % 2 == 0) == lattice.origin_is_bright
    readings = []
    for is_mirrored in (False, True):
        for turns in range(4):
            seen, are_bright = (np.rot90(a[:, ::-1] if is_mirrored else a, turns) for a in (scores, bright))
            readings += [
                Reading(turns, is_mirrored, int(a), int(b))
                for b, a in np.argwhere((seen > _MIN_SCORE) & are_bright).tolist()
                if _is_elbow(seen, a, b)
            ]
    return tuple(readings)


def _is_elbow(scores: Float[np.ndarray, "rows columns"], column: int, row: int) -> bool:
    """Return whether the marks, and no others near them, begin at a square."""
    rows, columns = scores.shape
    marks = {(column + i, row + j) for i, j in SHAPE}
    if any(not (i < columns and j < rows and scores[j, i] > _MIN_SCORE) for i, j in marks):
        return False
    limit = _PLAIN * min(scores[j, i] for i, j in marks)
    around = [
        scores[j, i]
        for j in range(max(row - 1, 0), min(row + 3, rows))
        for i in range(max(column - 1, 0), min(column + 4, columns))
        if (i, j) not in marks
    ]
    return not any(score > limit for score in around)  # unknown ones are NaN, and may be anything


@jit("u1[:, ::1], f8[:, :, ::1], f8[:, ::1], b1", "u2[:, ::1], f8[:, :, ::1], f8[:, ::1], b1")
def dot_scores(
    image: Shaped[np.ndarray, "h w"],
    grid: Float[np.ndarray, "rows columns 2"],
    gap: Float[np.ndarray, "rows columns"],
    origin_is_bright: bool,
) -> Float[np.ndarray, "rows-1 columns-1"]:
    """Return how much each square looks as if it carried a mark; NaN where a corner of it is unknown."""
    rows, columns = gap.shape
    scores = np.full((rows - 1, columns - 1), np.nan)
    for j in range(rows - 1):
        for i in range(columns - 1):
            contrast = 0.25 * (gap[j, i] + gap[j, i + 1] + gap[j + 1, i] + gap[j + 1, i + 1])
            if not contrast > 0.0:
                continue
            sign = 1.0 if ((i + j) % 2 == 0) == origin_is_bright else -1.0
            # five places first: they suffice to reject most of the plain squares
            middle, ring = black_white_midpoint(image, grid, j, i, 0.5, 0.5), 0.0
            for n in range(4):
                x, y = (_RING if n % 2 == 0 else -_RING), (_RING if n < 2 else -_RING)
                ring += black_white_midpoint(image, grid, j, i, 0.5 + x, 0.5 + y) / 4.0
            scores[j, i] = sign * (ring - middle) / contrast
            if scores[j, i] < _WORTH_A_LOOK:
                continue
            middle, ring = 0.0, 0.0
            for n in range(9):
                # the middle of three by three places is counted once, as is each of the eight around it
                x, y = (n % 3 - 1.0), (n // 3 - 1.0)
                inner = black_white_midpoint(image, grid, j, i, 0.5 + _MIDDLE * x, 0.5 + _MIDDLE * y)
                middle += inner / 9.0
                if n != 4:
                    ring += black_white_midpoint(image, grid, j, i, 0.5 + _RING * x, 0.5 + _RING * y) / 8.0
            scores[j, i] = sign * (ring - middle) / contrast
    return scores


@jit("u1[:, ::1], f8[:, :, ::1], i8, i8, f8, f8", "u2[:, ::1], f8[:, :, ::1], i8, i8, f8, f8")
def black_white_midpoint(
    image: Shaped[np.ndarray, "h w"],
    grid: Float[np.ndarray, "rows columns 2"],
    j: int,
    i: int,
    x: float,
    y: float,
) -> float:
    """Return the grey value, bilinear between pixels, at the place (x, y) from 0 to 1 in the square after (i, j)."""
    height, width = image.shape
    u, v = 0.0, 0.0
    for down in range(2):
        for right in range(2):
            weight = (x if right == 1 else 1.0 - x) * (y if down == 1 else 1.0 - y)
            u += weight * grid[j + down, i + right, 0]
            v += weight * grid[j + down, i + right, 1]
    u, v = min(max(u, 0.0), width - 1.001), min(max(v, 0.0), height - 1.001)
    left, top = math.floor(u), math.floor(v)
    a, b = u - left, v - top
    upper = (1.0 - a) * image[top, left] + a * image[top, left + 1]
    lower = (1.0 - a) * image[top + 1, left] + a * image[top + 1, left + 1]
    return float((1.0 - b) * upper + b * lower)


MARK_DIAMETER = 0.34
"""Of the pitch."""
SHAPE = ((0, 0), (1, 0), (2, 0), (0, 1))
"""The marked squares, counted from the elbow."""


def marked_squares(target: TargetSpec) -> tuple[tuple[int, int], ...]:
    """Return the squares (i, j) of a chessboard that carry a mark if any do, the elbow first.

    Square (i, j) lies between the grid points (i, j) and (i + 1, j + 1). Empty for what is no chessboard, and for
    boards of less than 4 x 4 or 5 x 3 grid points, on which the marks have no room.
    """
    if target.kind != "chessboard":
        return ()
    places = [(a, b) for b in range(target.rows - 2) for a in range(target.columns - 3) if (a + b) % 2 == 1]
    if not places:
        return ()
    middle = (0.5 * (target.columns - 4), 0.5 * (target.rows - 3))
    elbow = min(places, key=lambda p: (abs(p[0] - middle[0]) + abs(p[1] - middle[1]), p))
    return tuple((elbow[0] + i, elbow[1] + j) for i, j in SHAPE)


def mark_diameter_mm(target: TargetSpec) -> float:
    """Return how wide a mark's dot is, mm."""
    return MARK_DIAMETER * target.pitch_mm
