"""Corrected joint angles: the identified arm is brought to where the nominal one was meant to be.

    min |meant ⊖ attained(q)|² / σ² + |q - q_commanded|² / s²

σ is a hundredth of a millimetre, and for rotations what moves `LEVER_MM` by as much; s half a degree, ten times less as
often as a joint would turn by more than `MAX_CORRECTION`. Away from singularities the second term shifts the end by
nanometres. Near one, where a rotation could be had only by turning joints far against one another, it leaves that
rotation, and what is left counts in the expected error; a command that is nearer as it was stays. An arm with too few
axes for all six components leaves some everywhere, mostly of the rotation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from jaxtyping import Bool, Float

from core.geometry import rotation_vectors
from core.kinematics.correction.components import (
    CorrectableComponents,
    correctable_components,
    end_jacobians,
    singular,
)
from core.kinematics.correction.model import CorrectionModel
from core.kinematics.dh import forward
from core.kinematics.error_model import Level

MAX_CORRECTION = math.radians(2.0)
"""Of a joint: more is no error of a robot but a pose near a singularity, or a robot that is not this one."""
LEVER_MM = 100.0
"""Where a whole pose cannot be attained, a rotation counts as what it moves so far away."""
_TOLERANCE_MM = 0.01
_JOINT_SCALE = math.radians(0.5)
_LEAST_MM = _TOLERANCE_MM / _JOINT_SCALE
"""By how much the end moves per rad of the joints in a direction in which more than half of an error is left."""
_ITERATIONS = 6
_STIFFENINGS = 3


class Outcome(StrEnum):
    """What was done with a command."""

    CORRECTED = "corrected"
    OUTSIDE_REGION = "outside_region"
    IN_GAP = "in_gap"
    NEAR_SINGULARITY = "near_singularity"
    BEYOND_LIMITS = "beyond_limits"
    TOO_FAR = "too_far"

    @property
    def applied(self) -> bool:
        """Whether the command was changed."""
        return self in (Outcome.CORRECTED, Outcome.IN_GAP, Outcome.NEAR_SINGULARITY)


@dataclass(frozen=True, slots=True)
class Corrected:
    """Corrected commands; those that are not `applied` are as they were given.

    Parameters
    ----------
    joint_angles
        Rad.
    T_base_flange
        What the controller has to command for these angles: its own model there, in its own base.
    outcomes
        For each command. With a joint in a gap of its region, or near a singularity, it is corrected with less
        certainty.
    shift
        How far the end would be off without the correction: mm, and rad.
    expected
        Expected length of the error that is left: mm, and rad where rotations were measured. Of a command that is not
        corrected it is not known.
    left
        The part of it that these joints do not correct: mm, and rad.
    components
        What they correct where no singularity is near.
    """

    joint_angles: Float[np.ndarray, "n j"]
    T_base_flange: Float[np.ndarray, "n 4 4"]
    outcomes: tuple[Outcome, ...]
    shift: Float[np.ndarray, "2 n"]
    expected: Float[np.ndarray, "k n"]
    left: Float[np.ndarray, "2 n"]
    components: CorrectableComponents

    @property
    def applied(self) -> Bool[np.ndarray, " n"]:
        """Which commands were changed."""
        return np.array([outcome.applied for outcome in self.outcomes], dtype=np.bool_)


def correct(
    by: CorrectionModel,
    joint_angles: Float[np.ndarray, "n j"],
    limits: Float[np.ndarray, "2 j"] | None = None,
    coupling: Float[np.ndarray, "j j"] | None = None,
) -> Corrected:
    """Return commands at which the identified arm is where the nominal one is meant to be.

    Parameters
    ----------
    joint_angles
        Of the chain, rad: `coupling` times those that the controller would command, or these themselves.
    limits
        Of the commanded angles, least and greatest, rad; infinite where unknown. A corrected command stays within.
    """
    meant, measured = by.meant(joint_angles), by.model.fit.design.seen.joint_angles
    components = correctable_components(by.nominal, measured, LEVER_MM, _LEAST_MM)
    q, off = _solved(by, meant, joint_angles, _JOINT_SCALE)
    for stiffer in range(1, _STIFFENINGS + 1):
        far = np.flatnonzero(np.max(np.abs(q - joint_angles), axis=1, initial=0.0) > MAX_CORRECTION)
        if not len(far):
            break
        q[far], off[:, far] = _solved(by, meant[far], joint_angles[far], _JOINT_SCALE / 10.0**stiffer)
    commanded = q if coupling is None else np.linalg.solve(coupling, q.T).T
    beyond = np.zeros(len(q), dtype=np.bool_)
    if limits is not None:
        beyond = np.any((commanded < limits[0]) | (commanded > limits[1]), axis=1)
    left, shift = _lengths(off), _lengths(_difference(meant, by.attained(joint_angles)))
    # Near a singularity a rotation may cost more of the position than it is worth.
    rest = np.hypot(left[0], LEVER_MM * left[1])
    worse = (rest > np.hypot(shift[0], LEVER_MM * shift[1])) | (left[0] > shift[0])
    worse &= rest > _TOLERANCE_MM
    off[3:] *= LEVER_MM
    near = singular(end_jacobians(by.nominal, q, LEVER_MM), off, components.rank, _LEAST_MM, _TOLERANCE_MM)
    near &= rest > _TOLERANCE_MM
    outcomes: list[Outcome] = []
    for i, (asked, found) in enumerate(zip(joint_angles, q, strict=True)):
        place = _place(by, asked)
        if place is Outcome.OUTSIDE_REGION:
            outcomes.append(place)
        elif worse[i] or np.max(np.abs(found - asked)) > MAX_CORRECTION:
            outcomes.append(Outcome.TOO_FAR)
        elif beyond[i]:
            outcomes.append(Outcome.BEYOND_LIMITS)
        elif near[i]:
            outcomes.append(Outcome.NEAR_SINGULARITY)
        else:
            outcomes.append(place)
    applied = np.array([outcome.applied for outcome in outcomes], dtype=np.bool_)
    angles = np.where(applied[:, None], q, joint_angles)
    expected = by.deviations(angles)
    expected = np.hypot(expected, left[: len(expected)])
    expected[:, ~applied] = np.nan
    flange = forward(by.nominal.chain, angles)
    return Corrected(angles, flange, tuple(outcomes), shift, expected, left, components)


def _solved(
    by: CorrectionModel,
    meant: Float[np.ndarray, "n 4 4"],
    joint_angles: Float[np.ndarray, "n j"],
    joint_scale: float,
) -> tuple[Float[np.ndarray, "n j"], Float[np.ndarray, "6 n"]]:
    """Return the joint angles, and by what the end is still off (mm, rad)."""
    q, joints = joint_angles.copy(), joint_angles.shape[1]
    unit = np.array([1.0] * 3 + [LEVER_MM] * 3) / _TOLERANCE_MM
    for _ in range(_ITERATIONS):
        off = _difference(meant, by.attained(q)) * unit[:, None]
        rows = end_jacobians(by.nominal, q, LEVER_MM) / _TOLERANCE_MM
        columns_of = rows.transpose(0, 2, 1)
        normal = columns_of @ rows + np.eye(joints) / joint_scale**2
        right = (columns_of @ off.T[:, :, None])[..., 0] - (q - joint_angles) / joint_scale**2
        q = q + np.linalg.solve(normal, right[..., None])[..., 0]
    return q, _difference(meant, by.attained(q))


def _lengths(off: Float[np.ndarray, "6 n"]) -> Float[np.ndarray, "2 n"]:
    return np.stack([np.linalg.norm(off[:3], axis=0), np.linalg.norm(off[3:], axis=0)])


def _difference(
    meant: Float[np.ndarray, "n 4 4"], attained: Float[np.ndarray, "n 4 4"]
) -> Float[np.ndarray, "6 n"]:
    turned = rotation_vectors(meant[:, :3, :3], attained[:, :3, :3])
    return np.concatenate([(meant[:, :3, 3] - attained[:, :3, 3]).T, turned.T])


def _place(by: CorrectionModel, q: Float[np.ndarray, " j"]) -> Outcome:
    """Return whether these joint angles are inside the region, in a gap (which matters to curves alone), or outside."""
    inside = Outcome.CORRECTED
    for joint, angle in zip(by.region, q.tolist(), strict=True):
        if not joint.minimum <= angle <= joint.maximum:
            return Outcome.OUTSIDE_REGION
        if by.level is Level.ALL and any(low < angle < high for low, high in joint.gaps):
            inside = Outcome.IN_GAP
    return inside
