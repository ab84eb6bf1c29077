"""Reported quantities from a fit's covariance: camera pose, residual statistics, observability, warnings."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from core.calibration.residuals import View
from core.calibration.result import CameraPose, Reprojection
from core.calibration.state import retract
from core.errors import Advisory
from core.geometry import hat, is_near_gimbal_lock, rotation_to_rpy, rpy_jacobian, so3_log
from core.jit import jit
from core.numerics import Fit
from core.targets import GridPoints

NOTABLE_INFLATION = 1.25
MAX_CORRELATION = 0.8
SAG_VARIANCE = 3.0
"""E z⁴ of a normal z: errors z² off the tangent have this mean square."""


def camera_pose(
    rotation: Float[np.ndarray, "3 3"],
    translation_mm: Float[np.ndarray, "3"],
    covariance: Float[np.ndarray, "6 6"],
    conditional: Float[np.ndarray, "6 6"],
    sag: Float[np.ndarray, "6"],
) -> CameraPose:
    """Turn T_camera_target and its covariances (w, d in the camera frame) into the camera's pose in the target frame.

    `sag` is the pose's part of `valley_sag`, in the target frame; zero where the camera is given.

    R_ee = Rᵀ, p = -Rᵀt (eqs 36-37). To first order exp(w) R, t + d give exp(w') Rᵀ and p + p' with

        w' = -Rᵀ w,      p' = -Rᵀ [t]× w - Rᵀ d.
    """
    R_target_camera = rotation.T
    J = np.zeros((6, 6))
    J[:3, :3] = -R_target_camera @ hat(translation_mm)
    J[:3, 3:] = -R_target_camera
    J[3:, :3] = -R_target_camera
    pose_covariance = J @ covariance @ J.T + SAG_VARIANCE * np.outer(sag, sag)
    rpy = rotation_to_rpy(R_target_camera)
    E = rpy_jacobian(rpy)
    rpy_variance = np.diag(E @ pose_covariance[3:, 3:] @ E.T)
    return CameraPose(
        position_mm=-R_target_camera @ translation_mm,
        rotation=R_target_camera,
        roll_pitch_yaw=rpy,
        roll_pitch_yaw_standard_uncertainty=np.sqrt(rpy_variance),
        covariance=0.5 * (pose_covariance + pose_covariance.T),
        covariance_given_camera=J @ conditional @ J.T,
    )


def valley_sag(
    view: View, covariance: Float[np.ndarray, "14 14"], centroid: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "15"], Float[np.ndarray, "6"]]:
    """Return how far a fit one standard uncertainty away in f lies off the tangent: of the state, and of the pose.

    Errors of f take depth, tilt and distortion along a curved valley (`retract`), where the covariance is a straight
    ellipsoid about its tangent. With z the error of f over u(f), the valley lies z² times this off the tangent, so
    that covariances grow by `SAG_VARIANCE` times its square. It is small in every parameter by itself, but regions of
    several parameters are thinner than it is.

    Parameters
    ----------
    view
        The estimate; its translation is to `centroid` (target frame, mm).
    covariance
        Of the fit's steps (`state.FREE`), inflation included.

    Returns those of the full state (`result`; w and t of the target's origin in the camera frame), and of x, y, z (mm)
    and w (rad) of the camera in the target frame.
    """
    focal = covariance[:, :2].sum(axis=1)
    along = focal / math.sqrt(float(focal[:2].sum()))
    origin = view.translation_mm - view.rotation @ centroid
    position = -view.rotation.T @ origin
    state, pose = np.zeros(15), np.zeros(6)
    for step in (along, -along):
        there = retract(view, step)
        turned, moved = there.rotation, there.translation_mm - there.rotation @ centroid
        state[:9] += 0.5 * (there.parameters - view.parameters)
        state[9:12] += 0.5 * so3_log(turned @ view.rotation.T)
        state[12:] += 0.5 * (moved - origin)
        pose[:3] += 0.5 * (-turned.T @ moved - position)
        pose[3:] += 0.5 * so3_log(turned.T @ view.rotation)
    return state, pose


def reprojection(residuals_px: Float[np.ndarray, "n 2"], used: Bool[np.ndarray, " n"]) -> Reprojection:
    """Statistics of the residual distances of the points used."""
    squared = np.einsum("nm,nm->n", residuals_px, residuals_px)[used]
    distance = np.sqrt(squared)
    return Reprojection(
        rms_px=math.sqrt(float(squared.mean())),
        mean_px=float(distance.mean()),
        std_px=float(distance.std(ddof=1)),
        max_px=float(distance.max()),
        points=len(distance),
        rejected=len(used) - len(distance),
    )


def correlation_inflation(points: GridPoints, result: Fit[Any]) -> tuple[float, float]:
    """Return (factor, ρ): by how much correlated residuals inflate uncertainties, and the correlation of
    neighbours.

    Corner noise is independent from point to point; a bowed print or a lens beyond the model leaves residuals
    that resemble their neighbours', and then n points say less than n independent ones. With
    ρ(i, j) = ρ^|i| ρ^|j| over the grid, the variance of a smooth combination of residuals is
    ((1 + ρ)/(1 - ρ))² times that of white noise, which is the factor's square.

    The fit itself makes residuals of white noise correlate: their covariance is σ² (I - J C Jᵀ/σ²). That known part
    is taken off, and what is left is shrunk by what chance alone would make of it; a negative ρ counts as none.
    """
    # As the fit weighed them: of these the covariance is that of the estimate, and white noise has one variance.
    uncertainty = points.standard_uncertainty_px
    root_weight = np.mean(uncertainty) / uncertainty
    used, residuals, jacobian = result.used, result.residuals * root_weight, result.jacobian * root_weight
    index = np.full((points.target.grid_rows, points.target.grid_columns), -1)
    index[points.row[used], points.column[used]] = np.flatnonzero(used)
    first, second = neighbours(index)
    count = len(residuals) * len(first)
    if count < 20 or result.scale <= 0:
        return 1.0, 0.0
    observed = sum_of_products(residuals, residuals, first, second)
    flat = jacobian.reshape(len(jacobian), -1)
    leverage = sum_of_products(
        (result.covariance @ flat).reshape(-1, used.size), flat.reshape(-1, used.size), first, second
    )
    rho = (observed + leverage) / (count * result.scale**2)
    # Wiener's factor z²/(1 + z²), z in standard errors of ρ: chance is shrunk away, evidence is kept, without a cliff.
    z_squared = rho**2 * count
    bounded = min(max(rho, 0.0) * z_squared / (1.0 + z_squared), MAX_CORRELATION)
    return (1.0 + bounded) / (1.0 - bounded), rho


def neighbours(index: Int[np.ndarray, "r c"]) -> tuple[Int[np.ndarray, " k"], Int[np.ndarray, " k"]]:
    """Return the pairs of points next to each other along a row or a column; `index` is -1 where there is no point."""
    first = np.concatenate([index[:, :-1].ravel(), index[:-1].ravel()])
    second = np.concatenate([index[:, 1:].ravel(), index[1:].ravel()])
    both = (first >= 0) & (second >= 0)
    return first[both], second[both]


@jit("f8[:, ::1], f8[:, ::1], i8[::1], i8[::1]")
def sum_of_products(
    a: Float[np.ndarray, "m n"],
    b: Float[np.ndarray, "m n"],
    first: Int[np.ndarray, " k"],
    second: Int[np.ndarray, " k"],
) -> float:
    """Return Σ a[:, first] · b[:, second] without making copies; indices must lie in [0, n)."""
    total = 0.0
    for row in range(a.shape[0]):
        for k in range(len(first)):
            total += a[row, first[k]] * b[row, second[k]]
    return total


def warnings_for(
    points: GridPoints, pose: CameraPose, statistics: Reprojection, chi: float, inflation: float, rho: float
) -> list[Advisory]:
    """Return the warnings that every estimator shares; `chi` is the residual scale over the detector's own
    uncertainty.
    """
    found = list(points.warnings)
    if chi > 1.2:
        found.append(
            Advisory(
                "residuals_exceed_noise",
                f"The residuals are {chi:.1f} times what corner noise explains; uncertainties are scaled up by that.",
                "Check that the printed grid is flat and true to size, and that the lens has no more than moderate "
                "distortion.",
            )
        )
    if inflation > NOTABLE_INFLATION:
        found.append(
            Advisory(
                "residuals_correlated",
                f"Residuals of neighbouring points agree (correlation {rho:.2f}): the grid or the lens departs "
                f"from the model. Uncertainties are scaled up by {inflation:.1f}.",
                "Check the grid's flatness; a pooled calibration over several views averages such errors out.",
            )
        )
    if statistics.rejected > 0.1 * len(points):
        found.append(
            Advisory(
                "many_points_rejected",
                f"{statistics.rejected} of {len(points)} points did not fit and were rejected.",
                "Look at the overlay: reflections, dirt or something in front of the grid are the usual causes.",
            )
        )
    if is_near_gimbal_lock(float(pose.roll_pitch_yaw[1])):
        found.append(
            Advisory(
                "near_gimbal_lock",
                "Pitch is within 5° of ±90°, where roll and yaw cannot be separated.",
                "Use the rotation matrix and its covariance instead.",
            )
        )
    return found
