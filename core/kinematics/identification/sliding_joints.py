"""Joints that slide, found by positions: a stated value moves the measured point along a line, and turns nothing.

With joint j at rest, base and tool of the nominal robot leave of position i

    R_i c v_i

v the joint's value, R_i the orientation of the frame before joint j, c (mm per unit) the same for all poses. c
and the frames are found in turn: each is linear, or nearly, given the other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from core.errors import PrismaticJoint
from core.kinematics.arm_model import ArmState
from core.kinematics.dh import Chain, chain_frames
from core.kinematics.global_fit import Observations, linearised, observations_of, placed
from core.kinematics.nominal_checks import distances, with_fitted_frames
from core.kinematics.pose_observations import PoseData

MAX_POSES = 200
"""Of the positions that are looked at."""
_FAR_BETTER = 0.2
_ROUNDS = 8
_SETTLED = 0.01  # of what is left, between rounds


@dataclass(frozen=True, slots=True)
class _Slide:
    """What a joint that slides leaves of the positions (rms, mm), and how far a unit of its value moves them, mm."""

    left_mm: float
    mm_per_unit: float


def check_sliding(poses: PoseData, nominal: Chain) -> None:
    """Raise PrismaticJoint where the nominal robot explains the positions five times better if one joint slides."""
    seen = _positions(poses)
    parameters = nominal.as_array()
    as_given = distances(with_fitted_frames(_placed(parameters, seen), seen), seen).position_mm
    found = [_slide(parameters, seen, joint) for joint in range(poses.joints)]
    joint = min(range(poses.joints), key=lambda one: found[one].left_mm)
    if found[joint].left_mm < _FAR_BETTER * as_given:
        raise PrismaticJoint(
            f"The nominal robot is off the positions by {as_given:.3g} mm, and by {found[joint].left_mm:.3g} mm if "
            f"joint {joint + 1} slides, by {found[joint].mm_per_unit:.4g} mm for each unit of its value."
        )


def _slide(parameters: Float[np.ndarray, "j 5"], seen: Observations, joint: int) -> _Slide:
    angles = seen.joint_angles.copy()
    value = np.degrees(angles[:, joint])
    value -= value.mean()
    angles[:, joint] = 0.0
    at_rest = replace(seen, joint_angles=angles)
    orientations = chain_frames(parameters, angles)[:, joint, :3, :3]
    moved, c = np.zeros_like(seen.positions_mm), np.zeros(3)
    arm, left = _placed(parameters, at_rest), math.inf
    for _ in range(_ROUNDS):
        without = replace(at_rest, positions_mm=seen.positions_mm - moved)
        arm = with_fitted_frames(arm, without)
        rest = linearised(arm, without)[0].T + moved
        A = value[:, None, None] * (arm.T_target_base[seen.target, :3, :3] @ orientations)
        c = np.linalg.lstsq(A.reshape(-1, 3), rest.ravel())[0]
        moved = A @ c
        now = math.sqrt(float(np.mean(np.sum((rest - moved) ** 2, axis=1))))
        if now > (1.0 - _SETTLED) * left:
            break
        left = now
    return _Slide(min(left, now), float(np.linalg.norm(c)))


def _positions(poses: PoseData) -> Observations:
    """Return positions alone, of some of the poses where there are many."""
    count = min(len(poses), MAX_POSES)
    seen = observations_of(poses).take(np.linspace(0, len(poses) - 1, count).round().astype(np.intp))
    return replace(seen, rotations=None, own=np.zeros((count, 3, 3)), common=np.zeros((count, 3, 0)))


def _placed(parameters: Float[np.ndarray, "j 5"], seen: Observations) -> ArmState:
    """Return the chain at base and tool in closed form."""
    T_base_flange = np.ascontiguousarray(chain_frames(parameters, seen.joint_angles)[:, -1])
    return placed(parameters, T_base_flange, seen)
