"""A view's pose before a known camera, by a homography: where fits of poses begin."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from core.calibration import closed_form
from core.calibration.lens_residuals import View
from core.calibration.state import centred
from core.errors import DegenerateGeometry
from core.geometry import AnyCamera, Camera, estimate_homography, project, undistort_any, undistort_points
from core.targets import GridPoints

MAX_START_TANGENT = 3.0
"""Of the angle from the axis: points within it place a view before a wide lens."""


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
