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

from core.errors import DegenerateGeometry


def normalising_transform(points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "3 3"]:
    """Return N with N (x, y, 1)ᵀ of mean zero and root-mean-square distance √2.

    Raises DegenerateGeometry where all points coincide.
    """
    centre = points.mean(axis=0)
    spread = math.sqrt(float(np.mean(np.sum((points - centre) ** 2, axis=1))))
    if not spread > 0:
        raise DegenerateGeometry("All grid points lie in one spot.")
    scale = math.sqrt(2.0) / spread
    return np.array([[scale, 0.0, -scale * centre[0]], [0.0, scale, -scale * centre[1]], [0.0, 0.0, 1.0]])


def estimate_homography(
    points_plane: Float[np.ndarray, "n 2"], points_px: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "3 3"]:
    """Estimate H from at least four point pairs, scaled so that the depths h3·(x, y, 1) are positive.

    Raises DegenerateGeometry for fewer than four points or points (nearly) on one line.
    """
    if len(points_plane) < 4:
        raise DegenerateGeometry(f"A homography needs at least 4 points, got {len(points_plane)}.")
    N_plane, N_px = normalising_transform(points_plane), normalising_transform(points_px)
    x, y = (points_plane * N_plane[0, 0] + N_plane[:2, 2]).T
    u, v = (points_px * N_px[0, 0] + N_px[:2, 2]).T
    P = np.stack([x, y, np.ones_like(x)])  # (3, n)
    # AᵀA of the DLT, block by block: rows of A are (p, 0, -u p) and (0, p, -v p).
    S, Su, Sv, Sw = P @ P.T, (P * u) @ P.T, (P * v) @ P.T, (P * (u * u + v * v)) @ P.T
    M = np.zeros((9, 9))
    M[:3, :3] = M[3:6, 3:6] = S
    M[:3, 6:] = M[6:, :3] = -Su
    M[3:6, 6:] = M[6:, 3:6] = -Sv
    M[6:, 6:] = Sw
    values, vectors = np.linalg.eigh(M)
    if values[1] < 1e-9 * values[-1]:
        raise DegenerateGeometry("The grid points found lie on one line, or nearly so.")
    H = np.linalg.solve(N_px, vectors[:, 0].reshape(3, 3) @ N_plane)
    depth = points_plane @ H[2, :2] + H[2, 2]
    if float(np.mean(depth)) < 0:
        H = -H
        depth = -depth
    if np.any(depth <= 0):
        raise DegenerateGeometry("The grid points found do not look like a plane in front of a camera.")
    return np.asarray(H / np.linalg.norm(H))


def map_points(
    H: Float[np.ndarray, "3 3"], points_plane: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 2"]:
    """Map plane points to the image."""
    homogeneous = points_plane @ H[:, :2].T + H[:, 2]
    return np.asarray(homogeneous[:, :2] / homogeneous[:, 2:])
