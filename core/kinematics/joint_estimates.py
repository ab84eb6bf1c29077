"""What is known of every joint: its parameters with their doubt, its arc, and the residuals of its sweeps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from core.kinematics.dh import JOINT_PARAMETERS, Chain, JointParameters
from core.kinematics.identifiability import Gauge
from core.kinematics.parameters import ArmState
from core.kinematics.poses import PoseData
from core.kinematics.refinement import Refined
from core.kinematics.sweeps import find_sweeps
from core.kinematics.validation import HeldOut, rms


@dataclass(frozen=True, slots=True)
class JointEstimate:
    """One joint, counted from 1. The mappings have the names of `JOINT_PARAMETERS`; an uncertainty is None where the
    parameter is not identifiable, and the parameter then has the nominal's value, or zero. `arc_rad` is the range of
    the joint's angles. `poses` are those of its sweeps and `residual` theirs; all poses where it has none.
    """

    joint: int
    parameters: JointParameters
    standard_uncertainty: Mapping[str, float | None]
    identifiable: Mapping[str, bool]
    nominal: JointParameters | None
    parallel_to_next: bool
    arc_rad: float
    poses: int
    residual: HeldOut | None


def joint_estimates(
    arm: ArmState,
    gauge: Gauge,
    covariance: Float[np.ndarray, "f f"],
    nominal: Chain | None,
    joint_angles: Float[np.ndarray, "n j"],
) -> tuple[JointEstimate, ...]:
    """Return what is known of every joint; `covariance` is of the free columns."""
    layout, chain = arm.layout, arm.chain
    sigma = np.full(layout.kinematic, np.nan)
    sigma[np.flatnonzero(gauge.free)] = np.sqrt(np.diag(covariance))
    joints = []
    for i in range(layout.joints):
        doubt: dict[str, float | None] = {}
        for k, name in enumerate(JOINT_PARAMETERS):
            column = layout.column(i, k)
            doubt[name] = float(sigma[column]) if gauge.free[column] else None
        joints.append(
            JointEstimate(
                joint=i + 1,
                parameters=chain.joints[i],
                standard_uncertainty=doubt,
                identifiable={name: value is not None for name, value in doubt.items()},
                nominal=None if nominal is None else nominal.joints[i],
                parallel_to_next=bool(gauge.parallel[i]),
                arc_rad=float(np.ptp(joint_angles[:, i])),
                poses=len(joint_angles),
                residual=None,
            )
        )
    return tuple(joints)


def with_residuals(
    joints: tuple[JointEstimate, ...], refined: Refined, poses: PoseData
) -> tuple[JointEstimate, ...]:
    """Return the joints with the residuals at the poses of their sweeps; at all poses where there are none."""
    members: list[set[int]] = [set() for _ in joints]
    for sweep in find_sweeps(poses):
        members[sweep.joint].update(i for i in sweep.poses.tolist() if refined.used[i])
    everything = np.flatnonzero(refined.used)
    found = []
    for joint, of_sweeps in zip(joints, members, strict=True):
        chosen = np.array(sorted(of_sweeps), dtype=np.intp) if of_sweeps else everything
        found.append(replace(joint, poses=len(chosen), residual=rms(refined.residuals[:, chosen])))
    return tuple(found)
