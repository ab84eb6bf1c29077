"""Which of the six components of an error the joints can correct, and where a singularity takes one of them away.

The Jacobian of the arm's end, with rotations by what they move a lever, has as many singular values of use as its axes
correct components. An arm with fewer than six has fewer everywhere, which is no singularity: there the last of those
that it has elsewhere vanishes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from core.kinematics.arm_model import THETA, ArmState
from core.kinematics.dh import pose_with_jacobian

ALL_COMPONENTS = 6
_POSITION = 3
_SAME_DIRECTION = 0.999
"""Cosine: a direction that varies by less from one configuration to the next is one direction."""


@dataclass(frozen=True, slots=True)
class CorrectableComponents:
    """The components of an error that an arm corrects in regular configurations, position first.

    Parameters
    ----------
    axes
        Joints of the arm.
    position, rotation
        How many of three components each; those of position come first.
    base_axis
        The axis of the robot's base (0: x, 1: y, 2: z) along which positions are not corrected; None where they are
        along all, or where the direction is another from pose to pose.
    """

    axes: int
    position: int
    rotation: int
    base_axis: int | None

    @property
    def rank(self) -> int:
        """How many of the six."""
        return self.position + self.rotation

    @property
    def complete(self) -> bool:
        """Whether these are all six."""
        return self.rank == ALL_COMPONENTS


def correctable_components(
    arm: ArmState, joint_angles: Float[np.ndarray, "n j"], lever_mm: float, least_mm: float
) -> CorrectableComponents:
    """Return the components that the arm corrects at most of these configurations (rad).

    Parameters
    ----------
    lever_mm
        A rotation counts as what it moves so far away.
    least_mm
        Of a direction of use: by how much the end moves in it, per rad of the joints.
    """
    rows = end_jacobians(arm, joint_angles, lever_mm)
    position = _rank(rows[:, :_POSITION], least_mm)
    return CorrectableComponents(
        joint_angles.shape[1],
        position,
        _rank(rows, least_mm) - position,
        _left_axis(arm, rows[:, :_POSITION]) if position == _POSITION - 1 else None,
    )


def end_jacobians(
    arm: ArmState, joint_angles: Float[np.ndarray, "n j"], lever_mm: float
) -> Float[np.ndarray, "n 6 j"]:
    """Return the derivatives of the arm's end by its joints, mm per rad; rotations by what they move the lever."""
    n, joints = joint_angles.shape
    base = np.ascontiguousarray(np.broadcast_to(arm.T_target_base[0], (n, 4, 4)))
    _, J = pose_with_jacobian(arm.parameters, np.ascontiguousarray(joint_angles), base, arm.T_flange_camera)
    unit = np.array([1.0] * 3 + [lever_mm] * 3)
    return np.asarray((J[5 * np.arange(joints) + THETA] * unit[:, None]).transpose(2, 1, 0))


def singular(
    rows: Float[np.ndarray, "n 6 j"],
    left: Float[np.ndarray, "6 n"],
    rank: int,
    least_mm: float,
    tolerance_mm: float,
) -> Bool[np.ndarray, " n"]:
    """Return where a component is left that the arm corrects elsewhere: a singularity is near.

    Parameters
    ----------
    rows
        As of `end_jacobians`.
    left
        The error that remains, mm, rotations by what they move the lever.
    rank
        How many components the arm corrects in regular configurations.
    """
    U, values, _ = np.linalg.svd(rows, full_matrices=False)
    of_the_arm = np.linalg.norm(np.einsum("nik,in->nk", U[:, :, :rank], left), axis=1)
    return np.asarray((of_the_arm > tolerance_mm) | (values[:, rank - 1] < least_mm))


def _rank(rows: Float[np.ndarray, "n m j"], least_mm: float) -> int:
    values = np.linalg.svd(rows, compute_uv=False)
    return int(np.count_nonzero(np.median(values, axis=0) > least_mm))


def _left_axis(arm: ArmState, rows: Float[np.ndarray, "n 3 j"]) -> int | None:
    """Return the axis of the base along which no joint moves the end, at any of the configurations."""
    U = np.linalg.svd(rows, full_matrices=True)[0]
    directions = U[:, :, -1] @ arm.T_target_base[0][:3, :3]
    along = np.median(np.abs(directions), axis=0)
    axis = int(np.argmax(along))
    return axis if along[axis] > _SAME_DIRECTION else None
