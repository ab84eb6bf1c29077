"""The slopes of the light over a grid: of level and contrast, by the corners' own."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Bool, Float, Int

from core.jit import jit
from core.targets.subpixel.degree_selection import graded_coefficients, orthonormal
from core.targets.subpixel.smooth_map import GridBasis

_LIGHT_DEGREE = 3
_STANDS_OUT = 10.0
"""Times the median. Noise alone reaches it in one image of some thousands: a corner that it made uncertain in
one image and not in the next would be weighed differently in each, and where the camera does not fit the lens the pose
would jump.
"""
_AGREEMENT = 3.0  # standard deviations by which chance correlates neighbours


def grid_slopes(
    basis: GridBasis,
    ideal: Float[np.ndarray, "n 2"],
    column: Int[np.ndarray, " n"],
    row: Int[np.ndarray, " n"],
    values: Float[np.ndarray, "n 2"],
    known: Bool[np.ndarray, " n"],
) -> tuple[Float[np.ndarray, "n 2 2"], Float[np.ndarray, "n 2 2"]]:
    """Return two quantities' slopes at the points, by the ideal places' two coordinates, and the slopes' uncertainty.

    `ideal` are the places the map was made of; columns and rows say who is whose neighbour. The slopes are those of
    one low polynomial over all points, where it leaves mere noise; where neighbours agree in what it leaves (a
    reflex's edge, a shadow's), those from neighbour to neighbour. A slope's uncertainty is half the difference of
    those to either side, and a polynomial's includes the slopes that it leaves, where these stand out.
    """
    ideal, column, row = map(np.ascontiguousarray, (ideal, column, row))
    filled = np.where(known[:, None], values, 0.0)
    B = basis.polynomials
    Q, R = basis.factors if known.all() else orthonormal(np.where(known[:, None], B[0], 0.0))
    free, highest = int(np.count_nonzero(known)), min(basis.degree, _LIGHT_DEGREE)
    slopes, sigmas = np.empty((len(column), 2, 2)), np.zeros((len(column), 2, 2))
    for k in range(2):
        terms = graded_coefficients(Q, R, filled[:, k : k + 1], free, highest)[:, 0]
        rest = filled[:, k] - B[0][:, : len(terms)] @ terms
        is_uneven = _neighbours_agree(column, row, rest, known)
        between, sigma = _least_slopes(
            ideal, column, row, np.ascontiguousarray(filled[:, k]) if is_uneven else rest, known
        )
        if is_uneven:
            slopes[:, k] = between
        else:
            slopes[:, k, 0], slopes[:, k, 1] = (
                B[d][:, : len(terms)] @ terms / basis.index_size for d in (1, 2)
            )
            sigma += np.abs(between)
        assessed = np.isfinite(sigma)
        sigma = np.where(assessed, sigma, np.max(sigma, initial=0.0, where=assessed))
        if not is_uneven and assessed.any():  # only what stands out from the noise
            sigma[sigma < _STANDS_OUT * np.median(sigma[assessed])] = 0.0
        sigmas[:, k] = sigma
    return slopes, sigmas


@jit("i8[::1], i8[::1], b1[::1]")
def _table(
    column: Int[np.ndarray, " n"], row: Int[np.ndarray, " n"], known: Bool[np.ndarray, " n"]
) -> Int[np.ndarray, "h w"]:
    """Return which point is where in the grid, -1 at places without one, with a margin of one all around."""
    left, top = column.min() - 1, row.min() - 1
    at = np.full((row.max() - top + 2, column.max() - left + 2), -1)
    for n in range(len(column)):
        if known[n]:
            at[row[n] - top, column[n] - left] = n
    return at


@jit("i8[::1], i8[::1], f8[::1], b1[::1]")
def _neighbours_agree(
    column: Int[np.ndarray, " n"],
    row: Int[np.ndarray, " n"],
    values: Float[np.ndarray, " n"],
    known: Bool[np.ndarray, " n"],
) -> bool:
    """Return whether neighbouring values are correlated by more than chance."""
    at = _table(column, row, known)
    products, squares, pairs = 0.0, 0.0, 0
    for j in range(1, at.shape[0] - 1):
        for i in range(1, at.shape[1] - 1):
            for m in (at[j, i + 1], at[j + 1, i]):
                n = at[j, i]
                if n >= 0 and m >= 0:
                    products += values[n] * values[m]
                    squares += 0.5 * (values[n] ** 2 + values[m] ** 2)
                    pairs += 1
    return pairs > 0 and products > _AGREEMENT * squares / math.sqrt(pairs)


@jit("f8[:, ::1], i8[::1], i8[::1], f8[::1], b1[::1]")
def _least_slopes(
    ideal: Float[np.ndarray, "n 2"],
    column: Int[np.ndarray, " n"],
    row: Int[np.ndarray, " n"],
    values: Float[np.ndarray, " n"],
    known: Bool[np.ndarray, " n"],
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2"]]:
    """Return each point's slopes by its ideal place's coordinates: of those to its two neighbours the smaller one, 0
    where they have opposite signs, so that a jump beyond one of them does not count (P. L. Roe's minmod, 1986).

    Half of what the two differ, or of the only one, is returned as well; infinity without a neighbour.
    """
    at = _table(column, row, known)
    slopes, sigmas = np.zeros((len(column), 2)), np.full((len(column), 2), np.inf)
    left, top = column.min() - 1, row.min() - 1
    for n in range(len(column)):
        i, j = column[n] - left, row[n] - top
        if at[j, i] < 0:
            continue
        for axis in range(2):
            before = at[j, i - 1] if axis == 0 else at[j - 1, i]
            after = at[j, i + 1] if axis == 0 else at[j + 1, i]
            down, up = math.nan, math.nan
            if before >= 0:
                down = (values[n] - values[before]) / (ideal[n, axis] - ideal[before, axis])
            if after >= 0:
                up = (values[after] - values[n]) / (ideal[after, axis] - ideal[n, axis])
            if before < 0 and after < 0:
                continue
            if before < 0 or after < 0:
                slopes[n, axis] = up if after >= 0 else down
                sigmas[n, axis] = 0.5 * abs(slopes[n, axis])
                continue
            if up * down > 0.0:
                slopes[n, axis] = up if abs(up) < abs(down) else down
            sigmas[n, axis] = 0.5 * abs(up - down)
    return slopes, sigmas
