"""A circle through points in space: where the circle method starts, from positions alone.

The plane is that of the two largest singular values of the points about their mean. In it the algebraic circle
A (x² + y²) + B x + C y + D = 0 is fitted under Taubin's constraint, which makes the radius nearly unbiased: with Z the
centred squares z = x² + y² divided by 2 sqrt(mean z), the singular vector of [Z x y] of the least singular value.

References: G. Taubin, IEEE PAMI 13 (1991) 1115-1138, 10.1109/34.103273; N. Chernov, "Circular and Linear Regression",
2010, section 5.9 (by SVD).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from core.errors import DegenerateGeometry

_SPREAD = 1e-9  # of the points along their second direction: below, they are on a line
_CURVATURE = 1e-12


@dataclass(frozen=True, slots=True)
class Circle:
    """Centre and radius in mm; `normal` is of unit length, of either sense."""

    centre: Float[np.ndarray, "3"]
    normal: Float[np.ndarray, "3"]
    radius: float


@dataclass(frozen=True, slots=True)
class Circles:
    """A circle through each of several sets of points; what stands where there is `none` means nothing."""

    centres: Float[np.ndarray, "b 3"]
    normals: Float[np.ndarray, "b 3"]
    radii: Float[np.ndarray, " b"]
    none: Bool[np.ndarray, " b"]


def fit_circle(points: Float[np.ndarray, "n 3"]) -> Circle:
    """Fit a circle to three or more points.

    Raises DegenerateGeometry where the points are one point or lie on one line.
    """
    found = fit_circles(points[None])
    if found.none[0]:
        raise DegenerateGeometry(
            "The positions of a sweep lie on one point or line, where a circle has none to fit.",
            "Mount the camera or reflector away from the joint's axis; or use rotations (method screw or combined); "
            "only turning joints can be identified.",
        )
    return Circle(found.centres[0], found.normals[0], float(found.radii[0]))


def fit_circles(points: Float[np.ndarray, "b n 3"]) -> Circles:
    """Fit a circle to each of several sets of three or more points."""
    mean = points.mean(axis=1)
    _, singular, Vt = np.linalg.svd(points - mean[:, None], full_matrices=False)
    none = ~(singular[:, 1] > _SPREAD * np.maximum(singular[:, 0], 1e-300))
    plane = Vt[:, :2]
    x, y = np.moveaxis((points - mean[:, None]) @ plane.swapaxes(1, 2), 2, 0)
    square = x * x + y * y
    level = np.where(none, 1.0, square.mean(axis=1))
    size = 2.0 * np.sqrt(level)
    scaled = (square - level[:, None]) / size[:, None]
    rows = np.linalg.svd(np.stack([scaled, x, y], axis=2), full_matrices=True)[2]
    a, b, c = rows[:, -1].T
    a = a / size
    none |= np.abs(a) * np.sqrt(level) < _CURVATURE
    centre = np.stack([-b, -c], axis=1) / (2.0 * np.where(none, 1.0, a))[:, None]
    radius = np.sqrt(np.sum(centre**2, axis=1) + level)
    normals = np.cross(plane[:, 0], plane[:, 1])
    return Circles(mean + (centre[:, None] @ plane)[:, 0], normals, radius, none)
