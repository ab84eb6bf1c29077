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

_POWERS = [(degree - j, j) for degree in range(6) for j in range(degree + 1)]
_POINTS_PER_TERM = 2
_TELLING = 5.0
"""A degree is used if its terms explain more than mere noise would by so many standard deviations of that."""
_LIGHT_DEGREE = 3
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
    index_size = max(float(ideal.std()), 1e-9)
    middle, size = points_px[used].mean(axis=0), max(float(points_px[used].std()), 1e-9)
    x = np.column_stack([(ideal - ideal.mean(axis=0)) / index_size, np.ones(len(ideal))])
    picture = _projected(_homography(x, (points_px - middle) / size, weights), x)
    lines = min(len(np.unique(ideal[used, k])) for k in range(2))
    terms = min(count // _POINTS_PER_TERM, len(_POWERS))
    degree = max((d for d in range(6) if (d + 1) * (d + 2) // 2 <= terms and d < 2 * lines), default=0)
    polynomials = _monomials(picture, _POWERS[: (degree + 1) * (degree + 2) // 2])
    Q, R = np.linalg.qr(polynomials[0])
    return GridBasis(middle, size, index_size, picture, polynomials, Q, R, degree)


def grid_shape(
    basis: GridBasis, points_px: Float[np.ndarray, "n 2"], weights: Float[np.ndarray, " n"] | None = None
) -> GridShape:
    """Fit the map to the points, with no higher a polynomial than they call for, and return it at these points."""
    bend = (points_px - basis.middle_px) / basis.size_px - basis.picture[0]
    Q, R, free = basis.Q, basis.R, len(bend)
    if weights is not None:
        root = np.sqrt(weights)[:, None]
        Q, R = np.linalg.qr(basis.polynomials[0] * root)
        bend = bend * root
        free = int(np.count_nonzero(weights))
    coefficients = _coefficients(Q, R, bend, free, basis.degree)
    values = basis.picture + basis.polynomials[:, :, : len(coefficients)] @ coefficients
    once, twice = basis.size_px / basis.index_size, basis.size_px / basis.index_size**2
    return GridShape(
        points_px=values[0] * basis.size_px + basis.middle_px,
        along_x=values[1] * once,
        along_y=values[2] * once,
        bend_x=values[3] * twice,
        bend_y=values[4] * twice,
    )


@compiled
def _coefficients(
    Q: Float[np.ndarray, "n k"],
    R: Float[np.ndarray, "k k"],
    y: Float[np.ndarray, "n c"],
    free: int,
    highest: int,
) -> Float[np.ndarray, "t c"]:
    """Return the least-squares coefficients of B = Q R up to the highest degree whose terms tell more than noise."""
    columns = y.shape[1]
    explained = np.zeros((Q.shape[1], columns))
    left = 0.0
    for n in range(Q.shape[0]):
        for c in range(columns):
            left += y[n, c] ** 2
            for k in range(Q.shape[1]):
                explained[k, c] += Q[n, k] * y[n, c]
    terms = 0
    for degree in range(highest + 1):
        first, last = degree * (degree + 1) // 2, (degree + 1) * (degree + 2) // 2
        told, least = 0.0, math.inf
        for k in range(first, last):
            least = min(least, abs(R[k, k]))
            for c in range(columns):
                told += explained[k, c] ** 2
        left -= told
        if least <= 1e-9 * abs(R[0, 0]):  # too few points, or all on a line
            break
        noise = max(left, 0.0) / max((free - last) * columns, 1)
        values = (last - first) * columns
        if told > noise * (values + _TELLING * math.sqrt(2.0 * values)):
            terms = last
    solution = explained[:terms].copy()
    for c in range(columns):
        for i in range(terms - 1, -1, -1):
            for k in range(i + 1, terms):
                solution[i, c] -= R[i, k] * solution[k, c]
            solution[i, c] /= R[i, i]
    return solution


def grid_slopes(
    basis: GridBasis,
    column: Int[np.ndarray, " n"],
    row: Int[np.ndarray, " n"],
    values: Float[np.ndarray, "n 2"],
    known: Bool[np.ndarray, " n"],
) -> Float[np.ndarray, "n 2 2"]:
    """Return the slopes by column and row of two quantities measured at the points.

    Those of one low polynomial over all points, where it leaves mere noise; where neighbours agree in what it leaves (a
    reflex's edge, a shadow's), those from neighbour to neighbour.
    """
    filled = np.where(known[:, None], values, 0.0)
    B, Q, R = basis.polynomials, basis.Q, basis.R
    if not known.all():
        Q, R = np.linalg.qr(np.where(known[:, None], B[0], 0.0))
    free, highest = int(np.count_nonzero(known)), min(basis.degree, _LIGHT_DEGREE)
    slopes = np.empty((len(column), 2, 2))
    for k in range(2):
        terms = _coefficients(Q, R, filled[:, k : k + 1], free, highest)[:, 0]
        rest = filled[:, k] - B[0][:, : len(terms)] @ terms
        if _neighbours_agree(column, row, rest, known):
            slopes[:, k] = _least_slopes(column, row, filled[:, k], known)
        else:
            slopes[:, k, 0], slopes[:, k, 1] = (
                B[d][:, : len(terms)] @ terms / basis.index_size for d in (1, 2)
            )
    return slopes


def _homography(
    x: Float[np.ndarray, "n 3"], p: Float[np.ndarray, "n 2"], weights: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "3 3"]:
    """Return H of p ~ H x by the direct linear transform, both normalised."""
    w = np.sqrt(weights)[:, None]
    zero = np.zeros_like(x)
    A = np.concatenate(
        [
            np.concatenate([x, zero, -p[:, :1] * x], axis=1) * w,
            np.concatenate([zero, x, -p[:, 1:] * x], axis=1) * w,
        ]
    )
    values, vectors = np.linalg.eigh(A.T @ A)
    if not values[1] > 1e-9 * values[-1]:
        raise InvalidArgument("The grid's points lie on a line.", "Pass points of at least two lines.")
    H = vectors[:, 0].reshape(3, 3)
    return H if np.sum(x @ H[2]) > 0.0 else -H


def _projected(H: Float[np.ndarray, "3 3"], x: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "5 n 2"]:
    """Return m = H x dehomogenised, its derivatives by x and y, and the second ones by x and by y."""
    scale = (x @ H[2])[:, None]
    scale = np.where(np.abs(scale) > 1e-9, scale, 1e-9)
    m = x @ H[:2].T / scale
    first = [(H[:2, k] - m * H[2, k]) / scale for k in range(2)]
    second = [-2.0 * H[2, k] * first[k] / scale for k in range(2)]
    return np.stack([m, *first, *second])


def _monomials(
    picture: Float[np.ndarray, "5 n 2"], powers: list[tuple[int, int]]
) -> Float[np.ndarray, "5 n k"]:
    """Return the monomials of the homography's picture, and their derivatives by x, y, xx, yy."""
    m, m_x, m_y, m_xx, m_yy = picture
    i, j = np.array(powers).T
    highest = int(i.max())
    tables = []
    for values in m.T:
        power = np.vander(values, highest + 1, increasing=True)
        k = np.arange(highest + 1)
        once, twice = np.zeros_like(power), np.zeros_like(power)
        once[:, 1:] = power[:, :-1] * k[1:]
        twice[:, 2:] = power[:, :-2] * (k * (k - 1))[2:]
        tables.append((power, once, twice))
    u, v = ([table[:, p] for table in tables[axis]] for axis, p in ((0, i), (1, j)))
    B_u, B_v, B_uu, B_uv, B_vv = u[1] * v[0], u[0] * v[1], u[2] * v[0], u[1] * v[1], u[0] * v[2]
    first = [B_u * d[:, :1] + B_v * d[:, 1:] for d in (m_x, m_y)]
    second = [
        B_u * dd[:, :1]
        + B_v * dd[:, 1:]
        + B_uu * d[:, :1] ** 2
        + 2.0 * B_uv * d[:, :1] * d[:, 1:]
        + B_vv * d[:, 1:] ** 2
        for d, dd in ((m_x, m_xx), (m_y, m_yy))
    ]
    return np.stack([u[0] * v[0], *first, *second])


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
    column: Int[np.ndarray, " n"],
    row: Int[np.ndarray, " n"],
    values: Float[np.ndarray, " n"],
    known: Bool[np.ndarray, " n"],
) -> Float[np.ndarray, "n 2"]:
    """Return each point's slopes by column and row: of the differences to its two neighbours the smaller one, 0 where
    they have opposite signs, so that a jump beyond one of them does not count (P. L. Roe's minmod, 1986).
    """
    at = _table(column, row, known)
    slopes = np.zeros((len(column), 2))
    left, top = column.min() - 1, row.min() - 1
    for n in range(len(column)):
        i, j = column[n] - left, row[n] - top
        if at[j, i] < 0:
            continue
        for axis in range(2):
            before = at[j, i - 1] if axis == 0 else at[j - 1, i]
            after = at[j, i + 1] if axis == 0 else at[j + 1, i]
            down = values[n] - values[before] if before >= 0 else math.nan
            up = values[after] - values[n] if after >= 0 else math.nan
            if before < 0 or after < 0:
                slopes[n, axis] = up if after >= 0 else down if before >= 0 else 0.0
            elif up * down > 0.0:
                slopes[n, axis] = up if abs(up) < abs(down) else down
    return slopes
