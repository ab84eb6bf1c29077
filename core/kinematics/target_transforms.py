"""Transforms between targets, by way of the robot's base, with covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from core.geometry import hat, invert
from core.kinematics.arm_model import ArmState


@dataclass(frozen=True, slots=True)
class TargetTransform:
    """T_from_to with its covariance: position (mm), then a rotation from the left (rad), in the frame of `from_target`;
    `poses` were measured from `to_target`.
    """

    from_target: int
    to_target: int
    T_from_to: Float[np.ndarray, "4 4"]
    covariance: Float[np.ndarray, "6 6"]
    poses: int


def target_transforms(
    arm: ArmState,
    free: Bool[np.ndarray, " p"],
    covariance: Float[np.ndarray, "f f"],
    target: Int[np.ndarray, " n"],
) -> tuple[TargetTransform, ...]:
    """Return the transform from the first target that was seen to every other; `covariance` is of the `free` columns.

    With T = B_0 B_t⁻¹ (0 the first), R its rotation and (d, w) changes of either base: w' = w_0 - R w_t and
    p' = d_0 - w' × (R p_t) - R d_t, where p_t is base t's position.
    """
    layout = arm.layout
    full = np.zeros((layout.kinematic, layout.kinematic))
    columns = np.flatnonzero(free[: layout.kinematic])
    full[np.ix_(columns, columns)] = covariance
    found = []
    first, *others = (int(t) for t in np.unique(target))
    for t in others:
        T = arm.T_target_base[first] @ invert(arm.T_target_base[t])
        R = T[:3, :3]
        J = np.zeros((6, 12))
        J[3:, 3:6], J[3:, 9:] = np.eye(3), -R
        J[:3] = hat(R @ arm.T_target_base[t, :3, 3]) @ J[3:]
        J[:3, :3] += np.eye(3)
        J[:3, 6:9] -= R
        where = [
            *range(*layout.base(first).indices(layout.size)),
            *range(*layout.base(t).indices(layout.size)),
        ]
        found.append(
            TargetTransform(first, t, T, J @ full[np.ix_(where, where)] @ J.T, int(np.sum(target == t)))
        )
    return tuple(found)
