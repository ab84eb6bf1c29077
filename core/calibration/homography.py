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
    offset = points - centre
    spread = math.sqrt(float(np.vdot(offset, offset)) / len(points))
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
    # Rows p, u p and v p with p = (x, y, 1), normalised: their products are all that AᵀA of the DLT is made of, its
    # rows being (p, 0, -u p) and (0, p, -v p).
    P = np.ones((3, 3, len(points_px)))
    P[0, :2] = points_plane.T * N_plane[0, 0] + N_plane[:2, 2:]
    uv = points_px.T * N_px[0, 0] + N_px[:2, 2:]
    np.multiply(P[0], uv[0], out=P[1])
    np.multiply(P[0], uv[1], out=P[2])
    rows = P.reshape(9, -1)
    G = rows @ rows.T
    M = np.zeros((9, 9))
    M[:3, :3] = M[3:6, 3:6] = G[:3, :3]
    M[6:, :3] = -G[3:6, :3]
    M[6:, 3:6] = -G[6:, :3]
    M[6:, 6:] = G[3:6, 3:6] + G[6:, 6:]
    values, vectors = np.linalg.eigh(M)  # of the lower triangle
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
