"""Plane-to-image homography by the normalised direct linear transform.

s (u, v, 1)ᵀ = H (x, y, 1)ᵀ. Both point sets are centred and scaled first: the paper's "no scaling is needed"
(II.G) is false for the DLT.

References: R. Hartley, A. Zisserman, "Multiple View Geometry", 2nd ed. 2004, alg. 4.2; R. Hartley, PAMI 19
(1997) 580-593.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float, Int

from core.errors import DegenerateGeometry
from core.jit import jit


def normalising_transform(points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "3 3"]:
    """Return N with N (x, y, 1)ᵀ of mean zero and root-mean-square distance √2.

    Raises DegenerateGeometry where all points coincide.
    """
    u, v, spread = _centre_and_spread(np.ascontiguousarray(points))
    if not spread > 0:
        raise DegenerateGeometry("All grid points lie in one spot.")
    scale = math.sqrt(2.0) / spread
    return np.array([[scale, 0.0, -scale * u], [0.0, scale, -scale * v], [0.0, 0.0, 1.0]])


@jit("f8[:, ::1]", reassociates=True)
def _centre_and_spread(points: Float[np.ndarray, "n 2"]) -> tuple[float, float, float]:
    """Return the mean and the root-mean-square distance from it."""
    count = len(points)
    u = v = square = 0.0
    for i in range(count):
        u += points[i, 0]
        v += points[i, 1]
    u, v = u / count, v / count
    for i in range(count):
        square += (points[i, 0] - u) ** 2 + (points[i, 1] - v) ** 2
    return u, v, math.sqrt(square / count)


def estimate_homography(
    points_plane: Float[np.ndarray, "n 2"], points_px: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "3 3"]:
    """Estimate H from at least four point pairs, scaled so that the depths h3·(x, y, 1) are positive.

    Raises DegenerateGeometry for fewer than four points, points (nearly) on one line, or depths of both signs.
    """
    if len(points_plane) < 4:
        raise DegenerateGeometry(f"A homography needs at least 4 points, got {len(points_plane)}.")
    N_plane, N_px = normalising_transform(points_plane), normalising_transform(points_px)
    x, p = points_plane * N_plane[0, 0] + N_plane[:2, 2], points_px * N_px[0, 0] + N_px[:2, 2]
    H = normalised_homography(x, p, np.ones(len(x))) @ N_plane
    H[:2] = (H[:2] - N_px[:2, 2:] * H[2]) / N_px[0, 0]  # N_px⁻¹ from the left
    depth = points_plane @ H[2, :2] + H[2, 2]
    sign = 1.0 if depth.mean() > 0.0 else -1.0
    if not (sign * depth).min() > 0.0:
        raise DegenerateGeometry("The grid points found do not look like a plane in front of a camera.")
    return np.asarray(H * (sign / math.sqrt(float(np.vdot(H, H)))))


def find_homography(
    points_plane: Float[np.ndarray, "n 2"], points_px: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "3 3"] | None:
    """Return what `estimate_homography` does; None where the points determine none."""
    try:
        return estimate_homography(points_plane, points_px)
    except DegenerateGeometry:
        return None


def normalised_homography(
    x: Float[np.ndarray, "n 2"], p: Float[np.ndarray, "n 2"], weights: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "3 3"]:
    """Return H of p ~ H x, of norm 1, from point pairs that are normalised already, each with a weight.

    Raises DegenerateGeometry for points (nearly) on one line.
    """
    values, vectors = np.linalg.eigh(transform_products(x, p, weights))  # of the lower triangle
    if not values[1] > 1e-9 * values[-1]:
        raise DegenerateGeometry("The grid points found lie on one line, or nearly so.")
    return np.asarray(vectors[:, 0].reshape(3, 3))


@jit("f8[:, ::1], f8[:, ::1], f8[::1]")
def transform_products(
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
    for i in range(3):  # not a slice assignment: numba's takes a second to compile
        for j in range(3):
            A[3 + i, 3 + j] = A[i, j]
    return A


def map_points(
    H: Float[np.ndarray, "3 3"], points_plane: Float[np.ndarray, "n 2"] | Int[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 2"]:
    """Map plane points to the image."""
    homogeneous = points_plane @ H[:, :2].T + H[:, 2]
    return np.asarray(homogeneous[:, :2] / homogeneous[:, 2:])


def map_in_front(
    H: Float[np.ndarray, "3 3"], points_plane: Float[np.ndarray, "n 2"] | Int[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 2"]:
    """Map plane points to the image by an H whose depths are positive; NaN behind the camera."""
    homogeneous = points_plane @ H[:, :2].T + H[:, 2]
    depth = np.where(homogeneous[:, 2:] > 1e-12, homogeneous[:, 2:], np.nan)
    return np.asarray(homogeneous[:, :2] / depth)


@jit("f8[::1], f8[::1], f8[::1], f8[::1], f8[::1]")
def unit_square_homography(
    a: Float[np.ndarray, "2"],
    b: Float[np.ndarray, "2"],
    c: Float[np.ndarray, "2"],
    d: Float[np.ndarray, "2"],
    H: Float[np.ndarray, "8"],
) -> bool:
    """Write the homography of (0, 0), (1, 0), (1, 1), (0, 1) to these four corners, its last element 1, to `H`.

    False where they are no convex quadrangle of this handedness. P. S. Heckbert, "Fundamentals of texture mapping and
    image warping" (1989), section 2.2.3.
    """
    ux, uy, vx, vy = b[0] - c[0], b[1] - c[1], d[0] - c[0], d[1] - c[1]
    sx, sy = a[0] - b[0] + c[0] - d[0], a[1] - b[1] + c[1] - d[1]
    determinant = ux * vy - vx * uy
    if not abs(determinant) > 1e-9:
        return False
    g, h = (sx * vy - vx * sy) / determinant, (ux * sy - sx * uy) / determinant
    H[0], H[1], H[2] = b[0] - a[0] + g * b[0], d[0] - a[0] + h * d[0], a[0]
    H[3], H[4], H[5] = b[1] - a[1] + g * b[1], d[1] - a[1] + h * d[1], a[1]
    H[6], H[7] = g, h
    at_b = (b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0])
    at_d = (c[0] - d[0]) * (d[1] - a[1]) - (c[1] - d[1]) * (d[0] - a[0])
    at_a = (b[0] - a[0]) * (d[1] - a[1]) - (b[1] - a[1]) * (d[0] - a[0])
    return determinant < 0.0 and at_a > 0.0 and at_b > 0.0 and at_d > 0.0
