"""Five points on two orthogonal one-dimensional objects: Miyagawa, Arai and Koike.

The objects are the grid's first row and first column: their common point, and two more points on each. Three points of
a line at known distances map it to the image; both lines together, with the common point's depth equal, give the
plane's homography up to the model's eight numbers. With square pixels, no skew and the principal point at the image's
middle, one focal length follows from the two conditions of orthogonality and equal length, and then the pose; f and
pose are refined on the five points' residuals.

Written after the description in Boby and Saha (II), who compare with the method in words only; the refinement turns
the rotation about itself in place of the published roll, pitch and yaw, which are singular at a pitch of 90°.

Limits and how it fails: no distortion is modelled, which stays in the residuals of the whole grid; five points average
no noise. Where the grid is parallel to the image, and where the tilt is so small that noise exceeds the lines'
foreshortening, there is no focal length (`degenerate_geometry`); where one object is parallel to the image, the angle
between them says nothing, and f rests on the other's foreshortening alone (`one_line_parallel`).

References: I. Miyagawa, H. Arai, H. Koike, "Simple camera calibration from a single image using five points on two
orthogonal 1-D objects", IEEE Trans. Image Processing 19 (2010) 1528-1538, 10.1109/TIP.2010.2042118.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float, Int

from core.calibration import check_points, from_homography, image_centre
from core.comparison.results import MethodResult
from core.comparison.single_focal_fit import refine_single_focal, require_plausible
from core.errors import Advisory, DegenerateGeometry
from core.geometry import normalising_transform, project, transform_points
from core.targets import GridPoints

MIN_LINE_TILT = math.radians(3.0)
"""Of either object against the image: below it the angle between the objects hardly determines f."""


def five_points(points: GridPoints) -> MethodResult:
    """Calibrate from five points of one view; residuals are of all of its points.

    Raises InvalidArgument, DegenerateGeometry where the five points are not all seen or give no focal length,
    NotConverged.
    """
    check_points(points)
    some = _chosen(points)
    H = _homography(points.points_target[some, :2], points.points_px[some])
    start = from_homography(H, points, image_centre(points), single_focal=True)
    camera, T = refine_single_focal(points, some, start.camera, start.T_camera_target)
    require_plausible(camera.fx_px, points)
    residuals = points.points_px - project(transform_points(T, points.points_target), camera)
    slopes = np.abs(np.arcsin(np.clip(T[2, :2], -1.0, 1.0)))
    return MethodResult("five_points", camera, (T,), (residuals,), _warnings(float(slopes.min())))


def _chosen(points: GridPoints) -> Int[np.ndarray, "5"]:
    """Return the origin, then the middle and the last point of the first row and of the first column."""
    column, row = points.column, points.row
    origin = np.flatnonzero((column == 0) & (row == 0))
    chosen = origin.tolist()
    for along, across in ((column, row), (row, column)):
        on = np.flatnonzero((across == 0) & (along > 0))
        if len(origin) != 1 or len(on) < 2:
            raise DegenerateGeometry(
                "The five-point method needs the grid's origin and two more points of its first row and column.",
                "Take images that show the grid's first row and column, or use another method.",
            )
        on = on[np.argsort(along[on])]
        middle = int(np.argmin(np.abs(along[on[:-1]] - 0.5 * along[on[-1]])))
        chosen += [int(on[middle]), int(on[-1])]
    return np.array(chosen, dtype=np.intp)


def _homography(
    plane: Float[np.ndarray, "5 2"], pixels: Float[np.ndarray, "5 2"]
) -> Float[np.ndarray, "3 3"]:
    """Return H from the five points, which determine it: two collinear triples with one common point."""
    N = normalising_transform(pixels)
    u = pixels * N[0, 0] + N[:2, 2]
    length = float(np.max(np.abs(plane)))
    rows = []
    for (x, y), (a, b) in zip(plane / length, u, strict=True):
        rows += [
            [x, y, 1.0, 0.0, 0.0, 0.0, -a * x, -a * y, -a],
            [0.0, 0.0, 0.0, x, y, 1.0, -b * x, -b * y, -b],
        ]
    _, singular, Vt = np.linalg.svd(np.array(rows))
    if singular[7] < 1e-9 * singular[0]:
        raise DegenerateGeometry("The five points do not determine the view.")
    H = np.linalg.inv(N) @ Vt[8].reshape(3, 3) @ np.diag([1.0 / length, 1.0 / length, 1.0])
    return np.asarray(H)


def _warnings(slope: float) -> tuple[Advisory, ...]:
    if slope >= MIN_LINE_TILT:
        return ()
    return (
        Advisory(
            "one_line_parallel",
            f"A line of the two is within {math.degrees(slope):.1f}° of the image plane: the angle between them does "
            "not determine the focal length.",
            "Tilt the grid about an axis that is parallel to neither of its sides.",
        ),
    )
