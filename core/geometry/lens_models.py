"""Cameras whose lens is beyond `camera.Camera`: rational distortion, and Kannala's and Brandt's angular model.

With (x, y) = (X/Z, Y/Z) in the camera frame and r² = x² + y², the rational model has

    g  = (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶),   (x_d, y_d) = g (x, y)

and the angular one, θ = atan2(√(X² + Y²), Z) being the angle from the optical axis,

    ρ  = θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸),   (x_d, y_d) = ρ (X, Y) / √(X² + Y²).

To both the tangential terms of a lens that is not centred are added; the pixel is as in `camera`:

    x' = x_d + 2 p1 a b + p2 (a² + b² + 2 a²),   y' = y_d + p1 (a² + b² + 2 b²) + 2 p2 a b

with (a, b) = (x, y) in the rational model, as OpenCV has it, and (a, b) = (x_d, y_d) in the angular one, where OpenCV's
`fisheye` has p1 = p2 = 0.

References: J. Kannala, S. S. Brandt, "A generic camera model and calibration method for conventional, wide-angle, and
fish-eye lenses", IEEE TPAMI 28 (2006) 1335-1340, 10.1109/TPAMI.2006.153; D. Claus, A. W. Fitzgibbon, "A rational
function lens distortion model for general cameras", CVPR 2005, 10.1109/CVPR.2005.43.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal

import numpy as np
from jaxtyping import Float

from core.geometry.camera import Camera, PinholeIntrinsics, project, project_with_jacobian

LensModel = Literal["brown", "kannala_brandt", "rational"]
SMALL_TANGENT = 1e-3
"""r below which the angular model is taken from its series: its derivatives are differences of large numbers there."""


@dataclass(frozen=True, slots=True)
class KannalaBrandtCamera(PinholeIntrinsics):
    """Intrinsics (px) and the angular model's coefficients (dimensionless)."""

    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    p1: float = 0.0
    p2: float = 0.0


@dataclass(frozen=True, slots=True)
class RationalCamera(PinholeIntrinsics):
    """Intrinsics (px) and the rational model's coefficients (dimensionless), in OpenCV's order."""

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    k5: float = 0.0
    k6: float = 0.0


AnyCamera = Camera | KannalaBrandtCamera | RationalCamera
_CLASSES: dict[LensModel, type[AnyCamera]] = {
    "brown": Camera,
    "kannala_brandt": KannalaBrandtCamera,
    "rational": RationalCamera,
}
LENS_PARAMETERS: dict[LensModel, tuple[str, ...]] = {
    name: tuple(f.name for f in fields(kind)) for name, kind in _CLASSES.items()
}
"""Names and order of each model's parameters in every state vector and covariance."""
_BY_SIZE: dict[int, LensModel] = {len(names): model for model, names in LENS_PARAMETERS.items()}
_FREE: dict[LensModel, int] = {"brown": 8, "kannala_brandt": 10, "rational": 12}


def lens_model_of(camera: AnyCamera) -> LensModel:
    """Return the name of a camera's lens model."""
    return _BY_SIZE[len(fields(camera))]


def camera_from_array(parameters: Float[np.ndarray, " p"]) -> AnyCamera:
    """Make a camera of its parameters; their number (9, 10 or 12) distinguishes the models."""
    return _CLASSES[_BY_SIZE[len(parameters)]](*(float(value) for value in parameters))


def free_parameters(size: int) -> int:
    """Return how many of the `size` parameters of a model fits estimate, the first ones: all but Brown's k3."""
    return _FREE[_BY_SIZE[size]]


def project_any(points_camera: Float[np.ndarray, "n 3"], camera: AnyCamera) -> Float[np.ndarray, "n 2"]:
    """Project points of the camera frame (mm) to pixels."""
    if isinstance(camera, Camera):
        return project(points_camera, camera)
    pixels, _, _ = project_any_with_jacobian(points_camera, camera)
    return pixels.T.copy()


def project_any_with_jacobian(
    points_camera: Float[np.ndarray, "n 3"], camera: AnyCamera
) -> tuple[Float[np.ndarray, "2 n"], Float[np.ndarray, "p 2 n"], Float[np.ndarray, "3 2 n"]]:
    """Project and differentiate, as `camera.project_with_jacobian`: by the camera's parameters in their order, and by
    the points of the camera frame (px/mm).
    """
    if isinstance(camera, Camera):
        return project_with_jacobian(points_camera, camera)
    if isinstance(camera, KannalaBrandtCamera):
        distorted, by_distortion, by_point = _angular(points_camera, camera)
    else:
        distorted, by_distortion, by_point = _rational(points_camera, camera)
    focal = np.array([camera.fx_px, camera.fy_px])[:, None]
    by_camera = np.zeros((4 + len(by_distortion), 2, len(points_camera)))
    by_camera[0, 0], by_camera[1, 1] = distorted
    by_camera[2, 0] = by_camera[3, 1] = 1.0
    by_camera[4:] = by_distortion * focal
    pixels = distorted * focal
    pixels[0] += camera.cx_px
    pixels[1] += camera.cy_px
    return pixels, by_camera, by_point * focal


def _angular(
    points_camera: Float[np.ndarray, "n 3"], camera: KannalaBrandtCamera
) -> tuple[Float[np.ndarray, "2 n"], Float[np.ndarray, "6 2 n"], Float[np.ndarray, "3 2 n"]]:
    X, Y, Z = points_camera.T
    R2 = X * X + Y * Y
    R = np.sqrt(R2)
    D = R2 + Z * Z
    theta = np.arctan2(R, Z)
    t2 = theta * theta
    k = np.array([camera.k1, camera.k2, camera.k3, camera.k4])
    rho = theta * (1.0 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))))
    slope = 1.0 + t2 * (3.0 * k[0] + t2 * (5.0 * k[1] + t2 * (7.0 * k[2] + t2 * 9.0 * k[3])))
    small = (Z > 0.0) & (SMALL_TANGENT * Z > R)
    safe = np.where(small, 1.0, R)
    with np.errstate(divide="ignore", invalid="ignore"):
        near = k[0] - 1.0 / 3.0
        s = np.where(small, (1.0 + near * R2 / (Z * Z)) / Z, rho / safe)  # (x_d, y_d) = s (X, Y)
        m = np.where(small, 2.0 * near / Z**3, (slope * Z / D - rho / safe) / safe**2)  # ds/dX = m X
    x, y = X * s, Y * s
    along = -slope / D
    by_point = np.array([[s + X * X * m, X * Y * m], [X * Y * m, s + Y * Y * m], [X * along, Y * along]])
    unit = np.where(small, 0.0, X / safe), np.where(small, 0.0, Y / safe)
    by = np.empty((6, 2, len(X)))
    power = theta
    for i in range(4):
        power = power * t2
        by[i, 0], by[i, 1] = unit[0] * power, unit[1] * power
    T, tangential = tangential_terms(x, y, camera.p1, camera.p2)
    distorted = np.array([x, y]) + camera.p1 * tangential[0] + camera.p2 * tangential[1]
    by[:4] = np.einsum("abn,kbn->kan", T, by[:4])
    by[4:] = tangential
    return distorted, by, np.einsum("abn,kbn->kan", T, by_point)


def _rational(
    points_camera: Float[np.ndarray, "n 3"], camera: RationalCamera
) -> tuple[Float[np.ndarray, "2 n"], Float[np.ndarray, "8 2 n"], Float[np.ndarray, "3 2 n"]]:
    inverse = 1.0 / points_camera[:, 2]
    x, y = points_camera[:, 0] * inverse, points_camera[:, 1] * inverse
    distorted, J, by = distorted_rationally(x, y, camera)
    by_point = np.empty((3, 2, len(x)))
    by_point[0], by_point[1] = J[:, 0] * inverse, J[:, 1] * inverse
    by_point[2] = -(by_point[0] * x + by_point[1] * y)
    return distorted, by, by_point


def distorted_rationally(
    x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"], camera: RationalCamera
) -> tuple[Float[np.ndarray, "2 n"], Float[np.ndarray, "2 2 n"], Float[np.ndarray, "8 2 n"]]:
    """Return (x', y'), its derivatives [component, by] by (x, y), and those by the coefficients in their order."""
    r2 = x * x + y * y
    above = 1.0 + r2 * (camera.k1 + r2 * (camera.k2 + r2 * camera.k3))
    below = 1.0 + r2 * (camera.k4 + r2 * (camera.k5 + r2 * camera.k6))
    slope_above = camera.k1 + r2 * (2.0 * camera.k2 + r2 * 3.0 * camera.k3)
    slope_below = camera.k4 + r2 * (2.0 * camera.k5 + r2 * 3.0 * camera.k6)
    g = above / below
    slope = 2.0 * (slope_above - g * slope_below) / below  # dg/dx = slope·x
    T, tangential = tangential_terms(x, y, camera.p1, camera.p2)
    distorted = g * np.array([x, y]) + camera.p1 * tangential[0] + camera.p2 * tangential[1]
    J = T.copy()
    J[0, 0] += g - 1.0 + slope * x * x
    J[1, 1] += g - 1.0 + slope * y * y
    J[0, 1] += slope * x * y
    J[1, 0] += slope * x * y
    by = np.empty((8, 2, len(x)))
    radial = np.array([x, y]) / below
    for place, power in ((0, r2), (1, r2 * r2), (4, r2**3)):
        by[place] = radial * power
    for place, power in ((5, r2), (6, r2 * r2), (7, r2**3)):
        by[place] = -radial * g * power
    by[2], by[3] = tangential
    return distorted, J, by


def tangential_terms(
    a: Float[np.ndarray, " n"], b: Float[np.ndarray, " n"], p1: float, p2: float
) -> tuple[Float[np.ndarray, "2 2 n"], Float[np.ndarray, "2 2 n"]]:
    """Return the derivatives of (a, b) with its tangential terms by (a, b), and what p1 and p2 are multiplied by."""
    ab, r2 = 2.0 * a * b, a * a + b * b
    cross = 2.0 * p1 * a + 2.0 * p2 * b
    T = np.array([[1.0 + 2.0 * p1 * b + 6.0 * p2 * a, cross], [cross, 1.0 + 6.0 * p1 * b + 2.0 * p2 * a]])
    return T, np.array([[ab, r2 + 2.0 * b * b], [r2 + 2.0 * a * a, ab]])
