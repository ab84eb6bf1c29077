"""A smooth map from a grid's indices to pixels: what a plane seen by some lens looks like.

A homography and, upon its picture m, a polynomial: p = m + Σ c_ij m_uⁱ m_vʲ. A lens's distortion is a low polynomial of
the undistorted picture (cubic for k₁, quintic for k₂), about whatever centre. It serves for the edges' directions and
bends, to which a corner's own few pixels say little.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from core.compiled import compiled
from core.errors import InvalidArgument
from core.targets.graded_fit import graded_coefficients, orthonormal

_POWERS = np.array([(degree - j, j) for degree in range(6) for j in range(degree + 1)])
_POINTS_PER_TERM = 2
_LIGHT_DEGREE = 3
_STANDS_OUT = 4.0  # times the median
_AGREEMENT = 3.0  # standard deviations by which chance correlates neighbours


@dataclass(frozen=True, slots=True)
class GridBasis:
    """A homography's picture of a grid's points, and the polynomials upon it; all but pixels normalised.

    `picture` and `polynomials` come with their derivatives: by x, y, xx, yy of the indices.
    """

    middle_px: Float[np.ndarray, "2"]
    size_px: float
    index_size: float
    picture: Float[np.ndarray, "5 n 2"]
    polynomials: Float[np.ndarray, "5 n k"]
    Q: Float[np.ndarray, "n k"]
    R: Float[np.ndarray, "k k"]
    degree: int


@dataclass(frozen=True, slots=True)
class GridShape:
    """Where grid points lie, and the map's first and second derivatives by their indices x and y, px."""

    points_px: Float[np.ndarray, "n 2"]
    along_x: Float[np.ndarray, "n 2"]
    along_y: Float[np.ndarray, "n 2"]
    bend_x: Float[np.ndarray, "n 2"]
    bend_y: Float[np.ndarray, "n 2"]


def grid_basis(
    ideal: Float[np.ndarray, "n 2"], points_px: Float[np.ndarray, "n 2"], weights: Float[np.ndarray, " n"]
) -> GridBasis:
    """Prepare the map by points that are roughly known.

    Parameters
    ----------
    ideal
        Grid indices (column, row).
    weights
        Of each point's residual; zero leaves a point out.

    Raises
    ------
    InvalidArgument
        Fewer than four points, or all on a line.
    """
    used = weights > 0.0
    count = int(np.count_nonzero(used))
    if count < 4:
        raise InvalidArgument("A grid needs at least four points.", "Pass more of its points.")
    indices, _, _, index_size = _normalised(ideal, np.ones(len(ideal), dtype=np.bool_))
    points, *middle, size = _normalised(points_px, used)
    H = _homography(indices, points, weights)
    lines = min(_distinct(ideal, axis, used) for axis in range(2))
    terms = min(count // _POINTS_PER_TERM, len(_POWERS))
    degree = max((d for d in range(6) if (d + 1) * (d + 2) // 2 <= terms and d < 2 * lines), default=0)
    picture, polynomials = _derived(H, indices, _POWERS[: (degree + 1) * (degree + 2) // 2])
    Q, R = orthonormal(polynomials[0])
    return GridBasis(np.array(middle), size, index_size, picture, polynomials, Q, R, degree)


@compiled
def _normalised(
    points: Float[np.ndarray, "n 2"], used: Bool[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "n 2"], float, float, float]:
    """Return the points about the middle of those used, which there must be, in units of their spread; the middle and
    the spread.
    """
    count, u, v, square = 0, 0.0, 0.0, 0.0
    for k in range(len(points)):
        if used[k]:
            count, u, v = count + 1, u + points[k, 0], v + points[k, 1]
    u, v = u / count, v / count
    for k in range(len(points)):
        if used[k]:
            square += (points[k, 0] - u) ** 2 + (points[k, 1] - v) ** 2
    size = max(math.sqrt(0.5 * square / count), 1e-9)
    normalised = np.empty((len(points), 2))
    for k in range(len(points)):
        normalised[k, 0], normalised[k, 1] = (points[k, 0] - u) / size, (points[k, 1] - v) / size
    return normalised, u, v, size


@compiled
def _distinct(values: Float[np.ndarray, "n 2"], axis: int, used: Bool[np.ndarray, " n"]) -> int:
    """Return how many values there are in a column of those used; more than three count as three."""
    seen = np.empty(3)
    count = 0
    for k in range(len(values)):
        if used[k] and not np.any(seen[:count] == values[k, axis]):
            seen[count] = values[k, axis]
            count += 1
            if count == 3:
                break
    return count


def grid_shape(
    basis: GridBasis, points_px: Float[np.ndarray, "n 2"], weights: Float[np.ndarray, " n"] | None = None
) -> GridShape:
    """Fit the map to the points, with no higher a polynomial than they call for, and return it at these points."""
    bend = points_px / basis.size_px - (basis.middle_px / basis.size_px + basis.picture[0])
    Q, R, free = basis.Q, basis.R, len(bend)
    if weights is not None:
        root = np.sqrt(weights)[:, None]
        Q, R = orthonormal(basis.polynomials[0] * root)
        bend = bend * root
        free = int(np.count_nonzero(weights))
    coefficients = graded_coefficients(Q, R, bend, free, basis.degree)
    once, twice = basis.size_px / basis.index_size, basis.size_px / basis.index_size**2
    scales = np.array([basis.size_px, once, once, twice, twice])
    return GridShape(*_evaluated(basis.picture, basis.polynomials, coefficients, scales, basis.middle_px))


@compiled
def _evaluated(
    picture: Float[np.ndarray, "5 n 2"],
    polynomials: Float[np.ndarray, "5 n k"],
    coefficients: Float[np.ndarray, "t 2"],
    scales: Float[np.ndarray, "5"],
    middle_px: Float[np.ndarray, "2"],
) -> Float[np.ndarray, "5 n 2"]:
    """Return the map and its derivatives: the homography's picture and the first t polynomials, in px."""
    values = np.empty_like(picture)
    for d in range(5):
        for n in range(picture.shape[1]):
            u, v = picture[d, n, 0], picture[d, n, 1]
            for t in range(len(coefficients)):
                u += polynomials[d, n, t] * coefficients[t, 0]
                v += polynomials[d, n, t] * coefficients[t, 1]
            values[d, n, 0], values[d, n, 1] = u * scales[d], v * scales[d]
            if d == 0:
                values[d, n, 0] += middle_px[0]
                values[d, n, 1] += middle_px[1]
    return values


def grid_slopes(
    basis: GridBasis,
    ideal: Float[np.ndarray, "n 2"],
    column: Int[np.ndarray, " n"],
    row: Int[np.ndarray, " n"],
    values: Float[np.ndarray, "n 2"],
    known: Bool[np.ndarray, " n"],
) -> tuple[Float[np.ndarray, "n 2 2"], Float[np.ndarray, "n 2 2"]]:
    """Return two quantities' slopes at the points, by the ideal places' two coordinates, and the slopes' doubt.

    `ideal` are the places the map was made of; columns and rows say who is whose neighbour. The slopes are those of one
    low polynomial over all points, where it leaves mere noise; where neighbours agree in what it leaves (a reflex's
    edge, a shadow's), those from neighbour to neighbour. A slope is doubtful by half of what those to either side
    differ, and a polynomial's by the slopes that it leaves, where these stand out.
    """
    filled = np.where(known[:, None], values, 0.0)
    B, Q, R = basis.polynomials, basis.Q, basis.R
    if not known.all():
        Q, R = orthonormal(np.where(known[:, None], B[0], 0.0))
    free, highest = int(np.count_nonzero(known)), min(basis.degree, _LIGHT_DEGREE)
    slopes, doubts = np.empty((len(column), 2, 2)), np.zeros((len(column), 2, 2))
    for k in range(2):
        terms = graded_coefficients(Q, R, filled[:, k : k + 1], free, highest)[:, 0]
        rest = filled[:, k] - B[0][:, : len(terms)] @ terms
        is_uneven = _neighbours_agree(column, row, rest, known)
        between, doubt = _least_slopes(ideal, column, row, filled[:, k] if is_uneven else rest, known)
        if is_uneven:
            slopes[:, k] = between
        else:
            slopes[:, k, 0], slopes[:, k, 1] = (
                B[d][:, : len(terms)] @ terms / basis.index_size for d in (1, 2)
            )
            doubt += np.abs(between)
        told = np.isfinite(doubt)
        doubt = np.where(told, doubt, np.max(doubt, initial=0.0, where=told))
        if not is_uneven and told.any():  # only what stands out from the noise
            doubt[doubt < _STANDS_OUT * np.median(doubt[told])] = 0.0
        doubts[:, k] = doubt
    return slopes, doubts


def _homography(
    x: Float[np.ndarray, "n 2"], p: Float[np.ndarray, "n 2"], weights: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "3 3"]:
    """Return H of p ~ H x by the direct linear transform, both normalised."""
    values, vectors = np.linalg.eigh(_transform_products(x, p, weights))
    if not values[1] > 1e-9 * values[-1]:
        raise InvalidArgument("The grid's points lie on a line.", "Pass points of at least two lines.")
    H = vectors[:, 0].reshape(3, 3)
    return H if H[2] @ (*x.sum(axis=0), len(x)) > 0.0 else -H


@compiled
def _transform_products(
    x: Float[np.ndarray, "n 2"], p: Float[np.ndarray, "n 2"], weights: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "9 9"]:
    """Return AᵀA (its lower triangle) of the direct linear transform's rows (x, 0, -u x) and (0, x, -v x), with
    x = (x, y, 1)."""
    A = np.zeros((9, 9))
    one = np.ones(3)
    for n in range(len(x)):
        one[0], one[1] = x[n, 0], x[n, 1]
        u, v, weight = p[n, 0], p[n, 1], weights[n]
        for i in range(3):
            for j in range(3):
                product = weight * one[i] * one[j]
                A[i, j] += product
                A[6 + i, j] -= u * product
                A[6 + i, 3 + j] -= v * product
                A[6 + i, 6 + j] += (u * u + v * v) * product
    A[3:6, 3:6] = A[:3, :3]
    return A


@compiled
def _derived(
    H: Float[np.ndarray, "3 3"], x: Float[np.ndarray, "n 2"], powers: Int[np.ndarray, "k 2"]
) -> tuple[Float[np.ndarray, "5 n 2"], Float[np.ndarray, "5 n k"]]:
    """Return m = H x dehomogenised and the monomials m_uⁱ m_vʲ, both with their derivatives by x, y, xx, yy."""
    count, terms = len(x), len(powers)
    picture, polynomials = np.empty((5, count, 2)), np.empty((5, count, terms))
    u_powers, v_powers = np.zeros(8), np.zeros(8)  # that of degree d at d + 2: two derivatives begin with 0
    u_powers[2] = v_powers[2] = 1.0
    for n in range(count):
        scale = H[2, 0] * x[n, 0] + H[2, 1] * x[n, 1] + H[2, 2]
        scale = scale if abs(scale) > 1e-9 else 1e-9
        for c in range(2):
            m = (H[c, 0] * x[n, 0] + H[c, 1] * x[n, 1] + H[c, 2]) / scale
            picture[0, n, c] = m
            for k in range(2):
                picture[1 + k, n, c] = (H[c, k] - m * H[2, k]) / scale
                picture[3 + k, n, c] = -2.0 * H[2, k] * picture[1 + k, n, c] / scale
        for d in range(3, 8):
            u_powers[d] = u_powers[d - 1] * picture[0, n, 0]
            v_powers[d] = v_powers[d - 1] * picture[0, n, 1]
        for t in range(terms):
            i, j = powers[t]
            u, v = u_powers[i + 2], v_powers[j + 2]
            u_1, v_1 = i * u_powers[i + 1], j * v_powers[j + 1]
            u_2, v_2 = i * (i - 1) * u_powers[i], j * (j - 1) * v_powers[j]
            polynomials[0, n, t] = u * v
            for k in range(2):
                m_u, m_v = picture[1 + k, n]
                polynomials[1 + k, n, t] = u_1 * v * m_u + u * v_1 * m_v
                bent = u_2 * v * m_u * m_u + 2.0 * u_1 * v_1 * m_u * m_v + u * v_2 * m_v * m_v
                polynomials[3 + k, n, t] = (
                    bent + u_1 * v * picture[3 + k, n, 0] + u * v_1 * picture[3 + k, n, 1]
                )
    return picture, polynomials


@compiled
def _table(
    column: Int[np.ndarray, " n"], row: Int[np.ndarray, " n"], known: Bool[np.ndarray, " n"]
) -> Int[np.ndarray, "h w"]:
    """Return which point is where in the grid, -1 where there is none, with a margin of one all around."""
    left, top = column.min() - 1, row.min() - 1
    at = np.full((row.max() - top + 2, column.max() - left + 2), -1)
    for n in range(len(column)):
        if known[n]:
            at[row[n] - top, column[n] - left] = n
    return at


@compiled
def _neighbours_agree(
    column: Int[np.ndarray, " n"],
    row: Int[np.ndarray, " n"],
    values: Float[np.ndarray, " n"],
    known: Bool[np.ndarray, " n"],
) -> bool:
    """Tell whether neighbouring values are correlated by more than chance."""
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


@compiled
def _least_slopes(
    ideal: Float[np.ndarray, "n 2"],
    column: Int[np.ndarray, " n"],
    row: Int[np.ndarray, " n"],
    values: Float[np.ndarray, " n"],
    known: Bool[np.ndarray, " n"],
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2"]]:
    """Return each point's slopes by its ideal place's coordinates: of those to its two neighbours the smaller one, 0
    where they have opposite signs, so that a jump beyond one of them does not count (P. L. Roe's minmod, 1986).

    Half of what the two differ, or of the only one, is returned beside; where there is none, infinity.
    """
    at = _table(column, row, known)
    slopes, doubts = np.zeros((len(column), 2)), np.full((len(column), 2), np.inf)
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
                doubts[n, axis] = 0.5 * abs(slopes[n, axis])
                continue
            if up * down > 0.0:
                slopes[n, axis] = up if abs(up) < abs(down) else down
            doubts[n, axis] = 0.5 * abs(up - down)
    return slopes, doubts
