"""Covariances of the frames of an identified arm: the camera on the flange, each target in the base."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from core.geometry import hat, invert
from core.kinematics.arm_model import ArmState


def flange_camera_covariance(
    arm: ArmState, free: Bool[np.ndarray, " p"], covariance: Float[np.ndarray, "f f"]
) -> Float[np.ndarray, "6 6"] | None:
    """Return the covariance of T_flange_camera: x, y, z (mm), then a rotation from the left (rad), flange frame.

    `covariance` is of the `free` columns. A column that is held has zeros: the others' uncertainties are those given
    its value. None where all are held.
    """
    columns = arm.layout.tool
    fitted = np.flatnonzero(free[columns])
    if not len(fitted):
        return None
    places = np.cumsum(free)[columns][fitted] - 1
    found = np.zeros((6, 6))
    found[np.ix_(fitted, fitted)] = covariance[np.ix_(places, places)]
    return found


def base_target_covariances(
    arm: ArmState, free: Bool[np.ndarray, " p"], covariance: Float[np.ndarray, "f f"]
) -> tuple[Float[np.ndarray, "6 6"] | None, ...]:
    """Return the covariance of each T_base_target in the base frame, in the same order; None where a column is held.

    The fit's columns are of the inverse B = T_target_base = (R, p), changed by (d, w) from the left. Of B⁻¹ the
    rotation changes by -Rᵀ w and the position by -Rᵀ (d + p × w).
    """
    found: list[Float[np.ndarray, "6 6"] | None] = []
    for target, B in enumerate(arm.T_target_base):
        block = _block(arm.layout.base(target), free, covariance)
        if block is None:
            found.append(None)
            continue
        back = invert(B)[:3, :3]
        J = np.zeros((6, 6))
        J[:3, :3] = J[3:, 3:] = -back
        J[:3, 3:] = -back @ hat(B[:3, 3])
        found.append(np.asarray(J @ block @ J.T))
    return tuple(found)


def _block(
    columns: slice, free: Bool[np.ndarray, " p"], covariance: Float[np.ndarray, "f f"]
) -> Float[np.ndarray, "6 6"] | None:
    if not free[columns].all():
        return None
    places = np.cumsum(free)[columns] - 1
    return covariance[np.ix_(places, places)]
