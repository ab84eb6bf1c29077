"""Plane-to-image homography by the normalised direct linear transform.

s (u, v, 1)ᵀ = H (x, y, 1)ᵀ. Both point sets are centred and scaled first: the paper's "no scaling is needed"
(II.G) is false for the DLT.

References: R. Hartley, A. Zisserman, "Multiple View Geometry", 2nd ed. 2004, alg. 4.2; R. Hartley, PAMI 19
(1997) 580-593.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from core.compiled import compiled
from core.errors import DegenerateGeometry


def normalising_transform(points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "3 3"]:
    """Return N with N (x, y, 1)ᵀ of mean zero and root-mean-square distance √2.

    Raises DegenerateGeometry where all points coincide.
    """
    centre = points.mean(axis=0)
    offset = points - centre
    spread = math.sqrt(float(np.vdot(offset, offset)) / len(points))
    if not spread > 0:
        raise DegenerateGeometry("All grid points lie in one spot.")
    scale, (u, v) = math.sqrt(2.0) / spread, centre.tolist()
    return np.array([[scale, 0.0, -scale * u], [0.0, scale, -scale * v], [0.0, 0.0, 1.0]])


def estimate_homography(
    points_plane: Float[np.ndarray, "n 2"], points_px: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "3 3"]:
    """Estimate H from at least four point pairs, scaled so that the depths h3·(x, y, 1) are positive.

    Raises DegenerateGeometry for fewer than four points or points (nearly) on one line.
    """
    if len(points_plane) < 4:
        raise DegenerateGeometry(f"A homography needs at least 4 points, got {len(points_plane)}.")
    N_plane, N_px = normalising_transform(points_plane), normalising_transform(points_px)
    M = transform_products(np.ascontiguousarray(points_plane), np.ascontiguousarray(points_px), N_plane, N_px)
    values, vectors = np.linalg.eigh(M)  # of the lower triangle
    if values[1] < 1e-9 * values[-1]:
        raise DegenerateGeometry("The grid points found lie on one line, or nearly so.")
    H = vectors[:, 0].reshape(3, 3) @ N_plane
    H[:2] = (H[:2] - N_px[:2, 2:] * H[2]) / N_px[0, 0]  # N_px⁻¹ from the left
    depth = points_plane @ H[2, :2] + H[2, 2]
    sign = 1.0 if depth.mean() > 0.0 else -1.0
    if not (sign * depth).min() > 0.0:
        raise DegenerateGeometry("The grid points found do not look like a plane in front of a camera.")
    return np.asarray(H * (sign / math.sqrt(float(np.vdot(H, H)))))


@compiled
def transform_products(
    points_plane: Float[np.ndarray, "n 2"],
    points_px: Float[np.ndarray, "n 2"],
    N_plane: Float[np.ndarray, "3 3"],
    N_px: Float[np.ndarray, "3 3"],
) -> Float[np.ndarray, "9 9"]:
    """Return AᵀA (its lower triangle) of the transform's rows (p, 0, -u p) and (0, p, -v p), p = (x, y, 1); both point
    sets normalised."""
    M, p = np.zeros((9, 9)), np.ones(3)
    for n in range(len(points_plane)):
        for axis in range(2):
            p[axis] = N_plane[0, 0] * points_plane[n, axis] + N_plane[axis, 2]
        u, v = N_px[0, 0] * points_px[n, 0] + N_px[0, 2], N_px[0, 0] * points_px[n, 1] + N_px[1, 2]
        for i in range(3):
            for j in range(3):
                product = p[i] * p[j]
                M[i, j] += product
                M[6 + i, j] -= u * product
                M[6 + i, 3 + j] -= v * product
                M[6 + i, 6 + j] += (u * u + v * v) * product
    M[3:6, 3:6] = M[:3, :3]
    return M


def map_points(
    H: Float[np.ndarray, "3 3"], points_plane: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 2"]:
    """Map plane points to the image."""
    homogeneous = points_plane @ H[:, :2].T + H[:, 2]
    return np.asarray(homogeneous[:, :2] / homogeneous[:, 2:])
