"""The state of a view and what fits share: where they start, residuals with derivatives, and curved steps.

State: the camera's nine parameters (k3 held at the start's value) and T_camera_target with a left
perturbation, R ← exp(w) R, t ← t + d.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from core.calibration import closed_form
from core.calibration.closed_form import ClosedForm
from core.calibration.residuals import View, residuals_with_jacobian
from core.errors import DegenerateGeometry
from core.geometry import (
    AnyCamera,
    Camera,
    estimate_homography,
    project,
    so3_exp,
    undistort_any,
    undistort_points,
)
from core.numerics import Evaluate
from core.targets import GridPoints

SMALLEST_NOISE_PX = (
    1e-4  # no camera locates corners better; exact points still need the priors to separate f from depth
)
MAX_START_TANGENT = 3.0
"""Of the angle from the axis: points within it place a view before a wide lens."""

# Step coordinates of the two estimators within the 15 of a full covariance (`result`).
FREE = np.array([0, 1, 2, 3, 4, 5, 6, 7, 9, 10, 11, 12, 13, 14])
POSE = np.arange(9, 15)


def centred(points: GridPoints) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "3"]]:
    """Return the grid points about their centroid, and the centroid (target frame, mm)."""
    target = points.points_target
    centroid = target.mean(axis=0)
    return target - centroid, centroid


def view_residuals(points: GridPoints, *, free: bool) -> Evaluate[View]:
    """Return the residual function over `FREE` step coordinates, or over those of the `POSE` alone."""
    return residuals_over(points, len(FREE) - len(POSE) if free else 0)


def residuals_over(points: GridPoints, cameras: int) -> Evaluate[View]:
    """Return the residual function over the first `cameras` parameters of a camera of any lens model, and the pose."""
    target, observed = np.ascontiguousarray(centred(points)[0].T), np.ascontiguousarray(points.points_px.T)

    def evaluate(view: View) -> tuple[Float[np.ndarray, "2 n"], Float[np.ndarray, "p 2 n"]]:
        return residuals_with_jacobian(target, observed, view, cameras)

    return evaluate


def retract_pose(view: View, step: Float[np.ndarray, "6"]) -> View:
    return View(view.parameters, so3_exp(step[:3]) @ view.rotation, view.translation_mm + step[3:])


def retract(view: View, step: Float[np.ndarray, "14"]) -> View:
    """Move along a curve with tangent `step` that follows the valley of one-image calibration.

    Under weak perspective the image hardly changes while f, depth and tilt grow in proportion, k1 with f² and
    k2 with f⁴. A straight step leaves that curved valley at second order and the solver creeps; this curve
    stays in it. Its tangent is the plain step's, so Jacobian and covariance are untouched.
    """
    # Numbers one by one: arrays of three would cost ten times as much.
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = view.parameters.tolist()
    dfx, dfy, dcx, dcy, dk1, dk2, dp1, dp2, wx, wy, wz, dx, dy, dz = step.tolist()
    X, Y, Z = view.translation_mm.tolist()
    ratio = bounded_logarithm(0.5 * (dfx / fx + dfy / fy))
    growth = math.expm1(ratio) / ratio if abs(ratio) > 1e-8 else 1.0
    new_fx, new_fy, new_Z = (
        value * math.exp(bounded_logarithm(d / value)) for value, d in ((fx, dfx), (fy, dfy), (Z, dz))
    )
    k1 += dk1 + k1 * (math.expm1(2.0 * ratio) - 2.0 * ratio)
    k2 += dk2 + k2 * (math.expm1(4.0 * ratio) - 4.0 * ratio)
    # The centroid's image f·x/z + c keeps its first-order motion, however far f and depth go.
    x, y = X / Z, Y / Z
    image_x = fx * x + dfx * x + fx * (dx - x * dz) / Z
    image_y = fy * y + dfy * y + fy * (dy - y * dz) / Z
    parameters = np.array([new_fx, new_fy, cx + dcx, cy + dcy, k1, k2, p1 + dp1, p2 + dp2, k3])
    translation = np.array([image_x / new_fx * new_Z, image_y / new_fy * new_Z, new_Z])
    rotation = so3_exp(np.array([wx * growth, wy * growth, wz * growth])) @ view.rotation
    return View(parameters, rotation, translation)


def bounded_logarithm(logarithm: float) -> float:
    """A change of a length by a factor of two at most in one step."""
    return min(max(logarithm, -0.7), 0.7)


def image_centre(points: GridPoints) -> tuple[float, float]:
    """The image's middle in pixel-centre coordinates."""
    return 0.5 * (points.image_width_px - 1), 0.5 * (points.image_height_px - 1)


def view_of(start: ClosedForm, points: GridPoints) -> View:
    rotation = start.T_camera_target[:3, :3]
    centroid = rotation @ centred(points)[1] + start.T_camera_target[:3, 3]
    return View(start.camera.as_array(), rotation, centroid)


def place_by_homography(
    H: Float[np.ndarray, "3 3"], points: GridPoints, camera: AnyCamera, centroid: Float[np.ndarray, "3"]
) -> View:
    """Place a view before a camera by its homography, without distortion; `centroid` is that of its points."""
    pinhole = Camera(camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px)
    T = closed_form.nominal(H, points, pinhole).T_camera_target
    return View(camera.as_array(), T[:3, :3], T[:3, :3] @ centroid + T[:3, 3])


def pose_from_undistorted_points(camera: AnyCamera, points: GridPoints) -> View:
    """Place a view before a known camera by the homography of its undistorted points.

    Raises DegenerateGeometry where the camera's distortion has no inverse at the points.
    """
    if not isinstance(camera, Camera):
        return _pose_before_wide_lens(camera, points)
    normalised = undistort_points(points.points_px, camera)
    again = project(np.column_stack([normalised, np.ones(len(normalised))]), camera)
    if float(np.mean(np.abs(again - points.points_px) > 0.5)) > 0.1:
        raise DegenerateGeometry(
            "The distortion folds back within the image: these pixels have no direction.",
            "Check the session's intrinsics: k1, k2, p1, p2, k3 in OpenCV's order, for this image size.",
        )
    H = camera.matrix @ estimate_homography(points.points_target[:, :2], normalised)
    return place_by_homography(H, points, camera, centred(points)[1])


def _pose_before_wide_lens(camera: AnyCamera, points: GridPoints) -> View:
    """Place a view by the points within `MAX_START_TANGENT` of the axis: further out, directions hardly move a
    homography's point and noise moves it far.
    """
    normalised = undistort_any(points.points_px, camera)
    near = np.isfinite(normalised).all(axis=1)
    near[near] = np.hypot(*normalised[near].T) < MAX_START_TANGENT
    if int(near.sum()) < 6:
        raise DegenerateGeometry("The lens model gives too few of the view's points a direction.")
    H = camera.matrix @ estimate_homography(points.points_target[near, :2], normalised[near])
    return place_by_homography(H, points, camera, centred(points)[1])
