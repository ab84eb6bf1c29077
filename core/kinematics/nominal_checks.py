"""Consistency of poses with the nominal robot: other units, a mirrored frame, joints that rest or count the other way.

For poses at which all joints moved: the nominal robot explains them far better otherwise than as they were given. Base
and tool are fitted each time, so that nothing is asked of how the instrument stands.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from jaxtyping import Float

from core.errors import (
    FrameMirrored,
    JointAnglesUnitMismatch,
    JointSignReversed,
    LengthsUnitMismatch,
    PrismaticJoint,
    listed,
)
from core.kinematics.arm_model import ArmState
from core.kinematics.dh import Chain, forward
from core.kinematics.global_fit import Observations, fit_frames, linearised, observations_of, placed
from core.kinematics.joint_angle_checks import LARGEST_RADIAN, RADIANS
from core.kinematics.pose_observations import PoseData
from core.numerics import Variances

NEAR = 0.02
"""Of the positions' extent, and rad: a nominal robot whose misfit is smaller is taken to be this robot."""
_EXPLAINED = 0.002
"""Of the positions' extent: with less and rotations `NEAR`, nothing else is tried. Positions at a short lever from a
joint that counts the other way are off by less than `NEAR`."""
_FAR_BETTER = 0.2
_AS_GOOD = 2.0
"""Times the misfit of the best: another joint's sign that explains the poses so well is named, too."""
_EQUATIONS = 36
"""Of poses whose signs are searched for: base and tool take twelve unknowns."""
_UNITS_MM = {"metres": 1000.0, "inches": 25.4, "centimetres": 10.0}
_MIRROR = np.array([-1.0, 1.0, 1.0])
"""One axis turned round: any other mirror is this one and a rotation, which the base takes."""


def check_against_nominal(poses: PoseData, nominal: Chain) -> None:
    """Compare what the nominal robot makes of the poses with what it makes of them otherwise.

    Nothing is asked of poses that it explains well, or that it explains no better otherwise.

    Raises LengthsUnitMismatch, FrameMirrored where the mirror image of the positions is far nearer,
    JointAnglesUnitMismatch and PrismaticJoint as `check_angles` does, and JointSignReversed.
    """
    seen, q = observations_of(poses), poses.joint_angles
    as_given = _fitted_misfit(nominal, q, seen)
    extent = float(np.linalg.norm(np.ptp(poses.positions_mm, axis=0)))
    if as_given.position_mm < _EXPLAINED * extent and as_given.rotation < NEAR:
        return
    _check_lengths(nominal, seen, as_given, extent)
    one_sign = _signs(nominal, seen, as_given, extent, 1)
    if not one_sign or seen.rotations is None:
        _check_handedness(nominal, poses, min((m.position_mm for m in one_sign.values()), default=math.inf))
    _check_angle_unit(nominal, seen, as_given)
    for count in range(1, poses.joints + 1):
        found = one_sign if count == 1 else _signs(nominal, seen, as_given, extent, count)
        if found:
            raise _reversed(found, as_given, extent)
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


def _check_lengths(nominal: Chain, seen: Observations, as_given: Misfit, extent: float) -> None:
    q = seen.joint_angles
    found: dict[str, float] = {}
    for unit, factor in _UNITS_MM.items():
        for scale, words in (
            (factor, f"the positions look like {unit}"),
            (1.0 / factor, f"the nominal robot's lengths look like {unit}"),
        ):
            scaled = replace(seen, positions_mm=scale * seen.positions_mm)
            left = _fitted_misfit(nominal, q, scaled).position_mm / min(scale, 1.0)
            if left < _FAR_BETTER * as_given.position_mm:
                found[words] = left
    if found:
        raise LengthsUnitMismatch(
            f"The nominal robot is off the poses by {as_given.position_mm:.3g} mm, which extend over {extent:.3g} mm, "
            f"and hardly if one of them is in another unit: {min(found, key=found.__getitem__)}.",
            "Give both in millimetres (`gridpose measured-poses import --length-unit`); images have the unit of the "
            "target's pitch.",
        )


def _check_handedness(nominal: Chain, poses: PoseData, by_sign_mm: float) -> None:
    """Compare with the mirror image of the positions alone: rotations may be mirrored with them, or be right. A joint's
    sign that leaves `by_sign_mm` explains poses better than an image that is farther off.
    """
    q, alone = poses.joint_angles, replace(poses, rotations=None)
    mirrored = replace(alone, positions_mm=_MIRROR * poses.positions_mm)
    as_given, image = (
        _fitted_misfit(nominal, q, observations_of(one)).position_mm for one in (alone, mirrored)
    )
    if image < min(_FAR_BETTER * as_given, _AS_GOOD * by_sign_mm):
        raise FrameMirrored(
            f"The nominal robot is off the positions by {as_given:.3g} mm, and off their mirror image by {image:.3g} "
            "mm: their frame is left-handed."
        )


def _check_angle_unit(nominal: Chain, seen: Observations, as_given: Misfit) -> None:
    q = seen.joint_angles
    largest = float(np.abs(q).max())
    for factor, possible, words in (
        (RADIANS, largest < LARGEST_RADIAN, "the joint angles look like radians, taken for degrees"),
        (1.0 / RADIANS, largest > math.pi, "the joint angles look like degrees, taken for radians"),
    ):
        other = _fitted_misfit(nominal, factor * q, seen) if possible else as_given
        if other.position_mm < _FAR_BETTER * as_given.position_mm:
            raise JointAnglesUnitMismatch(
                f"The nominal robot is off the poses by {as_given.position_mm:.3g} mm, and by {other.position_mm:.3g} "
                f"mm if the angles are in the other unit: {words}.",
                "Give the joint angles in the unit that is asked for: degrees over HTTP.",
            )


def _signs(
    nominal: Chain, seen: Observations, as_given: Misfit, extent: float, count: int
) -> dict[tuple[int, ...], Misfit]:
    """Return the sets of `count` joints that explain the poses where they count the other way, with the misfit then.

    Base and tool are of the closed form, but of parallel axes, where it has no unique answer.
    """
    if len(seen) * seen.components < _EQUATIONS:
        return {}
    joints, found = len(nominal), dict[tuple[int, ...], Misfit]()
    is_parallel = bool(np.all(np.abs(np.sin(nominal.as_array()[:-1, 1])) < NEAR))
    how = _fitted_misfit if is_parallel else misfit
    for turned in combinations(range(joints), count):
        signs = np.where(np.isin(np.arange(joints), turned), -1.0, 1.0)
        other = how(nominal, signs * seen.joint_angles, seen)
        if (
            other.position_mm < max(NEAR * extent, _FAR_BETTER * as_given.position_mm)
            and other.rotation < max(NEAR, _FAR_BETTER * as_given.rotation)
            and other.squared(extent) < _FAR_BETTER**2 * as_given.squared(extent)
        ):
            found[turned] = other
    return found


def _reversed(found: dict[tuple[int, ...], Misfit], as_given: Misfit, extent: float) -> JointSignReversed:
    best = min(found, key=lambda joints: found[joints].squared(extent))
    least = found[best].squared(extent)
    others = [
        joints
        for joints, one in found.items()
        if joints != best and one.squared(extent) < _AS_GOOD**2 * least
    ]
    which = _joints_in_words(best)
    also = f" It is as near with {', or '.join(map(_joints_in_words, others))}." if others else ""
    coupling = " ".join(f"--joint-coupling {joint + 1}:{joint + 1}:-1" for joint in best)
    return JointSignReversed(
        f"The nominal robot is off the poses by {as_given}, and by {found[best]} if {which} "
        f"count{'s' if len(best) == 1 else ''} the other way.{also}",
        f"Reverse the sign of the angles of {which} in the poses. If the controller counts so, state it with the "
        f"robot: {coupling} after the joints (`gridpose robots change`, or `create`), or -1 on the diagonal of "
        "joint_coupling. Check the nominal's α, too: a wrong sign of one may look the same.",
    )


def _joints_in_words(joints: tuple[int, ...]) -> str:
    return f"joint{'s' if len(joints) > 1 else ''} {listed([str(joint + 1) for joint in joints])}"


@dataclass(frozen=True, slots=True)
class Misfit:
    """Root mean square distances of poses from a robot, mm and rad."""

    position_mm: float
    rotation: float

    def squared(self, extent: float) -> float:
        """Return the square of both, positions by the extent of the poses (mm)."""
        return (self.position_mm / extent) ** 2 + self.rotation**2

    def __str__(self) -> str:
        turned = f" and {math.degrees(self.rotation):.3g}°" if self.rotation else ""
        return f"{self.position_mm:.3g} mm{turned}"


def misfit(chain: Chain, q: Float[np.ndarray, "n j"], seen: Observations) -> Misfit:
    """Return the rms distances of poses from a chain, base and tool in closed form; rotation 0 where none is known."""
    at = replace(seen, joint_angles=q)
    return distances(placed(chain.as_array(), forward(chain, q), at), at)


def _fitted_misfit(chain: Chain, q: Float[np.ndarray, "n j"], seen: Observations) -> Misfit:
    """Return `misfit`, with base and tool fitted where the closed form is far off: it has no unique answer where all
    axes are parallel.
    """
    at, parameters = replace(seen, joint_angles=q), chain.as_array()
    arm = placed(parameters, forward(chain, q), at)
    found = distances(arm, at)
    extent = float(np.linalg.norm(np.ptp(seen.positions_mm, axis=0)))
    if found.position_mm < _EXPLAINED * extent and found.rotation < NEAR:
        return found
    return min(found, distances(with_fitted_frames(arm, at), at), key=lambda one: one.position_mm)


def with_fitted_frames(arm: ArmState, seen: Observations) -> ArmState:
    """Return the arm with base and tool where they suit the poses best, whatever the poses are off by."""
    free = np.any(
        linearised(arm, seen)[1] != 0.0, axis=(1, 2)
    )  # positions say nothing of the tool's rotation
    extent = float(np.linalg.norm(np.ptp(seen.positions_mm, axis=0)))
    return fit_frames(arm.parameters, arm, seen, free, Variances(extent**2, 1.0))


def distances(arm: ArmState, seen: Observations) -> Misfit:
    """Return the rms distances of poses from an arm; rotation 0 where none is known."""
    residuals = linearised(arm, seen)[0]
    position, rotation = residuals[:3], residuals[3:]
    return Misfit(
        math.sqrt(float(np.mean(np.sum(position**2, axis=0)))),
        math.sqrt(float(np.mean(np.sum(rotation**2, axis=0)))) if len(rotation) else 0.0,
    )
