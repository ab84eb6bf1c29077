"""Closed-form camera and pose from one planar view: the paper's variants A (null space) and B (vanishing points).

Both end in the same two equations. With a and b the images of the plane's x and y directions relative to the
principal point, a = (fx r11, fy r21, r31)·c and b = (fx r12, fy r22, r32)·c, orthonormality of r1 and r2 (the
paper's 25-27) reads

    a1 b1 X + a2 b2 Y + a3 b3 = 0,      (a1² - b1²) X + (a2² - b2²) Y + (a3² - b3²) = 0,      X = 1/fx², Y =
    1/fy²,

written with products throughout: the paper's quotients (23)-(24) divide by r12 and r22, which vanish for
axis-aligned tilt. The variants differ in how a and b are found, and whether X = Y is imposed:

- A, `nullspace`: (r31, tz) from the x-axis points as a null space (8), r32 from the y-axis points (13), then
  the first two rows from all the others (19)-(20), *with the principal point given*. As printed, (19)-(22)
  has four columns of which h = x r31 + y r32 + tz is an exact combination of the other three: rank 3 always.
  A homography holds 8 numbers, pose and fx, fy, cx, cy need 10. `tests/core/calibration/test_closed_form.py`
  shows it.
- B, `vanishing_point`: a and b are the homography's first two columns (eqs 30-35 in matrix form).

A pose follows from a, b and the translation column by scaling to unit r1, r2 and the nearest rotation; every
depth must be positive, not t_z alone.

References: R. A. Boby, S. K. Saha, "Single image based camera calibration and pose estimation of the
end-effector of a robot", ICRA 2016, 10.1109/ICRA.2016.7487395.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from core.errors import DegenerateGeometry
from core.geometry import (
    Camera,
    estimate_homography,
    hat,
    nearest_rotation,
    normalising_transform,
    transform,
    transform_points,
)
from core.targets import GridPoints

MAX_FOCAL_PX = 1e8  # beyond it 1/f² is a rounding error of whatever sign


@dataclass(frozen=True, slots=True)
class ClosedForm:
    """A start for the refinement: a distortion-free camera and the pose."""

    camera: Camera
    T_camera_target: Float[np.ndarray, "4 4"]


def vanishing_point(
    points: GridPoints, principal_point: tuple[float, float], *, single_focal: bool = True
) -> ClosedForm:
    """Variant B from the homography's columns; `single_focal` imposes fx = fy (B1, the robust default).

    Raises DegenerateGeometry where the view does not determine the focal length (near fronto-parallel, or for
    two focal lengths a tilt about an image axis).
    """
    H = estimate_homography(points.points_target[:, :2], points.points_px)
    return from_homography(H, points, principal_point, single_focal=single_focal)


def from_homography(
    H: Float[np.ndarray, "3 3"],
    points: GridPoints,
    principal_point: tuple[float, float],
    *,
    single_focal: bool,
) -> ClosedForm:
    """Variant B given the homography; see `vanishing_point`."""
    cx, cy = principal_point
    centred = np.array([[1.0, 0.0, -cx], [0.0, 1.0, -cy], [0.0, 0.0, 1.0]]) @ H
    fx, fy = _focal_lengths(centred[:, 0], centred[:, 1], single_focal)
    return _pose(centred, fx, fy, cx, cy, points)


def nullspace(points: GridPoints, principal_point: tuple[float, float]) -> ClosedForm:
    """Variant A with the principal point given (three-column L3).

    Needs grid point (0, 0) and at least one more point on each of the target's axes and two off them.
    Raises DegenerateGeometry otherwise, or where the squares of (28) come out negative.
    """
    column, row = points.column, points.row
    origin = np.flatnonzero((column == 0) & (row == 0))
    on_x, on_y = (row == 0) & (column > 0), (column == 0) & (row > 0)
    inside = (column > 0) & (row > 0)
    if len(origin) != 1 or on_x.sum() < 2 or on_y.sum() < 1 or inside.sum() < 3:
        raise DegenerateGeometry(
            "Variant A needs the target's origin, points on both of its axes and some off them."
        )
    # II.F: scale both sets, image coordinates about the principal point.
    scale = float(normalising_transform(points.points_px)[0, 0])
    centre = np.array(principal_point)
    length = float(np.max(np.abs(points.points_target[:, :2])))
    u, v = ((points.points_px - centre) * scale).T
    x, y = (points.points_target[:, :2] / length).T
    u0, v0 = float(u[origin[0]]), float(v[origin[0]])

    def interleaved(*rows: Float[np.ndarray, "two n"]) -> Float[np.ndarray, "m k"]:
        return np.stack([r.T.ravel() for r in rows], axis=1)

    # (8): [α, tz, r31, β] spans the null space of L1.
    xs, us, vs = x[on_x], u[on_x], v[on_x]
    zero = np.zeros_like(xs)
    L1 = interleaved(
        np.stack([xs, zero]),
        np.stack([u0 - us, v0 - vs]),
        np.stack([-us * xs, -vs * xs]),
        np.stack([zero, xs]),
    )
    _, tz, r31, _ = np.linalg.svd(L1)[2][3]
    # (13): [γ, r32, δ] by least squares, at the same unknown factor.
    ys, us, vs = y[on_y], u[on_y], v[on_y]
    zero = np.zeros_like(ys)
    L2 = interleaved(np.stack([ys, zero]), np.stack([-ys * us, -ys * vs]), np.stack([zero, ys]))
    b2 = -tz * interleaved(np.stack([u0 - us, v0 - vs]))[:, 0]
    r32 = float(np.linalg.lstsq(L2, b2, rcond=None)[0][1])
    # (19)-(20).
    xi, yi, ui, vi = x[inside], y[inside], u[inside], v[inside]
    h = xi * r31 + yi * r32 + tz
    L3 = np.stack([xi, yi, np.ones_like(xi)], axis=1)
    (a1, b1, t1), (a2, b2_, t2) = (np.linalg.lstsq(L3, w * h, rcond=None)[0] for w in (ui, vi))
    # Back to pixels and millimetres: columns are the images of x, y and the origin.
    centred = np.array([[a1, b1, t1], [a2, b2_, t2], [scale * r31, scale * r32, scale * tz]])
    centred = centred / [length, length, 1.0]
    fx, fy = _focal_lengths(centred[:, 0], centred[:, 1], single=False)
    return _pose(centred, fx, fy, *principal_point, points)


def nominal(H: Float[np.ndarray, "3 3"], points: GridPoints, camera: Camera) -> ClosedForm:
    """Pose for a camera assumed known, from the homography."""
    cx, cy = camera.cx_px, camera.cy_px
    centred = np.array([[1.0, 0.0, -cx], [0.0, 1.0, -cy], [0.0, 0.0, 1.0]]) @ H
    start = _pose(centred, camera.fx_px, camera.fy_px, cx, cy, points)
    return ClosedForm(camera, start.T_camera_target)


def _focal_lengths(a: Float[np.ndarray, "3"], b: Float[np.ndarray, "3"], single: bool) -> tuple[float, float]:
    """Solve the two orthonormality equations for (fx, fy), or in least squares for one f."""
    # Numbers one by one: arrays of two would cost ten times as much.
    (a1, a2, a3), (b1, b2, b3) = a.tolist(), b.tolist()
    # Depth-scale the rows so that the two equations have equal weight in any units.
    weight = 1.0 / (a1**2 + a2**2 + b1**2 + b2**2 or 1.0)
    p1, q1, c1 = weight * a1 * b1, weight * a2 * b2, -weight * a3 * b3
    p2, q2, c2 = (
        0.5 * weight * (a1**2 - b1**2),
        0.5 * weight * (a2**2 - b2**2),
        -0.5 * weight * (a3**2 - b3**2),
    )
    if single:
        s1, s2 = p1 + q1, p2 + q2
        norm = s1**2 + s2**2
        X = Y = (s1 * c1 + s2 * c2) / norm if norm > 0 else math.nan
    else:
        determinant = p1 * q2 - q1 * p2
        if abs(determinant) < 1e-14:
            raise DegenerateGeometry(
                "The tilt is about an image axis: this view does not determine both fx and fy."
            )
        X, Y = (c1 * q2 - q1 * c2) / determinant, (p1 * c2 - c1 * p2) / determinant
    if not MAX_FOCAL_PX**-2 <= min(X, Y) <= max(X, Y) < math.inf:
        raise DegenerateGeometry(
            "The squared focal length comes out negative or infinite: "
            "the view is near fronto-parallel or the principal point wrong."
        )
    return 1.0 / math.sqrt(X), 1.0 / math.sqrt(Y)


def _pose(
    centred: Float[np.ndarray, "3 3"], fx: float, fy: float, cx: float, cy: float, points: GridPoints
) -> ClosedForm:
    """Scale K⁻¹H to unit columns, take the nearest rotation and demand positive depths."""
    B = centred / np.array([[fx], [fy], [1.0]])
    scale = 2.0 / (math.hypot(*B[:, 0]) + math.hypot(*B[:, 1]))
    B *= math.copysign(scale, B[2, 2])
    t = B[:, 2].copy()
    B[:, 2] = hat(B[:, 0]) @ B[:, 1]
    T = transform(nearest_rotation(B), t)
    if np.any(transform_points(T, points.points_target)[:, 2] <= 0):
        raise DegenerateGeometry("Some grid points would lie behind the camera.")
    return ClosedForm(Camera(fx, fy, cx, cy), T)
