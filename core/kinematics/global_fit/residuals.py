"""Residuals of poses at an arm, whitened by the covariance of their noise.

Of pose i with covariance C_i of the instrument and S of the robot's own scatter, V_i = C_i + S = L Lᵀ, the residual
L⁻¹ (p - p̂, log(R R̂ᵀ)) is a vector of independent unit normals. Positions come first, so that its first three are the
position's by itself, and its last three what the rotation says beyond that: two points of three components each, of
which either may be a gross error.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from core.errors import InvalidArgument
from core.geometry import rotation_vectors
from core.jit import jit
from core.kinematics.arm_model import ArmState, ParameterLayout
from core.kinematics.dh import pose_with_jacobian
from core.kinematics.pose_observations import PoseData
from core.numerics import Variances, weights

INDEFINITE = 1e-7
"""Of the unit diagonal: an eigenvalue of a correlation matrix may be so far below zero by rounding."""


@dataclass(frozen=True, slots=True)
class Observations:
    """Poses made ready: `own` is C (zero where unknown), `common` the shared errors' factors, both of m components, 6
    or 3 for positions alone; `approach` as of `PoseData`.
    """

    joint_angles: Float[np.ndarray, "n j"]
    positions_mm: Float[np.ndarray, "n 3"]
    rotations: Float[np.ndarray, "n 3 3"] | None
    own: Float[np.ndarray, "n m m"]
    common: Float[np.ndarray, "n m k"]
    target: Int[np.ndarray, " n"]
    approach: Float[np.ndarray, "n j"] | None = None

    def __len__(self) -> int:
        return len(self.positions_mm)

    @property
    def components(self) -> int:
        return int(self.own.shape[1])

    @property
    def layout(self) -> ParameterLayout:
        return ParameterLayout(
            self.joint_angles.shape[1], int(self.target.max(initial=0)) + 1, int(self.common.shape[2])
        )

    def take(self, poses: Int[np.ndarray, " q"]) -> Observations:
        """Return these poses alone; the targets keep their numbers."""
        return Observations(
            self.joint_angles[poses],
            self.positions_mm[poses],
            None if self.rotations is None else self.rotations[poses],
            self.own[poses],
            self.common[poses],
            self.target[poses],
            None if self.approach is None else self.approach[poses],
        )


def observations_of(poses: PoseData) -> Observations:
    """Make poses ready.

    Raises InvalidArgument, naming the pose, for a matrix that is no covariance.
    """
    m, n = (3 if poses.rotations is None else 6), len(poses)
    own = np.zeros((n, m, m)) if poses.covariance is None else _definite(poses, m)
    common = np.zeros((n, m, 0)) if poses.common is None else poses.common[:, :m]
    return Observations(
        np.ascontiguousarray(poses.joint_angles, dtype=np.float64),
        poses.positions_mm,
        poses.rotations,
        own,
        common,
        np.asarray(poses.targets),
        poses.approach,
    )


def _definite(poses: PoseData, m: int) -> Float[np.ndarray, "n m m"]:
    """Return the covariances, symmetric and definite by a hair where they are not to rounding."""
    assert poses.covariance is not None
    given = poses.covariance[:, :m, :m]
    own = 0.5 * (given + given.transpose(0, 2, 1))
    unit = 1.0 / np.sqrt(np.diagonal(own, axis1=1, axis2=2))
    least = np.linalg.eigvalsh(own * unit[:, :, None] * unit[:, None, :])[:, 0]
    if np.any(least < -INDEFINITE):
        label = poses.label(int(np.argmin(least)))
        raise InvalidArgument(
            f"Pose {label} has a matrix that is no covariance.", "Correct it, or leave it out."
        )
    return own + 2.0 * INDEFINITE * own * np.eye(m)


def linearised(
    arm: ArmState, seen: Observations
) -> tuple[Float[np.ndarray, "m n"], Float[np.ndarray, "p m n"]]:
    """Return observed - predicted of every pose, and the derivatives of the prediction by all columns of the layout."""
    layout, m = arm.layout, seen.components
    end, local = pose_with_jacobian(
        arm.parameters, seen.joint_angles, arm.T_target_base[seen.target], arm.T_flange_camera
    )
    J = local[:, :m]
    if layout.targets > 1 or layout.shared:
        base = layout.tool.stop
        J = np.zeros((layout.size, m, len(seen)))
        J[:base] = local[:base, :m]
        for target in range(layout.targets):
            of_target = seen.target == target
            if of_target.all():
                J[layout.base(target)] = local[base:, :m]
            else:
                J[layout.base(target)] = local[base:, :m] * of_target
        J[layout.kinematic :] = np.moveaxis(seen.common, 2, 0).swapaxes(1, 2)
    r = np.empty((m, len(seen)))
    r[:3] = (seen.positions_mm - end[:, :3, 3]).T
    if seen.rotations is not None:
        r[3:] = rotation_vectors(seen.rotations, end[:, :3, :3]).T
    if layout.shared:
        r -= np.einsum("nmk,k->mn", seen.common, arm.shared)
    return r, J


def whitener(seen: Observations, scatter: Variances) -> Float[np.ndarray, "m m n"]:
    """Return L⁻¹ of every pose, lower triangular."""
    return np.ascontiguousarray(np.moveaxis(weights(seen.own, scatter), 0, -1))


def whitened(
    W: Float[np.ndarray, "m m n"], values: Float[np.ndarray, "*p m n"]
) -> Float[np.ndarray, "*p m n"]:
    """Return L⁻¹ x for x along the axis before the last."""
    shape = (math.prod(values.shape[:-2]), *values.shape[-2:])
    every = np.ascontiguousarray(values, dtype=np.float64).reshape(shape)
    return np.asarray(multiplied_lower(np.ascontiguousarray(W), every).reshape(values.shape))


@jit("f8[:, :, ::1], f8[:, :, ::1]")
def multiplied_lower(
    W: Float[np.ndarray, "m m n"], values: Float[np.ndarray, "p m n"]
) -> Float[np.ndarray, "p m n"]:
    """Return W x for x along the middle axis, with W lower triangular; poses run along the last axis."""
    columns, m, n = values.shape
    result = np.empty((columns, m, n))
    for p in range(columns):
        for a in range(m):
            for i in range(n):
                result[p, a, i] = W[a, 0, i] * values[p, 0, i]
            for b in range(1, a + 1):
                for i in range(n):
                    result[p, a, i] += W[a, b, i] * values[p, b, i]
    return result


def as_points(values: Float[np.ndarray, "*p m n"]) -> Float[np.ndarray, "*p 3 q"]:
    """Return position and rotation parts as points of three components: the n positions, then the n rotations."""
    if values.shape[-2] == 3:
        return values
    return np.concatenate([values[..., :3, :], values[..., 3:, :]], axis=-1)
