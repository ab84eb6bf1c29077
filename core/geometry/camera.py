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

import numpy as np
from jaxtyping import Float

CAMERA_PARAMETERS = ("fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "p1", "p2", "k3")
"""Names and order of the camera's parameters in every state vector and covariance."""


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
    pixels, _, _ = project_with_jacobian(points_camera, camera)
    return pixels.T.copy()


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
    distorted, (xx, xy, yy), by_camera = _distort(x, y, camera)
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


def _distort(
    x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"], camera: Camera
) -> tuple[Float[np.ndarray, "2 n"], tuple[Float[np.ndarray, " n"], ...], Float[np.ndarray, "9 2 n"]]:
    """Return (x', y'), the derivatives (dx'/dx, dx'/dy = dy'/dx, dy'/dy), and d(x', y')/dk in rows 4-8 of
    nine.
    """
    k1, k2, p1, p2, k3 = camera.k1, camera.k2, camera.p1, camera.p2, camera.k3
    x2, y2, xy2 = x * x, y * y, 2.0 * (x * y)
    r2 = x2 + y2
    r4 = r2 * r2
    by_camera = np.zeros((9, 2, len(x)))
    np.multiply(x, r2, out=by_camera[4, 0])
    np.multiply(y, r2, out=by_camera[4, 1])
    np.multiply(by_camera[4], r2, out=by_camera[5])
    np.multiply(by_camera[5], r2, out=by_camera[8])
    by_camera[6, 0] = by_camera[7, 1] = xy2
    np.add(r2, 2.0 * y2, out=by_camera[6, 1])
    np.add(r2, 2.0 * x2, out=by_camera[7, 0])
    radial = 1.0 + k1 * r2 + k2 * r4
    slope = 2.0 * k1 + 4.0 * k2 * r2  # dg/dx = slope·x
    if k3:
        radial += k3 * (r4 * r2)
        slope += 6.0 * k3 * r4
    distorted = np.empty((2, len(x)))
    distorted[0] = x * radial + p1 * xy2 + p2 * by_camera[7, 0]
    distorted[1] = y * radial + p1 * by_camera[6, 1] + p2 * xy2
    dxx = radial + slope * x2 + (2.0 * p1) * y + (6.0 * p2) * x
    dyy = radial + slope * y2 + (6.0 * p1) * y + (2.0 * p2) * x
    dxy = (0.5 * slope) * xy2 + (2.0 * p1) * x + (2.0 * p2) * y
    return distorted, (dxx, dxy, dyy), by_camera


def undistort_points(
    points_px: Float[np.ndarray, "n 2"], camera: Camera, iterations: int = 30
) -> Float[np.ndarray, "n 2"]:
    """Return normalised (x, y) whose projection is `points_px`, by Newton's method on the distortion.

    Where the distortion has no inverse (beyond the radius at which the model folds back) the nearest point
    the iteration reaches is returned; `project` of it then differs from the input, which callers can test.
    """
    target = np.array(
        [(points_px[:, 0] - camera.cx_px) / camera.fx_px, (points_px[:, 1] - camera.cy_px) / camera.fy_px]
    )
    normalised = target.copy()
    for _ in range(iterations):
        distorted, (dxx, dxy, dyy), _ = _distort(normalised[0], normalised[1], camera)
        error = target - distorted
        if not np.any(np.abs(error) > 1e-14):
            break
        # Held away from zero: past the fold Newton's step has no meaning, only a bound.
        determinant = np.maximum(dxx * dyy - dxy * dxy, 0.05)
        step = np.array([dyy * error[0] - dxy * error[1], dxx * error[1] - dxy * error[0]]) / determinant
        normalised += np.clip(step, -0.5, 0.5)
    return normalised.T.copy()
