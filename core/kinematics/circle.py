"""A circle through points in space: where the circle method starts, from positions alone.

The plane is that of the two largest singular values of the points about their mean. In it the algebraic circle
A (x² + y²) + B x + C y + D = 0 is fitted under Taubin's constraint, which makes the radius nearly unbiased: with Z the
centred squares z = x² + y² divided by 2 sqrt(mean z), the singular vector of [Z x y] of the least singular value.

References: G. Taubin, IEEE PAMI 13 (1991) 1115-1138, 10.1109/34.103273; N. Chernov, "Circular and Linear Regression",
2010, section 5.9 (by SVD).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from core.errors import DegenerateGeometry


@dataclass(frozen=True, slots=True)
class Circle:
    """Centre and radius in mm; `normal` is of unit length, of either sense."""

    centre: Float[np.ndarray, "3"]
    normal: Float[np.ndarray, "3"]
    radius: float


def fit_circle(points: Float[np.ndarray, "n 3"]) -> Circle:
    """Fit a circle to three or more points.

    Raises DegenerateGeometry where the points are one point or lie on one line.
    """
    mean = points.mean(axis=0)
    _, singular, Vt = np.linalg.svd(points - mean, full_matrices=False)
    if len(singular) < 2 or not singular[1] > 1e-9 * max(singular[0], 1e-300):
        raise DegenerateGeometry(
            "The positions of a sweep lie on one point or line, where a circle has none to fit.",
            "Mount the camera or reflector away from the joint's axis; or use rotations (method screw or combined).",
        )
    x, y = ((points - mean) @ Vt[:2].T).T
    square = x * x + y * y
    level = float(square.mean())
    scaled = (square - level) / (2.0 * math.sqrt(level))
    _, _, rows = np.linalg.svd(np.column_stack([scaled, x, y]), full_matrices=True)
    a, b, c = rows[-1]
    a /= 2.0 * math.sqrt(level)
    if abs(a) * math.sqrt(level) < 1e-12:
        raise DegenerateGeometry(
            "The positions of a sweep lie on one line.", "Only turning joints can be identified."
        )
    centre = np.array([-b, -c]) / (2.0 * a)
    radius = math.sqrt(float(centre @ centre) + level)
    return Circle(mean + centre @ Vt[:2], np.cross(Vt[0], Vt[1]), radius)
