"""Residuals of views before a camera of any lens model.

The number of a camera's parameters says which model it is (`core.geometry.LENS_PARAMETERS`). Brown's, that of nearly
every session, has compiled kernels (`one_view`). The wide models have the same functions in numpy: no installation
compiles for a lens it may never see, and a view costs a tenth of a millisecond.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from core.calibration.residuals import one_view as brown
from core.geometry import CAMERA_PARAMETERS, Camera, camera_from_array, project_any_with_jacobian, so3_exp
from core.numerics import CAUCHY_C, MEDIAN_LENGTH

BROWN_SIZE = len(CAMERA_PARAMETERS)
MIN_DAMPING, MAX_DAMPING = 1e-4, 1e8


@dataclass(frozen=True, slots=True)
class View:
    """The state of a fit: camera parameters in the order of the model's `LENS_PARAMETERS`, rotation, and the
    position of the grid points' centroid in the camera frame (mm): turning about it decouples rotation from
    translation.
    """

    parameters: Float[np.ndarray, " s"]
    rotation: Float[np.ndarray, "3 3"]
    translation_mm: Float[np.ndarray, "3"]

    @property
    def camera(self) -> Camera:
        return Camera.from_array(self.parameters)


def residuals_with_jacobian(
    target: Float[np.ndarray, "3 n"], observed: Float[np.ndarray, "2 n"], view: View, cameras: int
) -> tuple[Float[np.ndarray, "2 n"], Float[np.ndarray, "p 2 n"]]:
    """Return observed - predicted (px) and the derivatives of the prediction, by the first `cameras` of the camera's
    parameters (those that are free, or 0), a rotation about the centroid and a translation; see `one_view`.
    """
    rotation, translation_mm = np.ascontiguousarray(view.rotation), view.translation_mm
    if len(view.parameters) == BROWN_SIZE:
        return brown.residuals_with_jacobian(
            target, observed, view.parameters, rotation, translation_mm, cameras
        )
    turned = rotation @ target
    pixels, by_camera, by_point = project_any_with_jacobian(
        (turned + translation_mm[:, None]).T, camera_from_array(view.parameters)
    )
    jacobian = np.empty((cameras + 6, 2, target.shape[1]))
    jacobian[:cameras] = by_camera[:cameras]
    X, Y, Z = turned
    jacobian[cameras] = by_point[2] * Y - by_point[1] * Z  # d(exp(w) R x)/dw = w × (R x)
    jacobian[cameras + 1] = by_point[0] * Z - by_point[2] * X
    jacobian[cameras + 2] = by_point[1] * X - by_point[0] * Y
    jacobian[cameras + 3 :] = by_point
    return observed - pixels, jacobian


def products_of_view(
    residuals: Float[np.ndarray, "2 n"],
    jacobian: Float[np.ndarray, "p 2 n"],
    weight: Float[np.ndarray, " n"],
    used: Bool[np.ndarray, " n"],
    *,
    robust: bool,
) -> tuple[Float[np.ndarray, "q q"], Float[np.ndarray, " n"], float]:
    """Return what `normal_equations` writes for a view: the products of derivatives and residuals, whose row and column
    are the last, squared distances in stated uncertainties, and the cost.
    """
    squared = np.sum(residuals * residuals, axis=0) * weight
    if robust:
        scale = max(float(np.sqrt(np.median(squared))) / MEDIAN_LENGTH[2], 1e-9)
        cost = 2.0 * len(squared) * float(np.log(scale))
        root = np.sqrt(weight / (1.0 + squared / (CAUCHY_C * scale) ** 2)) / scale
    else:
        cost = float(np.sum(squared[used]))
        root = np.where(used, np.sqrt(weight), 0.0)
    rows = np.concatenate([jacobian, residuals[None]]) * root
    flat = rows.reshape(len(rows), -1)
    return flat @ flat.T, squared, cost


def descend(
    target: Float[np.ndarray, "3 n"],
    observed: Float[np.ndarray, "2 n"],
    root_weight: Float[np.ndarray, " n"],
    start: View,
    steps: int,
    *,
    known_cost: float,
    share: float,
    least: float,
) -> tuple[View, float]:
    """Walk from a pose down to the minimum in whose valley it lies, as `one_view.descend`; return the state there and
    its cost.
    """
    rotation, translation_mm = np.ascontiguousarray(start.rotation), start.translation_mm
    if len(start.parameters) == BROWN_SIZE:
        rotation, translation_mm, cost = brown.descend(
            *(target, observed, root_weight, start.parameters, rotation, translation_mm),
            *(steps, known_cost, share, least),
        )
        return View(start.parameters, rotation, translation_mm), float(cost)
    best_R, best_t, cost, damping = rotation, translation_mm, np.inf, 0.0
    R, t = rotation, translation_mm
    H, g = np.eye(6), np.zeros(6)
    for _ in range(steps):
        found = np.inf
        if np.all(R[2] @ target + t[2] > 0.0):
            r, J = residuals_with_jacobian(target, observed, View(start.parameters, R, t), 0)
            r, J = (r * root_weight).ravel(), (J * root_weight).reshape(6, -1)
            found = float(r @ r)
        if found < cost:
            gained, cost = cost - found, found
            best_R, best_t, H, g = R, t, J @ J.T, J @ r
            damping = 0.0 if damping < 1e-6 else 0.1 * damping
            if gained < max(least, share * (cost - known_cost)):
                break
        else:
            damping = max(10.0 * damping, MIN_DAMPING)
        unit = 1.0 / np.sqrt(np.maximum(np.diag(H), 1e-300))
        if not np.isfinite(cost) or damping > MAX_DAMPING:
            break
        try:
            x = unit * np.linalg.solve(H * np.outer(unit, unit) + damping * np.eye(6), unit * g)
        except np.linalg.LinAlgError:
            damping = max(10.0 * damping, MIN_DAMPING)
            continue
        if float(x @ g) < max(least, share * (cost - known_cost)):
            break
        R, t = so3_exp(x[:3]) @ best_R, best_t + x[3:]
    return View(start.parameters, np.ascontiguousarray(best_R), best_t), float(cost)
