"""The camera model: pinhole with radial (k1, k2, k3) and tangential (p1, p2) distortion.

With (x, y) = (X/Z, Y/Z) in the camera frame, r² = x² + y²:

    g  = 1 + k1 r² + k2 r⁴ + k3 r⁶
    x' = x g + 2 p1 x y + p2 (r² + 2 x²)
    y' = y g + p1 (r² + 2 y²) + 2 p2 x y
    u  = fx x' + cx,   v = fy y' + cy

which is OpenCV's model, in its parameter order and pixel convention ((0, 0) is the centre of the top-left
pixel).

References: D. C. Brown, "Close-range camera calibration", Photogrammetric Engineering 37 (1971) 855-866.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

CAMERA_PARAMETERS = ("fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "p1", "p2", "k3")
"""Names and order of the camera's parameters in every state vector and covariance."""
_MAX_STEPS = 30


@dataclass(frozen=True, slots=True)
class PinholeIntrinsics:
    """The intrinsics (px) that cameras of every lens model begin with."""

    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float

    def as_array(self) -> Float[np.ndarray, " p"]:
        """Return the parameters in the order of the fields, which is that of `LENS_PARAMETERS`."""
        return np.array([getattr(self, f.name) for f in fields(self)], dtype=np.float64)

    @property
    def matrix(self) -> Float[np.ndarray, "3 3"]:
        """The paper's C: [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]."""
        return np.array([[self.fx_px, 0.0, self.cx_px], [0.0, self.fy_px, self.cy_px], [0.0, 0.0, 1.0]])


@dataclass(frozen=True, slots=True)
class Camera(PinholeIntrinsics):
    """Intrinsics (px) and distortion (dimensionless) of one camera."""

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0

    @classmethod
    def from_array(cls, parameters: Float[np.ndarray, "9"]) -> Camera:
        """Make a camera from parameters in the order of `CAMERA_PARAMETERS`."""
        return cls(*(float(value) for value in parameters))


def project(points_camera: Float[np.ndarray, "n 3"], camera: Camera) -> Float[np.ndarray, "n 2"]:
    """Project points of the camera frame (mm, Z > 0) to pixels."""
    Z_inverse = 1.0 / points_camera[:, 2]
    distorted = _distorted(_powers(points_camera[:, 0] * Z_inverse, points_camera[:, 1] * Z_inverse), camera)
    pixels = np.empty((len(points_camera), 2))
    pixels[:, 0] = camera.fx_px * distorted[0] + camera.cx_px
    pixels[:, 1] = camera.fy_px * distorted[1] + camera.cy_px
    return pixels


def project_with_jacobian(
    points_camera: Float[np.ndarray, "n 3"], camera: Camera
) -> tuple[Float[np.ndarray, "2 n"], Float[np.ndarray, "9 2 n"], Float[np.ndarray, "3 2 n"]]:
    """Project and differentiate.

    Returns pixels, their derivatives by the camera's parameters in the order of `CAMERA_PARAMETERS`, and by
    the points of the camera frame (px/mm). Points run along the last axis, so that every product below is
    over contiguous memory and a normal matrix is one matrix product.
    """
    Z_inverse = 1.0 / points_camera[:, 2]
    x, y = points_camera[:, 0] * Z_inverse, points_camera[:, 1] * Z_inverse
    powers = _powers(x, y)
    distorted, (xx, xy, yy) = _distorted(powers, camera), _slopes(powers, camera)
    by_camera = _by_coefficients(powers)
    pixels = np.empty_like(distorted)
    pixels[0] = camera.fx_px * distorted[0] + camera.cx_px
    pixels[1] = camera.fy_px * distorted[1] + camera.cy_px
    by_camera[0, 0], by_camera[1, 1] = distorted
    by_camera[2, 0] = by_camera[3, 1] = 1.0
    by_camera[4:, 0] *= camera.fx_px
    by_camera[4:, 1] *= camera.fy_px
    by_point = np.empty((3, 2, len(x)))
    fx, fy = camera.fx_px * Z_inverse, camera.fy_px * Z_inverse
    np.multiply(xx, fx, out=by_point[0, 0])
    np.multiply(xy, fy, out=by_point[0, 1])
    np.multiply(xy, fx, out=by_point[1, 0])
    np.multiply(yy, fy, out=by_point[1, 1])
    by_point[2] = -(by_point[0] * x + by_point[1] * y)
    return pixels, by_camera, by_point


class _Powers(NamedTuple):
    """Of normalised places (x, y): what every formula of the distortion is made of."""

    x: Float[np.ndarray, " n"]
    y: Float[np.ndarray, " n"]
    x2: Float[np.ndarray, " n"]
    y2: Float[np.ndarray, " n"]
    xy2: Float[np.ndarray, " n"]
    r2: Float[np.ndarray, " n"]
    r4: Float[np.ndarray, " n"]


def _powers(x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]) -> _Powers:
    x2, y2 = x * x, y * y
    r2 = x2 + y2
    return _Powers(x, y, x2, y2, 2.0 * (x * y), r2, r2 * r2)


def _radial(of: _Powers, camera: Camera) -> Float[np.ndarray, " n"]:
    radial = 1.0 + camera.k1 * of.r2 + camera.k2 * of.r4
    if camera.k3:
        radial += camera.k3 * (of.r4 * of.r2)
    return np.asarray(radial)


def _distorted(of: _Powers, camera: Camera) -> Float[np.ndarray, "2 n"]:
    """Return (x', y')."""
    p1, p2, radial = camera.p1, camera.p2, _radial(of, camera)
    distorted = np.empty((2, len(of.x)))
    distorted[0] = of.x * radial + p1 * of.xy2 + p2 * (of.r2 + 2.0 * of.x2)
    distorted[1] = of.y * radial + p1 * (of.r2 + 2.0 * of.y2) + p2 * of.xy2
    return distorted


def _slopes(of: _Powers, camera: Camera) -> tuple[Float[np.ndarray, " n"], ...]:
    """Return dx'/dx, dx'/dy = dy'/dx and dy'/dy."""
    p1, p2, radial = camera.p1, camera.p2, _radial(of, camera)
    slope = 2.0 * camera.k1 + 4.0 * camera.k2 * of.r2  # dg/dx = slope·x
    if camera.k3:
        slope += 6.0 * camera.k3 * of.r4
    dxx = radial + slope * of.x2 + (2.0 * p1) * of.y + (6.0 * p2) * of.x
    dyy = radial + slope * of.y2 + (6.0 * p1) * of.y + (2.0 * p2) * of.x
    dxy = (0.5 * slope) * of.xy2 + (2.0 * p1) * of.x + (2.0 * p2) * of.y
    return dxx, dxy, dyy


def _by_coefficients(of: _Powers) -> Float[np.ndarray, "9 2 n"]:
    """Return d(x', y')/dk in rows 4-8 of nine, the others zero."""
    by_camera = np.zeros((9, 2, len(of.x)))
    np.multiply(of.x, of.r2, out=by_camera[4, 0])
    np.multiply(of.y, of.r2, out=by_camera[4, 1])
    np.multiply(by_camera[4], of.r2, out=by_camera[5])
    np.multiply(by_camera[5], of.r2, out=by_camera[8])
    by_camera[6, 0] = by_camera[7, 1] = of.xy2
    np.add(of.r2, 2.0 * of.y2, out=by_camera[6, 1])
    np.add(of.r2, 2.0 * of.x2, out=by_camera[7, 0])
    return by_camera


def undistort_points(points_px: Float[np.ndarray, "n 2"], camera: Camera) -> Float[np.ndarray, "n 2"]:
    """Return normalised (x, y) whose projection is `points_px`, by Newton's method on the distortion.

    Where the distortion has no inverse (beyond the radius at which the model folds back) the nearest point
    the iteration reaches is returned; `project` of it then differs from the input, which callers can test.
    """
    target = np.array(
        [(points_px[:, 0] - camera.cx_px) / camera.fx_px, (points_px[:, 1] - camera.cy_px) / camera.fy_px]
    )
    normalised = target.copy()
    for _ in range(_MAX_STEPS):
        powers = _powers(normalised[0], normalised[1])
        error = target - _distorted(powers, camera)
        if not np.any(np.abs(error) > 1e-14):
            break
        dxx, dxy, dyy = _slopes(powers, camera)
        # Held away from zero: past the fold Newton's step has no meaning, only a bound.
        determinant = np.maximum(dxx * dyy - dxy * dxy, 0.05)
        step = np.array([dyy * error[0] - dxy * error[1], dxx * error[1] - dxy * error[0]]) / determinant
        normalised += np.clip(step, -0.5, 0.5)
    return normalised.T.copy()
