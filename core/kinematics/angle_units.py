"""Do joint angles and measured poses tell of the same turns: radians given for degrees, joints that do not turn."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from core.errors import DegenerateGeometry, JointAnglesInconsistent, JointAnglesUnit, PrismaticJoint
from core.kinematics.circle import fit_circle
from core.kinematics.poses import PoseData
from core.kinematics.sweeps import Sweep

_WITHIN = 0.2  # relative: a measured turn that differs by more is not this joint's
_STILL = 0.1  # of the joint's angle: a smaller turn is none
_RADIANS = 180.0 / math.pi
_LARGEST_RADIAN = 2.0 * math.pi * math.pi / 180.0  # 2 π taken for degrees, in rad
_PAIRS = 500
_MOVED_MM = 1.0  # positions that move less may be on the axis


def check_angles(poses: PoseData, sweeps: Sequence[Sweep]) -> None:
    """Compare the turns of the joints with those that were measured.

    Raises JointAnglesUnit where the angles are in another unit, PrismaticJoint where poses move along a line while a
    joint's value changes, JointAnglesInconsistent where the turns differ otherwise.
    """
    ratios: dict[int, float] = {}
    for sweep in sweeps:
        ratio = _turn_ratio(poses, sweep)
        if ratio is not None:
            # The first sweep of a joint has most poses.
            ratios.setdefault(sweep.joint, ratio)
    small = bool(np.all(np.abs(poses.joint_angles) < _LARGEST_RADIAN))
    if small and (_like(list(ratios.values()), _RADIANS) or (not ratios and _turned_further(poses))):
        raise JointAnglesUnit(
            "The joint angles are all below 2π as degrees, while the poses turned by far more: they look like radians."
        )
    if _like(list(ratios.values()), 1.0 / _RADIANS):
        raise JointAnglesUnit(
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
    """Return by how much more the poses turn than the joint, of neighbouring angles; None where that cannot be told."""
    moves = np.diff(sweep.angles)
    apart = moves > 0.02 * sweep.arc
    if poses.rotations is not None:
        R = poses.rotations[sweep.poses]
        turns = np.asarray(Rotation.from_matrix(R[1:] @ R[:-1].swapaxes(1, 2)).magnitude())
    elif float(np.linalg.norm(np.ptp(poses.positions_mm[sweep.poses], axis=0))) < _MOVED_MM:
        return None
    else:
        turns = _turns_on_circle(poses.positions_mm[sweep.poses])
    return float(np.median(turns[apart] / moves[apart])) if apart.any() else None


def _turns_on_circle(positions: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " k"]:
    """Return the angles between neighbours on the circle through all of them; zero where they are on a line."""
    chords = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    try:
        radius = fit_circle(positions).radius
    except DegenerateGeometry:
        return np.zeros_like(chords)
    return np.asarray(2.0 * np.arcsin(np.minimum(chords / (2.0 * radius), 1.0)))


def _turned_further(poses: PoseData) -> bool:
    """Tell whether most pairs of poses differ by more rotation than all joints' turns together could make."""
    if poses.rotations is None or len(poses) < 2:
        return False
    rng = np.random.default_rng(0)
    a, b = rng.integers(0, len(poses), (2, _PAIRS))
    a, b = a[a != b], b[a != b]
    turns = Rotation.from_matrix(poses.rotations[a] @ poses.rotations[b].swapaxes(1, 2)).magnitude()
    possible = np.abs(poses.joint_angles[a] - poses.joint_angles[b]).sum(axis=1)
    return bool(np.mean(turns > possible + math.radians(1.0)) > 0.5)
