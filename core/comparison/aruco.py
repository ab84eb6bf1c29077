"""Poses from ArUco markers with calibrated intrinsics: one marker of four corners, and the whole board.

`aruco_marker` is cv2.solvePnP with SOLVEPNP_IPPE_SQUARE, OpenCV's way for a single marker, on the four corners that
OpenCV's own marker detector found. Four corners of a small square leave a second pose, mirrored about the line of
sight, that explains the image nearly as well; the ratio of the two reprojection errors is reported. Near 1 the pose
may be the wrong one. `aruco_board` is cv2.solvePnP (iterative) on the corners of all markers of the board that were
found.

Both need a camera that was calibrated before, from other images or from the session's own by `zhang`.

References: T. Collins, A. Bartoli, "Infinitesimal plane-based pose estimation", IJCV 109 (2014) 252-286,
10.1007/s11263-014-0725-5; Garrido-Jurado et al. 2014 as in `core.targets.charuco.layout`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import cv2
import numpy as np
from jaxtyping import Float

from core.comparison.results import MethodResult
from core.errors import Advisory, DegenerateGeometry, InvalidArgument, NotConverged
from core.geometry import Camera, compose, invert, project, so3_exp, transform, transform_points
from core.targets import CharucoLayout

AMBIGUOUS = 2.0
"""Below this ratio of the mirrored pose's reprojection error to the chosen one's, the choice is chance."""


def central_marker(layout: CharucoLayout) -> int:
    """Return the id of the marker nearest to the board's middle, which is in view wherever the board is."""
    middle = 0.5 * np.array([layout.target.columns, layout.target.rows])
    return int(np.argmin(np.sum((layout.marker_squares - middle) ** 2, axis=1)))


def aruco_marker(
    corners_px: Float[np.ndarray, "4 2"], corners_target: Float[np.ndarray, "4 3"], camera: Camera
) -> MethodResult:
    """Return the target's pose from the four corners of one marker, a square.

    Raises InvalidArgument for corners that are not finite or no square, NotConverged where OpenCV finds no pose.
    """
    if not (np.all(np.isfinite(corners_px)) and np.all(np.isfinite(corners_target))):
        raise InvalidArgument("A marker's corners must be finite.")
    T_target_marker, side = _marker_frame(corners_target)
    half = 0.5 * side
    square = np.array([[-half, half, 0.0], [half, half, 0.0], [half, -half, 0.0], [-half, -half, 0.0]])
    try:
        _, rotations, translations, errors = cv2.solvePnPGeneric(
            square,
            corners_px.reshape(4, 1, 2),
            camera.matrix,
            camera.as_array()[4:],
            flags=cv2.SOLVEPNP_IPPE_SQUARE,
        )
    except cv2.error as failure:
        raise NotConverged(f"OpenCV's solvePnP failed: {failure.err}.") from failure
    poses = [
        compose(transform(so3_exp(np.ravel(r)), np.ravel(t)), invert(T_target_marker))
        for r, t in zip(rotations, translations, strict=True)
    ]
    if not poses or not np.all(np.isfinite(poses[0])):
        raise NotConverged("OpenCV's solvePnP found no pose of the marker.")
    error = np.ravel(errors)
    ratio = float(error[1] / error[0]) if len(error) > 1 and error[0] > 0 else math.inf
    warning = Advisory(
        "pose_ambiguous",
        f"The mirrored pose explains the marker's corners nearly as well (errors 1 : {ratio:.1f}).",
        "Use the whole board, a larger marker, or a view more from the side.",
    )
    residuals = corners_px - project(transform_points(poses[0], corners_target), camera)
    return MethodResult(
        "aruco_marker", camera, (poses[0],), (residuals,), (warning,) if ratio < AMBIGUOUS else ()
    )


def aruco_board(
    markers: Mapping[int, Float[np.ndarray, "4 2"]], layout: CharucoLayout, camera: Camera
) -> MethodResult:
    """Return the board's pose from the corners of all markers found, px by id.

    Raises InvalidArgument, InvalidTarget for ids the board does not have, DegenerateGeometry for fewer than two
    markers, NotConverged where OpenCV finds no pose.
    """
    if len(markers) < 2:
        raise DegenerateGeometry(
            f"The board's pose takes at least two markers, {len(markers)} were found.",
            "Show more of the board, sharp and evenly lit.",
        )
    numbers = sorted(markers)
    corners_target = np.concatenate([layout.marker_corners(number) for number in numbers])
    corners_px = np.concatenate([markers[number] for number in numbers])
    return pose_of_points("aruco_board", corners_target, corners_px, camera)


def pose_of_points(
    method: str,
    points_target: Float[np.ndarray, "n 3"],
    points_px: Float[np.ndarray, "n 2"],
    camera: Camera,
) -> MethodResult:
    """Return the pose of points of one plane with a camera that is known, by cv2.solvePnP (iterative).

    Raises InvalidArgument for pixels or a camera that are not finite, DegenerateGeometry for fewer than six points,
    NotConverged where OpenCV finds no pose.
    """
    if not (np.all(np.isfinite(points_px)) and np.all(np.isfinite(camera.as_array()))):
        raise InvalidArgument("Points and intrinsics must be finite.")
    if len(points_target) < 6:
        raise DegenerateGeometry(f"The pose needs at least 6 points, {len(points_target)} were found.")
    try:
        found, rotation, translation = cv2.solvePnP(
            points_target,
            points_px.reshape(-1, 1, 2),
            camera.matrix,
            camera.as_array()[4:],
            flags=cv2.SOLVEPNP_ITERATIVE,
        )
    except cv2.error as failure:
        raise NotConverged(f"OpenCV's solvePnP failed: {failure.err}.") from failure
    T = transform(so3_exp(np.ravel(rotation)), np.ravel(translation))
    inside = transform_points(T, points_target)
    if not found or not np.all(np.isfinite(T)) or np.any(inside[:, 2] <= 0):
        raise NotConverged("OpenCV's solvePnP found no pose of the board.")
    return MethodResult(method, camera, (T,), (points_px - project(inside, camera),))


def _marker_frame(corners: Float[np.ndarray, "4 3"]) -> tuple[Float[np.ndarray, "4 4"], float]:
    """Return the frame in a marker's middle, x to its right, y up, that OpenCV's solver works in, and the side, mm."""
    x, y = corners[1] - corners[0], corners[0] - corners[3]
    side = float(np.linalg.norm(x))
    square = side > 0 and np.allclose(corners[2] - corners[3], x, atol=1e-6 * side)
    if not square or abs(float(x @ y)) > 1e-6 * side**2 or abs(float(np.linalg.norm(y)) - side) > 1e-6 * side:
        raise InvalidArgument("A marker's corners must be those of a square, from the upper left, clockwise.")
    x, y = x / side, y / side
    return transform(np.stack([x, y, np.cross(x, y)], axis=1), corners.mean(axis=0)), side
