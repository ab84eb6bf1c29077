"""The direct linear transformation, on one plane and in space.

In space a point and its image obey u = (L1 x + L2 y + L3 z + L4) / (L9 x + L10 y + L11 z + 1), v likewise with L5-L8:
eleven parameters, which points of one plane cannot give, since with z = 0 everywhere L3, L7 and L11 do not appear. So
the method of Abdel-Aziz and Karara needs six points or more that are not on one plane: `dlt_spatial`, for two grids
in one image or a body with measured points. On a single grid there remain the eight parameters of `dlt`: a plane's
homography. That is a mapping, not yet a camera; pose, fx and fy follow from it once a principal point is assumed (the
image's middle), by the same two orthonormality conditions as the paper's variants, with no further adjustment.

What neither can do: distortion (none is modelled, so it stays in the residuals), statistical weights, a rotation that
is exactly one (it is taken as the nearest). `dlt` moreover fails to give a camera where the tilt is about an image axis
or none.

References: Y. I. Abdel-Aziz, H. M. Karara, "Direct linear transformation from comparator coordinates into object space
coordinates in close-range photogrammetry", Symposium on Close-Range Photogrammetry 1971, 1-18, reprinted in PE&RS 81
(2015) 103-107, 10.14358/PERS.81.2.103; R. Hartley, A. Zisserman, "Multiple View Geometry", 2nd ed. 2004, alg. 7.1
and section 6.2.4.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from core.calibration.baselines.result import Baseline, baseline
from core.calibration.closed_form import from_homography
from core.calibration.homography import estimate_homography, map_points, normalising_transform
from core.calibration.model import image_centre
from core.calibration.validity import check_points
from core.camera import Camera
from core.errors import Advisory, DegenerateGeometry, InvalidArgument
from core.targets.specification import GridPoints
from core.transforms import nearest_rotation, transform

LEAST_RELIEF = 1e-3
"""Least ratio of the points' smallest to largest extent (as standard deviations) that counts as spatial."""


def dlt(points: GridPoints, *, principal_point: tuple[float, float] | None = None) -> Baseline:
    """Map one flat grid by the eight parameters, and take camera and pose from them where they give one.

    Raises InvalidArgument, and DegenerateGeometry for fewer than four points or points on one line. A view that maps
    but gives no camera comes without one, and with a warning that says why.
    """
    check_points(points)
    plane = points.points_target[:, :2]
    H = estimate_homography(plane, points.points_px)
    residuals = points.points_px - map_points(H, plane)
    centre = image_centre(points) if principal_point is None else principal_point
    try:
        found = from_homography(H, points, centre, single_focal=False)
    except DegenerateGeometry as failure:
        remark = Advisory(
            "camera_not_determined", f"The mapping gives no camera: {failure.detail}", failure.advice
        )
        return baseline("dlt", None, [], [residuals], [remark])
    return baseline("dlt", found.camera, [found.T_camera_target], [residuals])


def dlt_spatial(points_target: Float[np.ndarray, "n 3"], points_px: Float[np.ndarray, "n 2"]) -> Baseline:
    """Estimate the eleven parameters and the camera, with its principal point, from points not on one plane.

    The matrix of intrinsics has a skew, which our camera has not: it is dropped from `camera`, not from the residuals.

    Raises InvalidArgument for numbers that are not finite, DegenerateGeometry for fewer than six points, (nearly) flat
    ones, or an image that puts points behind the camera.
    """
    if not (np.all(np.isfinite(points_target)) and np.all(np.isfinite(points_px))):
        raise InvalidArgument("Points must be finite.")
    if len(points_target) < 6:
        raise DegenerateGeometry(f"The DLT in space needs at least 6 points, got {len(points_target)}.")
    mean = points_target.mean(axis=0)
    extents = np.linalg.svd(points_target - mean, compute_uv=False)
    if extents[2] < LEAST_RELIEF * extents[0]:
        raise DegenerateGeometry(
            "The points lie on one plane, for which three of the DLT's eleven parameters do not exist.",
            "Use points of two planes, or the DLT of a plane.",
        )
    scale = math.sqrt(3.0 * len(points_target)) / float(np.linalg.norm(points_target - mean))
    N_px = normalising_transform(points_px)
    X = np.column_stack([(points_target - mean) * scale, np.ones(len(points_target))])
    u, v = (points_px * N_px[0, 0] + N_px[:2, 2]).T
    zero = np.zeros_like(X)
    A = np.concatenate([np.hstack([X, zero, -u[:, None] * X]), np.hstack([zero, X, -v[:, None] * X])])
    _, singular, Vt = np.linalg.svd(A, full_matrices=False)
    if singular[10] < 1e-9 * singular[0]:
        raise DegenerateGeometry("The points do not determine the DLT's eleven parameters.")
    N_space = np.diag([scale, scale, scale, 1.0])
    N_space[:3, 3] = -scale * mean
    P = np.linalg.solve(N_px, Vt[11].reshape(3, 4) @ N_space)
    if np.linalg.det(P[:, :3]) < 0:
        P = -P
    homogeneous = points_target @ P[:, :3].T + P[:, 3]
    if np.any(homogeneous[:, 2] <= 0):
        raise DegenerateGeometry("Some points would lie behind the camera.")
    residuals = points_px - homogeneous[:, :2] / homogeneous[:, 2:]
    K, rotation = _rq(P[:, :3])
    translation = np.linalg.solve(K, P[:, 3])
    K = K / K[2, 2]
    camera = Camera(float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]))
    return baseline("dlt", camera, [transform(nearest_rotation(rotation), translation)], [residuals])


def _rq(M: Float[np.ndarray, "3 3"]) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3 3"]]:
    """Return an upper triangular matrix with positive diagonal and a rotation whose product is M (det M > 0)."""
    turned = np.flipud(np.eye(3))
    Q, upper = np.linalg.qr((turned @ M).T)
    K, rotation = turned @ upper.T @ turned, turned @ Q.T
    signs = np.diag(np.sign(np.diag(K)))
    return np.asarray(K @ signs), np.asarray(signs @ rotation)
