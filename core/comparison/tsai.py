"""Tsai's two stages on one coplanar grid.

With (X, Y) the pixels about the principal point, X divided by the aspect fx/fy, radial distortion and focal length
move a point only along the line from the principal point (the radial alignment constraint): (X, Y) is parallel to
(x, y) = (r11 xw + r12 yw + tx, r21 xw + r22 yw + ty), so

    Y (r11 xw + r12 yw + tx) - X (r21 xw + r22 yw + ty) = 0.

Stage 1 solves these for the six unknowns up to a factor. The factor follows from the rotation's upper left 2 x 2 block
C: its singular values are 1 and |r33|, so the larger one found is the factor, which is Tsai's quadratic for ty² in
another form, and the ratio of the two is the cosine of the tilt. Solving for six up to a factor, in place of five
divided by ty, spares the case ty = 0 that he avoids by moving the origin. The rest of R is fixed up to the sign of the
tilt.

Stage 2 takes f and tz from the linear equations X (w + tz) = f x, Y (w + tz) = f y, with w = r31 xw + r32 yw, at the
sign of the tilt that makes both positive; then f, tz and one radial coefficient minimise the residuals in the image,
the rest staying as stage 1 left it.

What is not as printed: the coefficient is written on the undistorted radius, x' = x (1 + k1 r²), as everywhere in
this package, not on the distorted one; to first order k1 = -κ1 f². Both coordinates are fitted, not one.

Limits: the method does not estimate the principal point and the aspect (they are given: by default the image's middle,
and 1), nor any second radial or tangential term. It needs a tilted view: where the optical axis is perpendicular to the
grid, tilt, f and tz cannot be separated. Tsai asks for 30° of tilt or more.

References: R. Y. Tsai, "A versatile camera calibration technique for high-accuracy 3D machine vision metrology using
off-the-shelf TV cameras and lenses", IEEE J. Robotics and Automation 3 (1987) 323-344, section on coplanar points,
10.1109/JRA.1987.1087109; J. Batista, J. Dias, H. Araújo, A. T. de Almeida, "Monoplanar camera calibration: iterative
multi-step approach", BMVC 1993 (on the 30°).
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from core.calibration import PLAUSIBLE_START as FOCAL_RANGE
from core.calibration import SMALLEST_NOISE_PX, centred, check_points, image_centre
from core.comparison.results import MethodResult
from core.errors import ADVISED_TILT, Advisory, DegenerateGeometry, InvalidArgument, NotConverged
from core.geometry import Camera, project, project_with_jacobian, transform, transform_points
from core.numerics import fit
from core.targets import GridPoints

MIN_TILT = math.radians(30.0)
"""The tilt from which on Tsai's method is meant to be used; below it the result carries a warning."""
MAX_UNCERTAINTY = 0.5
"""Largest relative standard uncertainty of the tilt, and so of f, that is still an answer."""


def tsai(
    points: GridPoints, *, principal_point: tuple[float, float] | None = None, aspect: float = 1.0
) -> MethodResult:
    """Calibrate from one view of a coplanar grid; `principal_point` in px, `aspect` is fx/fy.

    Raises InvalidArgument, DegenerateGeometry for a view that does not determine the answer (the optical axis
    perpendicular to the grid above all), NotConverged.
    """
    check_points(points)
    if not (math.isfinite(aspect) and aspect > 0):
        raise InvalidArgument(f"The aspect fx/fy must be a positive number, got {aspect!r}.")
    if len(points) < 8:
        raise DegenerateGeometry(f"Tsai's method needs at least 8 grid points, {len(points)} were found.")
    target, centroid = centred(points)
    if np.any(np.abs(target[:, 2]) > 1e-9 * np.max(np.abs(target))):
        raise DegenerateGeometry(
            "Tsai's coplanar case needs a flat grid.", "Use the ideal grid in place of measured points."
        )
    centre = image_centre(points) if principal_point is None else principal_point
    radial = (points.points_px - centre) / [aspect, 1.0]
    C, translation_xy = _stage_one(target, radial)
    rotation, focal, depth = _stage_two(target, radial, C, translation_xy)

    def evaluate(
        state: Float[np.ndarray, "3"],
    ) -> tuple[Float[np.ndarray, "2 n"], Float[np.ndarray, "3 2 n"]]:
        f, tz, k1 = state.tolist()
        inside = target @ rotation.T + np.array([*translation_xy, tz])
        inside[:, 2] = np.maximum(inside[:, 2], 1e-3 * tz)  # a step too far costs much and is taken back
        pixels, by_camera, by_point = project_with_jacobian(inside, Camera(f * aspect, f, *centre, k1))
        jacobian = np.stack([aspect * by_camera[0] + by_camera[1], by_point[2], by_camera[4]])
        return points.points_px.T - pixels, jacobian

    def retract(state: Float[np.ndarray, "3"], step: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        growth = np.exp(np.clip(step[:2] / state[:2], -0.7, 0.7))
        return np.append(state[:2] * growth, state[2] + step[2])

    result = fit(
        evaluate,
        retract,
        np.array([focal, depth, 0.0]),
        points.standard_uncertainty_px,
        smallest_scale=SMALLEST_NOISE_PX,
    )
    tilt = math.acos(min(1.0, abs(float(rotation[2, 2]))))
    focal, depth, k1 = result.state.tolist()
    plausible = FOCAL_RANGE[0] < focal / points.image_width_px < FOCAL_RANGE[1]
    if tilt < MIN_TILT and not (result.converged and plausible):
        raise _perpendicular()  # a tilt that is mostly error leaves a flat valley from f to f far away
    if not result.converged:
        raise NotConverged("Tsai's second stage did not converge.")
    camera = Camera(focal * aspect, focal, *centre, k1)
    T = transform(rotation, np.array([*translation_xy, depth]) - rotation @ centroid)
    inside = transform_points(T, points.points_target)
    if np.any(inside[:, 2] <= 0):
        raise NotConverged("Tsai's method puts grid points behind the camera.")
    residuals = points.points_px - project(inside, camera)
    return MethodResult("tsai", camera, (T,), (residuals,), _warnings(tilt))


def _stage_one(
    target: Float[np.ndarray, "n 3"], radial: Float[np.ndarray, "n 2"]
) -> tuple[Float[np.ndarray, "2 2"], Float[np.ndarray, "2"]]:
    """Return the upper left block of R and (tx, ty) from the radial alignment constraint.

    Raises DegenerateGeometry where the equations do not determine them, or not the tilt.
    """
    X, Y = (radial / math.sqrt(float(np.mean(radial**2)))).T
    length = math.sqrt(float(np.mean(target[:, :2] ** 2)))
    if not length > 0:
        raise DegenerateGeometry("All grid points lie in one spot.")
    x, y = (target[:, :2] / length).T
    A = np.stack([Y * x, Y * y, Y, -X * x, -X * y, -X], axis=1)
    _, singular, Vt = np.linalg.svd(A, full_matrices=False)
    if singular[4] < 1e-9 * singular[0]:
        raise DegenerateGeometry("The grid points found lie on one line, or nearly so.")
    unknowns = Vt[5]
    ahead_x = x * unknowns[0] + y * unknowns[1] + unknowns[2]
    ahead_y = x * unknowns[3] + y * unknowns[4] + unknowns[5]
    if float(np.sum(ahead_x * X + ahead_y * Y)) < 0:  # the image lies on the side the points lie on
        unknowns = -unknowns
    C = unknowns[[0, 1, 3, 4]].reshape(2, 2)
    U, (largest, smallest), Wt = np.linalg.svd(C)
    cosine = float(smallest / largest)
    # First-order uncertainty of the ratio of singular values, dσ = uᵀ dC w, from the spread of the equations.
    gradient = (np.outer(U[:, 1], Wt[1]) - cosine * np.outer(U[:, 0], Wt[0])).ravel() / largest
    along = Vt[:5, [0, 1, 3, 4]] @ gradient / singular[:5]
    spread = float(singular[5]) / math.sqrt(max(len(A) - 5, 1))
    sine_squared = 1.0 - cosine**2
    uncertainty = spread * math.sqrt(float(along @ along)) * cosine
    if sine_squared < 1e-9 or uncertainty > MAX_UNCERTAINTY * sine_squared:
        raise _perpendicular()
    scaled = C / largest
    return scaled, np.array([unknowns[2], unknowns[5]]) / largest * length


def _stage_two(
    target: Float[np.ndarray, "n 3"],
    radial: Float[np.ndarray, "n 2"],
    C: Float[np.ndarray, "2 2"],
    translation_xy: Float[np.ndarray, "2"],
) -> tuple[Float[np.ndarray, "3 3"], float, float]:
    """Return R, f (px) and tz (mm, at the points' centroid), without distortion.

    Raises DegenerateGeometry where neither sign of the tilt has f and tz positive.
    """
    U, (_, cosine), Wt = np.linalg.svd(C)
    sine = math.sqrt(max(0.0, 1.0 - float(cosine) ** 2))
    handed = float(np.linalg.det(U) * np.linalg.det(Wt))
    x, y = (target[:, :2] @ C.T + translation_xy).T
    for sign in (1.0, -1.0):
        # R = diag(U, 1) [[1, 0, 0], [0, c, -h s], [0, s, h c]] diag(Wᵀ, 1) is a rotation with the block C, h = ±1.
        inner = np.array(
            [[1.0, 0.0, 0.0], [0.0, cosine, -handed * sign * sine], [0.0, sign * sine, handed * cosine]]
        )
        left, right = np.eye(3), np.eye(3)
        left[:2, :2], right[:2, :2] = U, Wt
        rotation = left @ inner @ right
        w = target @ rotation[2]
        A = np.concatenate([np.stack([x, -radial[:, 0]], axis=1), np.stack([y, -radial[:, 1]], axis=1)])
        b = np.concatenate([radial[:, 0] * w, radial[:, 1] * w])
        focal, depth = (float(value) for value in np.linalg.lstsq(A, b, rcond=None)[0])
        if focal > 0 and depth > 0:
            return rotation, focal, depth
    raise DegenerateGeometry("Tsai's method finds no positive focal length for this view.")


def _perpendicular() -> DegenerateGeometry:
    return DegenerateGeometry(
        "The optical axis is perpendicular to the grid, or too nearly so for Tsai's method: tilt, focal length and "
        "distance cannot be separated.",
        f"Tilt the grid by {ADVISED_TILT}, as the method asks, or use another.",
    )


def _warnings(tilt: float) -> tuple[Advisory, ...]:
    if tilt >= MIN_TILT:
        return ()
    return (
        Advisory(
            "tilt_below_method_limit",
            f"The grid is tilted by {math.degrees(tilt):.1f}° only; Tsai's method asks for 30° or more.",
            f"Tilt the grid by {ADVISED_TILT}.",
        ),
    )
