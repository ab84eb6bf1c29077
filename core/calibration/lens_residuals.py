"""Residuals of views before a camera of any lens model.

The number of a camera's parameters says which model it is (`core.geometry.LENS_PARAMETERS`). Brown's, that of nearly
every session, has compiled kernels (`reprojection_kernel`). The wide models have the same functions in numpy: no
installation compiles for a lens it may never see, and a view costs a tenth of a millisecond.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from core.calibration import reprojection_kernel as brown
from core.geometry import (
    CAMERA_PARAMETERS,
    camera_from_array,
    free_parameters,
    project_any_with_jacobian,
    so3_exp,
)

BROWN_SIZE = len(CAMERA_PARAMETERS)
MIN_DAMPING, MAX_DAMPING = 1e-4, 1e8


def residuals_with_jacobian(
    target: Float[np.ndarray, "3 n"],
    observed: Float[np.ndarray, "2 n"],
    parameters: Float[np.ndarray, " s"],
    rotation: Float[np.ndarray, "3 3"],
    translation_mm: Float[np.ndarray, "3"],
    cameras: int,
) -> tuple[Float[np.ndarray, "2 n"], Float[np.ndarray, "p 2 n"]]:
    """Return observed - predicted (px) and the derivatives of the prediction, by the first `cameras` of the camera's
    parameters (those that are free, or 0), a rotation about the centroid and a translation; see `reprojection_kernel`.
    """
    if len(parameters) == BROWN_SIZE:
        return brown.residuals_with_jacobian(target, observed, parameters, rotation, translation_mm, cameras)
    turned = rotation @ target
    pixels, by_camera, by_point = project_any_with_jacobian(
        (turned + translation_mm[:, None]).T, camera_from_array(parameters)
    )
    jacobian = np.empty((cameras + 6, 2, target.shape[1]))
    jacobian[:cameras] = by_camera[:cameras]
    X, Y, Z = turned
    jacobian[cameras] = by_point[2] * Y - by_point[1] * Z  # d(exp(w) R x)/dw = w × (R x)
    jacobian[cameras + 1] = by_point[0] * Z - by_point[2] * X
    jacobian[cameras + 2] = by_point[1] * X - by_point[0] * Y
    jacobian[cameras + 3 :] = by_point
    return observed - pixels, jacobian


def normal_equations(
    first: Int[np.ndarray, " bounds"],
    points_target: Float[np.ndarray, "n 3"],
    centroids: Float[np.ndarray, "m 3"],
    points_px: Float[np.ndarray, "n 2"],
    weight: Float[np.ndarray, " n"],
    used: Bool[np.ndarray, " n"],
    parameters: Float[np.ndarray, "m s"],
    rotations: Float[np.ndarray, "m 3 3"],
    translations_mm: Float[np.ndarray, "m 3"],
    robust: bool,
    cauchy: float,
    median_length: float,
    products: Float[np.ndarray, "m q q"],
    residuals: Float[np.ndarray, "2 n"],
    squared: Float[np.ndarray, " n"],
    cost: Float[np.ndarray, " m"],
) -> None:
    """Write what `reprojection_kernel.normal_equations` writes; the residuals' row and column are the last."""
    if parameters.shape[1] == BROWN_SIZE:
        brown.normal_equations(
            first,
            points_target,
            centroids,
            points_px,
            weight,
            used,
            parameters,
            rotations,
            translations_mm,
            robust,
            cauchy,
            median_length,
            products,
            residuals,
            squared,
            cost,
        )
        return
    cameras = free_parameters(parameters.shape[1])
    for i in range(len(parameters)):
        part = slice(int(first[i]), int(first[i + 1]))
        count = part.stop - part.start
        if count == 0:
            continue
        left, jacobian = residuals_with_jacobian(
            (points_target[part] - centroids[i]).T,
            points_px[part].T,
            parameters[i],
            rotations[i],
            translations_mm[i],
            cameras,
        )
        residuals[:, part] = left
        squared[part] = np.sum(left * left, axis=0) * weight[part]
        if robust:
            scale = max(float(np.sqrt(np.median(squared[part]))) / median_length, 1e-9)
            cost[i] = 2.0 * count * np.log(scale)
            root = np.sqrt(weight[part] / (1.0 + squared[part] / (cauchy * scale) ** 2)) / scale
        else:
            cost[i] = float(np.sum(squared[part][used[part]]))
            root = np.where(used[part], np.sqrt(weight[part]), 0.0)
        rows = np.concatenate([jacobian, left[None]]) * root
        flat = rows.reshape(len(rows), 2 * count)
        products[i] = flat @ flat.T


def descend(
    target: Float[np.ndarray, "3 n"],
    observed: Float[np.ndarray, "2 n"],
    root_weight: Float[np.ndarray, " n"],
    parameters: Float[np.ndarray, " s"],
    rotation: Float[np.ndarray, "3 3"],
    translation_mm: Float[np.ndarray, "3"],
    steps: int,
    known_cost: float,
    share: float,
    least: float,
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"], float]:
    """Walk from a pose down to the minimum in whose valley it lies, as `reprojection_kernel.descend`."""
    if len(parameters) == BROWN_SIZE:
        return brown.descend(
            target,
            observed,
            root_weight,
            parameters,
            rotation,
            translation_mm,
            steps,
            known_cost,
            share,
            least,
        )
    best_R, best_t, cost, damping = rotation, translation_mm, np.inf, 0.0
    R, t = rotation, translation_mm
    H, g = np.eye(6), np.zeros(6)
    for _ in range(steps):
        found = np.inf
        if np.all(R[2] @ target + t[2] > 0.0):
            r, J = residuals_with_jacobian(target, observed, parameters, R, t, 0)
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
    return np.ascontiguousarray(best_R), best_t, cost
