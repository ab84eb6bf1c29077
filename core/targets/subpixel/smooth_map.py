"""A smooth map from a grid's indices to pixels: what a plane seen by some lens looks like.

A homography and, on its image m, a polynomial: p = m + Σ c_ij m_uⁱ m_vʲ. A lens's distortion is a low polynomial of
the undistorted image (cubic for k₁, quintic for k₂), about whatever centre. It serves for the edges' directions and
bends, to which a corner's own few pixels say little.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from core.errors import DegenerateGeometry
from core.geometry import normalised_homography
from core.jit import jit
from core.targets.subpixel.degree_selection import graded_coefficients, orthonormal

_POWERS = np.array([(degree - j, j) for degree in range(6) for j in range(degree + 1)])
_POINTS_PER_TERM = 2


@dataclass(frozen=True)
class GridBasis:
    """A homography's image of a grid's points, and the polynomials on it; all but pixels normalised.

    `projected` and `polynomials` come with their derivatives: by x, y, xx, yy, xy of the indices.
    """

    middle_px: Float[np.ndarray, "2"]
    size_px: float
    index_size: float
    projected: Float[np.ndarray, "6 n 2"]
    polynomials: Float[np.ndarray, "6 n k"]
    degree: int

    @cached_property
    def factors(self) -> tuple[Float[np.ndarray, "n k"], Float[np.ndarray, "k k"]]:
        """Q and R of the polynomials at all points, equally weighted."""
        return orthonormal(self.polynomials[0])


@dataclass(frozen=True, slots=True)
class GridShape:
    """Where grid points lie, and the map's first and second derivatives by their indices x and y, px."""

    points_px: Float[np.ndarray, "n 2"]
    along_x: Float[np.ndarray, "n 2"]
    along_y: Float[np.ndarray, "n 2"]
    bend_x: Float[np.ndarray, "n 2"]
    bend_y: Float[np.ndarray, "n 2"]
    bend_xy: Float[np.ndarray, "n 2"]


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
    DegenerateGeometry
        Fewer than four points, or all on a line.
    """
    ideal, points_px = np.ascontiguousarray(ideal), np.ascontiguousarray(points_px)
    used = weights > 0.0
    count = int(np.count_nonzero(used))
    if count < 4:
        raise DegenerateGeometry("A grid needs at least four points.", "Pass more of its points.")
    indices, _, _, index_size = _normalised(ideal, np.ones(len(ideal), dtype=np.bool_))
    points, *middle, size = _normalised(points_px, used)
    H = normalised_homography(indices, points, weights)
    if H[2] @ (*indices.sum(axis=0), len(indices)) < 0.0:
        H = -H
    lines = min(_distinct(ideal, axis, used) for axis in range(2))
    terms = min(count // _POINTS_PER_TERM, len(_POWERS))
    degree = max((d for d in range(6) if (d + 1) * (d + 2) // 2 <= terms and d < 2 * lines), default=0)
    projected, polynomials = _derived(
        np.ascontiguousarray(H), indices, _POWERS[: (degree + 1) * (degree + 2) // 2]
    )
    return GridBasis(np.array(middle), size, index_size, projected, polynomials, degree)


@jit("f8[:, ::1], b1[::1]")
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


@jit("f8[:, ::1], i8, b1[::1]")
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
    bend = points_px / basis.size_px - (basis.middle_px / basis.size_px + basis.projected[0])
    free = len(bend)
    if weights is None:
        Q, R = basis.factors
    else:
        root = np.sqrt(weights)[:, None]
        Q, R = orthonormal(basis.polynomials[0] * root)
        bend = bend * root
        free = int(np.count_nonzero(weights))
    coefficients = graded_coefficients(Q, R, bend, free, basis.degree)
    once, twice = basis.size_px / basis.index_size, basis.size_px / basis.index_size**2
    scales = np.array([basis.size_px, once, once, twice, twice, twice])
    return GridShape(*_evaluated(basis.projected, basis.polynomials, coefficients, scales, basis.middle_px))


@jit("f8[:, :, ::1], f8[:, :, ::1], f8[:, ::1], f8[::1], f8[::1]")
def _evaluated(
    projected: Float[np.ndarray, "6 n 2"],
    polynomials: Float[np.ndarray, "6 n k"],
    coefficients: Float[np.ndarray, "t 2"],
    scales: Float[np.ndarray, "6"],
    middle_px: Float[np.ndarray, "2"],
) -> Float[np.ndarray, "6 n 2"]:
    """Return the map and its derivatives: the homography's image and the first t polynomials, in px."""
    values = np.empty_like(projected)
    for d in range(6):
        for n in range(projected.shape[1]):
            u, v = projected[d, n, 0], projected[d, n, 1]
            for t in range(len(coefficients)):
                u += polynomials[d, n, t] * coefficients[t, 0]
                v += polynomials[d, n, t] * coefficients[t, 1]
            values[d, n, 0], values[d, n, 1] = u * scales[d], v * scales[d]
            if d == 0:
                values[d, n, 0] += middle_px[0]
                values[d, n, 1] += middle_px[1]
    return values


@jit("f8[:, ::1], f8[:, ::1], i8[:, ::1]")
def _derived(
    H: Float[np.ndarray, "3 3"], x: Float[np.ndarray, "n 2"], powers: Int[np.ndarray, "k 2"]
) -> tuple[Float[np.ndarray, "6 n 2"], Float[np.ndarray, "6 n k"]]:
    """Return m = H x dehomogenised and the monomials m_uⁱ m_vʲ, both with their derivatives by x, y, xx, yy, xy."""
    count, terms = len(x), len(powers)
    projected, polynomials = np.empty((6, count, 2)), np.empty((6, count, terms))
    u_powers, v_powers = np.zeros(8), np.zeros(8)  # that of degree d at d + 2: two derivatives begin with 0
    u_powers[2] = v_powers[2] = 1.0
    for n in range(count):
        scale = H[2, 0] * x[n, 0] + H[2, 1] * x[n, 1] + H[2, 2]
        scale = scale if abs(scale) > 1e-9 else 1e-9
        for c in range(2):
            m = (H[c, 0] * x[n, 0] + H[c, 1] * x[n, 1] + H[c, 2]) / scale
            projected[0, n, c] = m
            for k in range(2):
                projected[1 + k, n, c] = (H[c, k] - m * H[2, k]) / scale
                projected[3 + k, n, c] = -2.0 * H[2, k] * projected[1 + k, n, c] / scale
            projected[5, n, c] = -(H[2, 0] * projected[2, n, c] + H[2, 1] * projected[1, n, c]) / scale
        for d in range(3, 8):
            u_powers[d] = u_powers[d - 1] * projected[0, n, 0]
            v_powers[d] = v_powers[d - 1] * projected[0, n, 1]
        for t in range(terms):
            i, j = powers[t]
            u, v = u_powers[i + 2], v_powers[j + 2]
            u_1, v_1 = i * u_powers[i + 1], j * v_powers[j + 1]
            u_2, v_2 = i * (i - 1) * u_powers[i], j * (j - 1) * v_powers[j]
            polynomials[0, n, t] = u * v
            for k in range(2):
                polynomials[1 + k, n, t] = u_1 * v * projected[1 + k, n, 0] + u * v_1 * projected[1 + k, n, 1]
            for k in range(3):
                # along x twice, y twice, x and y
                a_u, a_v = projected[2 if k == 1 else 1, n]
                b_u, b_v = projected[1 if k == 0 else 2, n]
                bent = u_2 * v * a_u * b_u + u_1 * v_1 * (a_u * b_v + a_v * b_u) + u * v_2 * a_v * b_v
                polynomials[3 + k, n, t] = (
                    bent + u_1 * v * projected[3 + k, n, 0] + u * v_1 * projected[3 + k, n, 1]
                )
    return projected, polynomials
