"""The covariance of an image's blur by the target's edges and corners, and the motion that would explain it.

The edges of a chessboard have but two directions m₁, m₂, which leave the third element of the covariance Σ (px²) open;
the corners determine it. Where the edges cross the grey value is, of the contrast's half above the middle,

    E[sgn(m₁ᵀ z) sgn(m₂ᵀ z)] = (2/π) arcsin(m₁ᵀ Σ m₂ / √(m₁ᵀ Σ m₁ · m₂ᵀ Σ m₂)),   z ~ N(0, Σ)

(Sheppard's formula). Around a dot there are edges of all directions. A uniform motion of length L adds L²/12 along its
direction, so that L² = 12 (λ₁ - λ₂) with Σ's eigenvalues λ.

References: W. F. Sheppard, "On the application of the theory of error to cases of normal distribution and normal
correlation", Phil. Trans. R. Soc. A 192 (1899), 10.1098/rsta.1899.0003.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float, Int, Shaped

from core.targets.image_quality.edge_profiles import Edges, free_of_marker, normals, thinned
from core.targets.specification import GridPoints
from core.targets.subpixel import levels_between

_GAUSSIAN_RISE = 2.563  # 10-90 % of a Gaussian's rise, standard deviations


def blur_covariance(
    image: Shaped[np.ndarray, "h w"],
    points: GridPoints,
    edges: Edges,
    rises: Float[np.ndarray, " families"],
    cells: Int[np.ndarray, "n 3"] | None,
) -> Float[np.ndarray, "2 2"] | None:
    """Return the blur's covariance, px²; None where the edges do not determine it."""
    rows, values = [], []
    for number in range(edges.families):
        n = edges.across[edges.family == number]
        if len(n) and math.isfinite(rises[number]):
            rows.append(_quadratic(n, n))
            values.append((rises[number] / _GAUSSIAN_RISE) ** 2)
    if cells is not None and len(rows) == 2:
        crossing = _crossing_correlation(image, points, cells)
        if crossing is None:
            return None
        m1, m2, correlation = crossing
        rows.append(_quadratic(m1, m2))
        values.append(correlation * math.sqrt(values[0] * values[1]))
    if len(rows) < 3:
        return None
    (uu, uv, vv), _, rank, _ = np.linalg.lstsq(np.array(rows), np.array(values), rcond=1e-3)
    return np.array([[uu, uv], [uv, vv]]) if rank == 3 else None


def _quadratic(m: Float[np.ndarray, "n 2"], n: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "3"]:
    """Return the mean of mᵀ Σ n as a row over Σ's elements uu, uv, vv."""
    return np.array(
        [
            np.mean(m[:, 0] * n[:, 0]),
            np.mean(m[:, 0] * n[:, 1] + m[:, 1] * n[:, 0]),
            np.mean(m[:, 1] * n[:, 1]),
        ]
    )


def _crossing_correlation(
    image: Shaped[np.ndarray, "h w"], points: GridPoints, cells: Int[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "m 2"], Float[np.ndarray, "m 2"], float] | None:
    """Return the normals of the two edges at corners, and the blur's correlation between them."""
    few = cells[thinned(np.arange(len(cells)))]
    start, along, down = (points.points_px[few[:, k]] for k in range(3))
    a, b = along - start, down - start
    m1, m2 = normals(a), normals(b)
    m1 *= np.sign((m1 * b).sum(axis=1, keepdims=True))
    m2 *= np.sign((m2 * a).sum(axis=1, keepdims=True))
    far = 0.8 * free_of_marker(points)
    places = np.stack(
        [start] + [start + far * (i * a + j * b) for i, j in ((1, 1), (-1, -1), (1, -1), (-1, 1))]
    )
    grey = levels_between(image, *np.ascontiguousarray(places.transpose(2, 0, 1)))
    same, other = 0.5 * (grey[1] + grey[2]), 0.5 * (grey[3] + grey[4])
    swing = 0.5 * (same - other)
    clear = np.abs(swing) > 0.25 * np.median(np.abs(swing))
    if not clear.any():
        return None
    value = float(np.median((grey[0] - 0.5 * (same + other))[clear] / swing[clear]))
    return m1, m2, math.sin(0.5 * math.pi * min(max(value, -1.0), 1.0))


def motion_of(blur: Float[np.ndarray, "2 2"] | None) -> tuple[float | None, float | None]:
    """Return length (px) and direction (rad) of the motion that would explain a blur longer one way."""
    if blur is None:
        return None, None
    variances, directions = np.linalg.eigh(blur)
    length = math.sqrt(12.0 * max(0.0, float(variances[1] - max(variances[0], 0.0))))
    u, v = directions[:, 1]
    return length, math.atan2(v, u) % math.pi
