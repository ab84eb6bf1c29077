"""Consistency of joint angles with measured poses: radians given as degrees, metres as mm, joints that do not turn.

`check_angles` compares them joint by joint, from sweeps, for any robot. `check_against_nominal` is for poses at which
all joints moved: the nominal robot explains them far better with angles or lengths in another unit, or with one joint
at rest.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation
from scipy.special import fdtri

from core.errors import (
    DegenerateGeometry,
    JointAnglesInconsistent,
    JointAnglesUnitMismatch,
    LengthsUnitMismatch,
    PrismaticJoint,
)
from core.kinematics.arm_model import ArmState
from core.kinematics.dh import Chain, forward
from core.kinematics.global_fit import Observations, fit_frames, linearised, observations_of, placed
from core.kinematics.joint_axes import fit_circle
from core.kinematics.pose_observations import PoseData
from core.kinematics.sweeps import Sweep
from core.numerics import Variances

_WITHIN = 0.2  # relative: a measured turn that differs by more is not this joint's
_STILL = 0.1  # of the joint's angle: a smaller turn counts as no turn
_RADIANS = 180.0 / math.pi
_LARGEST_RADIAN = 2.0 * math.pi * math.pi / 180.0  # 2 π taken for degrees, in rad
_PAIRS = 500
NEAR = 0.02
"""Of the positions' extent, and rad: a nominal robot whose misfit is smaller is taken to be this robot."""
_FAR_BETTER = 0.2
_MM_PER_M = 1000.0
_CIRCLE_PARAMETERS = 7  # four within its plane, three of the plane
_BY_CHANCE = 0.999
_LINE = 0.01  # a ratio with which an arc is a line
_MOVED_MM = 1.0  # positions that move less may be on the axis


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
    small = bool(np.all(np.abs(poses.joint_angles) < _LARGEST_RADIAN))
    if small and (_like(list(ratios.values()), _RADIANS) or (not ratios and _turned_further(poses))):
        raise JointAnglesUnitMismatch(
            "The joint angles are all below 2π as degrees, while the poses turned by far more: they look like radians."
        )
    if _like(list(ratios.values()), 1.0 / _RADIANS):
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


def check_against_nominal(poses: PoseData, nominal: Chain) -> None:
    """Compare what the nominal robot makes of the poses with what it makes of them otherwise.

    Nothing is asked of poses that it explains to `NEAR`, or that it explains no better otherwise.

    Raises LengthsUnitMismatch, and JointAnglesUnitMismatch and PrismaticJoint as `check_angles` does.
    """
    seen, q = observations_of(poses), poses.joint_angles
    as_given = _fitted_misfit(nominal, q, seen)
    extent = float(np.linalg.norm(np.ptp(poses.positions_mm, axis=0)))
    if as_given.position_mm < NEAR * extent and as_given.rotation < NEAR:
        return
    for factor, words in (
        (_MM_PER_M, "the positions look like metres"),
        (1.0 / _MM_PER_M, "the nominal robot's lengths look like metres"),
    ):
        scaled = replace(seen, positions_mm=factor * seen.positions_mm)
        if (
            _fitted_misfit(nominal, q, scaled).position_mm
            < _FAR_BETTER * min(factor, 1.0) * as_given.position_mm
        ):
            raise LengthsUnitMismatch(
                f"The nominal robot is off the poses by {as_given.position_mm:.3g} mm, which extend over {extent:.3g} "
                f"mm, and hardly if one of them is in another unit: {words}.",
                "Give both in millimetres.",
            )
    largest = float(np.abs(q).max())
    for factor, possible, words in (
        (_RADIANS, largest < _LARGEST_RADIAN, "the joint angles look like radians, taken for degrees"),
        (1.0 / _RADIANS, largest > math.pi, "the joint angles look like degrees, taken for radians"),
    ):
        other = _fitted_misfit(nominal, factor * q, seen) if possible else as_given
        if other.position_mm < _FAR_BETTER * as_given.position_mm:
            raise JointAnglesUnitMismatch(
                f"The nominal robot is off the poses by {as_given.position_mm:.3g} mm, and by {other.position_mm:.3g} "
                f"mm if the angles are in the other unit: {words}.",
                "Give the joint angles in the unit that is asked for: degrees over HTTP.",
            )
    if seen.rotations is None or as_given.rotation < NEAR:
        return
    for joint in range(poses.joints):
        at_rest = q.copy()
        at_rest[:, joint] = 0.0
        other = _fitted_misfit(nominal, at_rest, seen)
        if other.rotation < _FAR_BETTER * as_given.rotation:
            raise PrismaticJoint(
                f"The nominal robot turns {math.degrees(as_given.rotation):.3g}° away from the poses, and "
                f"{math.degrees(other.rotation):.3g}° if joint {joint + 1} does not turn at all: it is a sliding "
                "joint, or its angle is another joint's."
            )


@dataclass(frozen=True, slots=True)
class Misfit:
    """Root mean square distances of poses from a robot, mm and rad."""

    position_mm: float
    rotation: float


def misfit(chain: Chain, q: Float[np.ndarray, "n j"], seen: Observations) -> Misfit:
    """Return the rms distances of poses from a chain, base and tool in closed form; rotation 0 where none is known."""
    at = replace(seen, joint_angles=q)
    return _distances(placed(chain.as_array(), forward(chain, q), at), at)


def _fitted_misfit(chain: Chain, q: Float[np.ndarray, "n j"], seen: Observations) -> Misfit:
    """Return `misfit`, with base and tool fitted where the closed form is far off: it has no unique answer where all
    axes are parallel.
    """
    at, parameters = replace(seen, joint_angles=q), chain.as_array()
    arm = placed(parameters, forward(chain, q), at)
    found = _distances(arm, at)
    extent = float(np.linalg.norm(np.ptp(seen.positions_mm, axis=0)))
    if found.position_mm < NEAR * extent and found.rotation < NEAR:
        return found
    free = np.any(linearised(arm, at)[1] != 0.0, axis=(1, 2))  # positions say nothing of the tool's rotation
    fitted = _distances(fit_frames(parameters, arm, at, free, Variances(extent**2, 1.0)), at)
    return min(found, fitted, key=lambda one: one.position_mm)


def _distances(arm: ArmState, seen: Observations) -> Misfit:
    residuals = linearised(arm, seen)[0]
    position, rotation = residuals[:3], residuals[3:]
    return Misfit(
        math.sqrt(float(np.mean(np.sum(position**2, axis=0)))),
        math.sqrt(float(np.mean(np.sum(rotation**2, axis=0)))) if len(rotation) else 0.0,
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
        turns = np.asarray(Rotation.from_matrix(R[1:] @ R[:-1].swapaxes(1, 2)).magnitude())
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
    turns = Rotation.from_matrix(poses.rotations[a] @ poses.rotations[b].swapaxes(1, 2)).magnitude()
    possible = np.abs(poses.joint_angles[a] - poses.joint_angles[b]).sum(axis=1)
    return bool(np.mean(turns > possible + math.radians(1.0)) > 0.5)
