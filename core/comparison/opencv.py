"""OpenCV's own calibrations, as the methods the comparison names: its functions, its criteria, no second guess.

`zhang` is cv2.calibrateCamera over all views of a session, the implementation of Zhang's method that is in use;
`opencv_single_image` the same function on one view, which it accepts without a word. Both estimate fx, fy, cx, cy, k1,
k2, p1, p2 (k3 held at 0), the camera of this package, so that rows compare estimators and not models. The iteration
stops at a relative change of 1e-12 or after 500 steps; with the criteria of 30 steps that many examples show, f can be
left half its value off.

References: Z. Zhang, "A flexible new technique for camera calibration", IEEE PAMI 22 (2000) 1330-1334,
10.1109/34.888718.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np

from core.calibration import check_points
from core.comparison.results import MethodResult
from core.errors import ADVISED_TILT, Advisory, DegenerateGeometry, InvalidArgument, NotConverged
from core.geometry import Camera, project, so3_exp, transform, transform_points
from core.targets import GridPoints

_CRITERIA = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 500, 1e-12)
MIN_TILT = math.radians(10.0)
"""With no view tilted by more than this, focal length and distance are as good as inseparable."""


def zhang(views: Sequence[GridPoints]) -> MethodResult:
    """Calibrate one camera from several views by cv2.calibrateCamera.

    Raises InvalidArgument for mixed image sizes, DegenerateGeometry for fewer than two views, NotConverged where
    OpenCV fails.
    """
    if len(views) < 2:
        raise DegenerateGeometry(
            f"Zhang's method needs at least two views of different orientation, got {len(views)}.",
            "Take more images with the grid tilted differently; three or more for sound figures.",
        )
    return _calibrate("zhang", views)


def opencv_single_image(points: GridPoints) -> MethodResult:
    """Calibrate from one view by cv2.calibrateCamera, which does not check that one view suffices.

    Raises InvalidArgument, and NotConverged where OpenCV fails.
    """
    return _calibrate("opencv_single_image", [points])


def _calibrate(method: str, views: Sequence[GridPoints]) -> MethodResult:
    for points in views:
        check_points(points)
    size = (views[0].image_width_px, views[0].image_height_px)
    if any((v.image_width_px, v.image_height_px) != size for v in views):
        raise InvalidArgument("All views must have the same image size.")
    calibrate: Any = cv2.calibrateCamera  # its stub knows neither arrays nor None
    try:
        _, K, coefficients, rotations, translations = calibrate(
            [v.points_target.astype(np.float32) for v in views],
            [v.points_px.astype(np.float32) for v in views],
            size,
            None,
            None,
            flags=cv2.CALIB_FIX_K3,
            criteria=_CRITERIA,
        )
    except cv2.error as error:
        raise NotConverged(f"OpenCV's calibrateCamera failed: {error.err}.") from error
    camera = Camera(
        *(float(v) for v in K[[0, 1, 0, 1], [0, 1, 2, 2]]), *(float(c) for c in coefficients.ravel()[:5])
    )
    poses = [
        transform(so3_exp(np.ravel(r)), np.ravel(t)) for r, t in zip(rotations, translations, strict=True)
    ]
    if not (np.all(np.isfinite(camera.as_array())) and np.all(np.isfinite(poses))):
        raise NotConverged("OpenCV's calibrateCamera returned no finite answer.")
    inside = [transform_points(T, v.points_target) for T, v in zip(poses, views, strict=True)]
    if any(np.any(points[:, 2] <= 0) for points in inside):
        raise NotConverged("OpenCV's calibrateCamera puts grid points behind the camera.")
    residuals = [v.points_px - project(p, camera) for v, p in zip(views, inside, strict=True)]
    tilt = max(math.acos(min(1.0, abs(float(T[2, 2])))) for T in poses)
    return MethodResult(method, camera, tuple(poses), tuple(residuals), _warnings(tilt))


def _warnings(tilt: float) -> tuple[Advisory, ...]:
    if tilt >= MIN_TILT:
        return ()
    return (
        Advisory(
            "focal_not_observable",
            f"The grid is nowhere tilted by more than {math.degrees(tilt):.1f}°: OpenCV answers all the same, and "
            "its own standard deviations do not show how far off it is.",
            f"Take views with the grid tilted by {ADVISED_TILT}, to different sides.",
        ),
    )
