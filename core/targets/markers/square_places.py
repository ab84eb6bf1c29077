"""Where the squares of a lattice lie in the image.

A square's four corners map it to the image; unknown corners are predicted from their neighbours, so that the squares
around the lattice's outermost corners are mapped as well.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float, Int

from core.geometry import unit_square_homography
from core.jit import jit


def places_in_squares(
    places_px: Float[np.ndarray, "rows columns 2"],
    squares: Int[np.ndarray, "n 2"],
    in_square: Float[np.ndarray, "m 2"],
) -> Float[np.ndarray, "n m 2"]:
    """Return the pixels of places in some squares, given by their columns and rows as in `DecodedMarkers`.

    `in_square` runs from (0, 0) at the square's first corner, to the right and downward, to (1, 1).
    """
    return mapped_squares(places_px, np.ascontiguousarray(squares), np.ascontiguousarray(in_square))


@jit("f8[:, :, ::1], i8[:, ::1], f8[:, ::1]")
def mapped_squares(
    places_px: Float[np.ndarray, "rows columns 2"],
    squares: Int[np.ndarray, "n 2"],
    in_square: Float[np.ndarray, "m 2"],
) -> Float[np.ndarray, "n m 2"]:
    """Do what `places_in_squares` says; NaN in squares that are no convex quadrangles."""
    mapped = np.full((len(squares), len(in_square), 2), np.nan)
    H = np.empty(8)
    for n in range(len(squares)):
        i, j = squares[n, 0] + 1, squares[n, 1] + 1
        if unit_square_homography(
            places_px[j, i], places_px[j, i + 1], places_px[j + 1, i + 1], places_px[j + 1, i], H
        ):
            for m in range(len(in_square)):
                x, y = in_square[m]
                scale = 1.0 / (H[6] * x + H[7] * y + 1.0)
                mapped[n, m, 0] = (H[0] * x + H[1] * y + H[2]) * scale
                mapped[n, m, 1] = (H[3] * x + H[4] * y + H[5]) * scale
    return mapped


@jit("f8[:, :, ::1]")
def surrounded(grid: Float[np.ndarray, "rows columns 2"]) -> Float[np.ndarray, "rows+2 columns+2 2"]:
    """Return the lattice with a line more on each side, and places foreseen from their neighbours where none are known.

    Twice: what is foreseen first serves the second time, so that squares have all four corners at the outermost ones.
    """
    rows, columns = grid.shape[0] + 2, grid.shape[1] + 2
    places = np.full((rows, columns, 2), np.nan)
    for j in range(rows - 2):
        for i in range(columns - 2):
            places[j + 1, i + 1, 0], places[j + 1, i + 1, 1] = grid[j, i, 0], grid[j, i, 1]
    for _ in range(2):
        before = places.copy()
        for j in range(rows):
            for i in range(columns):
                if math.isfinite(before[j, i, 0]):
                    continue
                u, v, weight = 0.0, 0.0, 0.0
                for direction in range(4):
                    dj = 1 if direction == 0 else -1 if direction == 1 else 0
                    di = 1 if direction == 2 else -1 if direction == 3 else 0
                    reached = 0
                    while reached < 3:
                        m, n = j + (reached + 1) * dj, i + (reached + 1) * di
                        if not (0 <= m < rows and 0 <= n < columns and math.isfinite(before[m, n, 0])):
                            break
                        reached += 1
                    if reached == 3:
                        a, b, c = (
                            before[j + dj, i + di],
                            before[j + 2 * dj, i + 2 * di],
                            before[j + 3 * dj, i + 3 * di],
                        )
                        u += 4.0 * (3.0 * a[0] - 3.0 * b[0] + c[0])
                        v += 4.0 * (3.0 * a[1] - 3.0 * b[1] + c[1])
                        weight += 4.0
                    elif reached == 2:
                        u += 2.0 * before[j + dj, i + di, 0] - before[j + 2 * dj, i + 2 * di, 0]
                        v += 2.0 * before[j + dj, i + di, 1] - before[j + 2 * dj, i + 2 * di, 1]
                        weight += 1.0
                    if reached >= 1:
                        m, n = j - dj, i - di
                        if 0 <= m < rows and 0 <= n < columns and math.isfinite(before[m, n, 0]):
                            u += before[j + dj, i + di, 0] + before[m, n, 0]
                            v += before[j + dj, i + di, 1] + before[m, n, 1]
                            weight += 2.0
                        for way in (1, -1):
                            m, n = j + way * di, i + way * dj
                            if not (0 <= m < rows and 0 <= n < columns):
                                continue
                            if not (0 <= m + dj < rows and 0 <= n + di < columns):
                                continue
                            if math.isfinite(before[m, n, 0]) and math.isfinite(before[m + dj, n + di, 0]):
                                u += 0.5 * (
                                    before[j + dj, i + di, 0] + before[m, n, 0] - before[m + dj, n + di, 0]
                                )
                                v += 0.5 * (
                                    before[j + dj, i + di, 1] + before[m, n, 1] - before[m + dj, n + di, 1]
                                )
                                weight += 0.5
                if weight > 0.0:
                    places[j, i, 0], places[j, i, 1] = u / weight, v / weight
    return places
