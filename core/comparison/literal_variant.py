"""The paper's variant B as printed: vanishing points (30-35), quotients (23-24), squares (28), and eight solutions.

With the principal point given, the vanishing points of x and y give α, β, γ and δ from r31 and r32; these and tz follow
from (8) and (13) up to a factor c, and (28) gives r12², r22² and c². Their signs make eight solutions; those with fx,
fy and tz positive remain, which is one.

The products' form with two focal lengths (`core.calibration.vanishing_point`) solves the same (25)-(27): where both
have an answer it is the same, and noise makes a square negative in both at once. The route taken differs from them in
imposing one focal length. The literal route alone is refused

- where the tilt is about an axis parallel to an image axis: r12 or r22 is zero and (23) or (24) divides by it;
- where an axis of the grid is parallel to the image: r31 or r32 is zero and its vanishing point is at infinity.

Nothing is refined here; the comparison's rows of the paper's variants are refined (`boby_saha`).

References: R. A. Boby, S. K. Saha, ICRA 2016, 10.1109/ICRA.2016.7487395, equations 23-35.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from core.errors import DegenerateGeometry
from core.geometry import Camera, estimate_homography, transform
from core.targets import GridPoints

MIN_COSINE = 1e-9
"""Of r12, r22, r31 and r32 in their own scale: below it a quotient or a vanishing point is infinite."""


@dataclass(frozen=True, slots=True)
class LiteralSolution:
    """One of the eight: the signs of r12, r22 and c, and what they give.

    `R` is a rotation only to rounding, and only where the view is exact. `remains` is whether fx, fy and tz are
    positive.
    """

    signs: tuple[int, ...]
    fx_px: float
    fy_px: float
    R: Float[np.ndarray, "3 3"]
    t_mm: Float[np.ndarray, "3"]

    @property
    def remains(self) -> bool:
        return self.fx_px > 0.0 and self.fy_px > 0.0 and float(self.t_mm[2]) > 0.0


def eight_solutions(points: GridPoints, principal_point: tuple[float, float]) -> tuple[LiteralSolution, ...]:
    """Return the eight solutions of (28) by their signs.

    Raises DegenerateGeometry where a vanishing point is at infinity, a quotient divides by zero, or a square of (28) is
    negative.
    """
    cx, cy = principal_point
    H = estimate_homography(points.points_target[:, :2], points.points_px)
    along_x, along_y, origin = (H / np.linalg.norm(H[:, 2])).T
    scale = points.target.pitch_mm
    if min(abs(along_x[2]), abs(along_y[2])) * scale < MIN_COSINE * abs(origin[2]):
        raise DegenerateGeometry(
            "An axis of the grid is parallel to the image: its vanishing point is infinite (30-31)."
        )
    # H is c' times the images of x, y and the origin: r31', r32' and tz' as (8) and (13) give them.
    r31, r32, tz = float(along_x[2]), float(along_y[2]), float(origin[2])
    (ux, vx), (uy, vy) = along_x[:2] / r31, along_y[:2] / r32
    fx_r11, fy_r21 = r31 * (ux - cx), r31 * (vx - cy)  # (32), (33)
    fx_r12, fy_r22 = r32 * (uy - cx), r32 * (vy - cy)  # (34), (35)
    size = max(abs(fx_r11), abs(fy_r21), abs(fx_r12), abs(fy_r22))
    if min(abs(fx_r12), abs(fy_r22)) < MIN_COSINE * size:
        raise DegenerateGeometry("The tilt is about an image axis: (23) or (24) divides by zero.")
    c1, c2 = fx_r11 / fx_r12, fy_r21 / fy_r22
    A = np.array([[c1**2, c2**2, r31**2], [c1, c2, r31 * r32], [1.0, 1.0, r32**2]])
    unit = np.diag([1.0, 1.0, 1.0 / max(r31**2, r32**2)])
    try:
        squares = unit @ np.linalg.solve(A @ unit, np.array([1.0, 0.0, 1.0]))
    except np.linalg.LinAlgError:
        raise DegenerateGeometry("(28) has no solution: the view is parallel to the image.") from None
    if not np.all(squares > 0.0):
        raise DegenerateGeometry(
            "A square of (28) is negative: the principal point is wrong, or the view nearly parallel to the image."
        )
    found = []
    for signs in itertools.product((1, -1), repeat=3):
        r12, r22, c = (sign * float(np.sqrt(square)) for sign, square in zip(signs, squares, strict=True))
        first = np.array([c1 * r12, c2 * r22, c * r31])
        second = np.array([r12, r22, c * r32])
        R = np.stack([first, second, np.cross(first, second)], axis=1)  # (29): the last column
        fx, fy, depth = c * fx_r12 / r12, c * fy_r22 / r22, c * tz
        at = origin[:2] / origin[2]
        t = np.array([(at[0] - cx) * depth / fx, (at[1] - cy) * depth / fy, depth])  # (3), (4)
        found.append(LiteralSolution(signs, fx, fy, R, t))
    return tuple(found)


def literal_variant(
    points: GridPoints, principal_point: tuple[float, float]
) -> tuple[Camera, Float[np.ndarray, "4 4"]]:
    """Return the one solution of the eight that remains, as a camera without distortion and T_camera_target.

    Raises DegenerateGeometry, as `eight_solutions` does.
    """
    (one,) = (solution for solution in eight_solutions(points, principal_point) if solution.remains)
    return Camera(one.fx_px, one.fy_px, *principal_point), transform(one.R, one.t_mm)
