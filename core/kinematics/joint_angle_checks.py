"""Consistency of joint angles with measured poses, by sweeps: radians given as degrees, joints that do not turn.

Poses at which all joints moved are compared with the nominal robot (`nominal_checks`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.special import fdtri

from core.errors import (
    DegenerateGeometry,
    JointAnglesInconsistent,
    JointAnglesUnitMismatch,
    PrismaticJoint,
)
from core.geometry import rotation_vectors
from core.kinematics.dh import Chain
from core.kinematics.joint_axes import fit_circle
from core.kinematics.pose_observations import PoseData
from core.kinematics.sweeps import Sweep

_WITHIN = 0.2  # relative: a measured turn that differs by more is not this joint's
_STILL = 0.1  # of the joint's angle: a smaller turn counts as no turn
RADIANS = 180.0 / math.pi
"""What radians that were taken for degrees are multiplied by."""
LARGEST_RADIAN = 2.0 * math.pi * math.pi / 180.0
"""2 π taken for degrees, rad."""
_PAIRS = 500
_CIRCLE_PARAMETERS = 7  # four within its plane, three of the plane
_BY_CHANCE = 0.999
_LINE = 0.01  # a ratio with which an arc is a line
_MOVED_MM = 1.0  # positions that move less may be on the axis


def check_joints(poses: PoseData, chain: Chain | None) -> None:
    """Raise JointAnglesInconsistent where a chain has another number of joints than the poses have angles."""
    if chain is not None and len(chain) != poses.joints:
        raise JointAnglesInconsistent(
            f"The poses carry {poses.joints} joint angles and the robot has {len(chain)} joints."
        )


def check_angles(poses: PoseData, sweeps: Sequence[Sweep]) -> None:
    """Compare the turns of the joints with those that were measured.

    Raises JointAnglesUnitMismatch where the angles are in another unit, PrismaticJoint where poses move along a line
    while a joint's value changes, JointAnglesInconsistent where the turns differ otherwise.
    """
    ratios: dict[int, float] = {}
    for sweep in sweeps:
        ratio = _turn_ratio(poses, sweep)
        if ratio is not None:
            # The first sweep of a joint has most poses.
            ratios.setdefault(sweep.joint, ratio)
    small = bool(np.all(np.abs(poses.joint_angles) < LARGEST_RADIAN))
    if small and (_like(list(ratios.values()), RADIANS) or (not ratios and _turned_further(poses))):
        raise JointAnglesUnitMismatch(
            "The joint angles are all below 2π as degrees, while the poses turned by far more: they look like radians."
        )
    if _like(list(ratios.values()), 1.0 / RADIANS):
        raise JointAnglesUnitMismatch(
            "The poses turned 57 times less than the joint angles say: these look like degrees taken for radians.",
            "Give the joint angles in the unit that is asked for.",
        )
    for joint, ratio in sorted(ratios.items()):
        if ratio < _STILL:
            raise PrismaticJoint(
                f"While joint {joint + 1} changes, the measured poses do not turn: it is a sliding joint, or its angle "
                "is another joint's."
            )
        if abs(ratio - 1.0) > _WITHIN:
            raise JointAnglesInconsistent(
                f"In the sweep of joint {joint + 1} the poses turn by {ratio:.3g} times the angle that the joint is "
                "said to turn by.",
                "Check the unit and the order of the joint angles, and that each pose carries its own.",
            )


def _like(ratios: Sequence[float], value: float) -> bool:
    return bool(ratios) and all(abs(ratio / value - 1.0) < _WITHIN for ratio in ratios)


def _turn_ratio(poses: PoseData, sweep: Sweep) -> float | None:
    """Return the ratio of the poses' turns to the joint's, of neighbouring angles; None where it is not determined.

    Positions near the axis hardly leave a short arc's radius determined: where a circle through the angles as they are
    fits them as well as noise has it, they determine no other ratio.
    """
    moves = np.diff(sweep.angles)
    apart = moves > 0.02 * sweep.arc
    if poses.rotations is not None:
        R = poses.rotations[sweep.poses]
        turns = np.linalg.norm(rotation_vectors(R[1:], R[:-1]), axis=1)
    elif float(np.linalg.norm(np.ptp(poses.positions_mm[sweep.poses], axis=0))) < _MOVED_MM:
        return None
    else:
        turns = _turns_on_circle(poses.positions_mm[sweep.poses])
    if not apart.any():
        return None
    ratio = float(np.median(turns[apart] / moves[apart]))
    if poses.rotations is None and abs(ratio - 1.0) > _WITHIN:
        positions = poses.positions_mm[sweep.poses]
        freedom = 3 * len(positions) - _CIRCLE_PARAMETERS
        as_given, otherwise = (_off_circle(positions, by * sweep.angles) for by in (1.0, max(ratio, _LINE)))
        if as_given < fdtri(freedom, freedom, _BY_CHANCE) * otherwise:
            return None
    return ratio


def _off_circle(positions: Float[np.ndarray, "n 3"], angles: Float[np.ndarray, " n"]) -> float:
    """Return the sum of squares (mm²) by which positions are off a circle on which they stand at these angles (rad).

    In the circle's plane, z = c + r exp(± i θ) with complex c and r.
    """
    apart = positions - positions.mean(axis=0)
    u, v, out = (apart @ np.linalg.svd(apart)[2].T).T
    sums = []
    for sign in (1.0, -1.0):
        A = np.column_stack([np.ones(len(angles), dtype=np.complex128), np.exp(1j * sign * angles)])
        left = u + 1j * v - A @ np.linalg.lstsq(A, u + 1j * v, rcond=None)[0]
        sums.append(float(np.sum(np.abs(left) ** 2)))
    return min(sums) + float(out @ out)


def _turns_on_circle(positions: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " k"]:
    """Return the angles between neighbours on the circle through all of them; zero where they are on a line."""
    chords = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    try:
        radius = fit_circle(positions).radius
    except DegenerateGeometry:
        return np.zeros_like(chords)
    return np.asarray(2.0 * np.arcsin(np.minimum(chords / (2.0 * radius), 1.0)))


def _turned_further(poses: PoseData) -> bool:
    """Return whether most pairs of poses differ by more rotation than all joints' turns together could make."""
    if poses.rotations is None or len(poses) < 2:
        return False
    rng = np.random.default_rng(0)
    a, b = rng.integers(0, len(poses), (2, _PAIRS))
    a, b = a[a != b], b[a != b]
    turns = np.linalg.norm(rotation_vectors(poses.rotations[a], poses.rotations[b]), axis=1)
    possible = np.abs(poses.joint_angles[a] - poses.joint_angles[b]).sum(axis=1)
    return bool(np.mean(turns > possible + math.radians(1.0)) > 0.5)
