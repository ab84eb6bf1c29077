"""Directions of pixels under every lens model, and the radius beyond which a model has none."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from core.geometry.camera import Camera, undistort_points
from core.geometry.lens_models import (
    AnyCamera,
    KannalaBrandtCamera,
    RationalCamera,
    distorted_rationally,
    project_any,
    tangential_terms,
)

MAX_ANGLE = 1.5
"""Angle from the axis (rad) beyond which a pixel's direction has no place in the plane z = 1."""
MAX_FOLD_SHARE = 0.98
"""Of the radius at which a model turns back: a pixel nearer to it, or beyond it, has no direction."""
MAX_INVERSE_ERROR_PX = 1e-3
_STEPS = 30


def undistort_any(points_px: Float[np.ndarray, "n 2"], camera: AnyCamera) -> Float[np.ndarray, "n 2"]:
    """Return (x, y) at z = 1 whose projection is `points_px`; NaN where no such direction lies within `MAX_ANGLE`, and
    from `MAX_FOLD_SHARE` of the radius on at which the model turns back.
    """
    found = _inverse(points_px, camera).T.copy()
    sound = np.all(np.isfinite(found), axis=1)
    again = project_any(np.column_stack([np.where(sound[:, None], found, 0.0), np.ones(len(found))]), camera)
    sound &= np.linalg.norm(again - points_px, axis=1) < MAX_INVERSE_ERROR_PX
    fold = fold_radius_px(camera)
    if fold is not None:
        sound &= np.hypot(*(points_px - [camera.cx_px, camera.cy_px]).T) < MAX_FOLD_SHARE * fold
    found[~sound] = np.nan
    return found


def _inverse(points_px: Float[np.ndarray, "n 2"], camera: AnyCamera) -> Float[np.ndarray, "2 n"]:
    if isinstance(camera, Camera):
        return undistort_points(points_px, camera).T
    target = ((points_px - [camera.cx_px, camera.cy_px]) / [camera.fx_px, camera.fy_px]).T
    if isinstance(camera, KannalaBrandtCamera):
        return _angular_inverse(target, camera)
    found = target.copy()
    for _ in range(_STEPS):
        distorted, J, _ = distorted_rationally(found[0], found[1], camera)
        error = target - distorted
        determinant = np.maximum(J[0, 0] * J[1, 1] - J[0, 1] * J[1, 0], 0.05)
        step = np.array([J[1, 1] * error[0] - J[0, 1] * error[1], J[0, 0] * error[1] - J[1, 0] * error[0]])
        found += np.clip(step / determinant, -0.5, 0.5)
    return found


def _angular_inverse(
    target: Float[np.ndarray, "2 n"], camera: KannalaBrandtCamera
) -> Float[np.ndarray, "2 n"]:
    plain = target.copy()
    for _ in range(_STEPS if camera.p1 or camera.p2 else 0):
        _, tangential = tangential_terms(plain[0], plain[1], camera.p1, camera.p2)
        plain = target - camera.p1 * tangential[0] - camera.p2 * tangential[1]
    rho = np.hypot(*plain)
    theta = np.minimum(rho, MAX_ANGLE)
    for _ in range(_STEPS):
        t2 = theta * theta
        value = theta * (1.0 + t2 * (camera.k1 + t2 * (camera.k2 + t2 * (camera.k3 + t2 * camera.k4))))
        slope = 1.0 + t2 * (
            3.0 * camera.k1 + t2 * (5.0 * camera.k2 + t2 * (7.0 * camera.k3 + t2 * 9.0 * camera.k4))
        )
        theta = np.clip(theta + np.clip((rho - value) / np.maximum(slope, 0.05), -0.3, 0.3), 0.0, MAX_ANGLE)
    safe = np.where(rho > 0.0, rho, 1.0)
    return np.asarray(plain * np.where(rho > 0.0, np.tan(theta) / safe, 1.0))


def fold_radius_px(camera: AnyCamera) -> float | None:
    """Return how far from the principal point (px) the model's radius turns back: beyond it, two directions share a
    pixel. None where it does not, for directions in front of the camera.
    """
    focal = 0.5 * (camera.fx_px + camera.fy_px)
    if isinstance(camera, KannalaBrandtCamera):
        k = np.array([1.0, camera.k1, camera.k2, camera.k3, camera.k4])
        square = _smallest_root(k * np.arange(1, 10, 2))
        if square is None or np.sqrt(square) > np.pi:
            return None
        theta = float(np.sqrt(square))
        return focal * theta * float(np.polynomial.Polynomial(k)(square))
    if isinstance(camera, RationalCamera):
        above = np.polynomial.Polynomial([1.0, camera.k1, camera.k2, camera.k3])
        below = np.polynomial.Polynomial([1.0, camera.k4, camera.k5, camera.k6])
    else:
        above = np.polynomial.Polynomial([1.0, camera.k1, camera.k2, camera.k3])
        below = np.polynomial.Polynomial([1.0])
    q = np.polynomial.Polynomial([0.0, 1.0])  # r²; r g(r²) has the derivative g + 2 r² g'
    turning = above * below + 2.0 * q * (above.deriv() * below - above * below.deriv())
    square, pole = _smallest_root(turning.coef), _smallest_root(below.coef)
    if square is None or (pole is not None and pole < square):
        return None
    return focal * float(np.sqrt(square) * above(square) / below(square))


def _smallest_root(coefficients: Float[np.ndarray, " c"]) -> float | None:
    """Return the smallest positive root of a polynomial, lowest coefficient first."""
    significant = np.trim_zeros(coefficients, "b")
    roots = np.polynomial.polynomial.polyroots(significant) if len(significant) > 1 else np.zeros(0)
    real = roots.real[(np.abs(roots.imag) < 1e-9 * np.maximum(np.abs(roots), 1.0)) & (roots.real > 0.0)]
    return float(real.min()) if len(real) else None
