"""The methods compared with one another: how far each one's parameters are from those of the global fit, in stated u.

All use the same poses, so that their errors are correlated and differences should be smaller than independent
uncertainties allow. A large difference means that the model of at least one method does not hold: circles that are not
circles, joints that do not come to rest, or geometry that the robot does not have.

Of the methods that use sweeps, the uncertainties take the robot for its chain alone. What gears and compliance do to it
is smooth along a sweep, and looks like geometry: the global fit with all its terms shows whether the poses speak for
them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from core.errors import Advisory, GridposeError
from core.kinematics import (
    JOINT_PARAMETERS,
    STRONG_EVIDENCE,
    Chain,
    ErrorModel,
    Identification,
    JointEstimate,
    Level,
    ModelChoice,
    PoseData,
    Sweep,
    identify,
    identify_from_axes,
    nearest_description,
    with_reversals,
)
from core.session.robot.sweeps import solve_with_start

AXIS_METHODS = ("cpa", "screw", "combined")
MAX_DIFFERENCE = 3.0
"""In stated uncertainties: methods that differ by more contradict one another."""

THETA = JOINT_PARAMETERS.index("theta_offset_rad")
ANGLES = [k for k, name in enumerate(JOINT_PARAMETERS) if name.endswith("_rad")]


@dataclass(frozen=True, slots=True)
class MethodDifference:
    """One method compared with the global fit.

    `largest` is the largest difference of a parameter that both identify, over the root of the sum of both variances;
    `joint` (from 1) and `parameter` say which. All are None where the method, or the global fit, has no answer for
    these poses, and `failure` is the code of the reason.
    """

    method: str
    largest: float | None
    joint: int | None
    parameter: str | None
    failure: str | None


def compare_methods(
    joints: Sequence[JointEstimate],
    poses: PoseData,
    nominal: Chain | None,
    sweeps: Sequence[Sweep],
    tolerance: float,
) -> tuple[MethodDifference, ...]:
    """Return how far `cpa`, `screw` and `combined` are from the `joints` of the global fit.

    Empty where not every joint has a sweep: there is nothing to compare.
    """
    if {sweep.joint for sweep in sweeps} != set(range(len(joints))):
        return ()
    found = []
    for method in AXIS_METHODS:
        try:
            axes = identify_from_axes(poses, nominal, method, sweeps=sweeps, tolerance=tolerance)
        except GridposeError as failure:
            found.append(MethodDifference(method, None, None, None, failure.code))
        except np.linalg.LinAlgError:
            found.append(MethodDifference(method, None, None, None, "degenerate_geometry"))
        else:
            found.append(_difference(method, joints, axes.joints))
    return tuple(found)


def compare_with_global(
    method: str,
    joints: Sequence[JointEstimate],
    poses: PoseData,
    nominal: Chain | None,
    sweeps: Sequence[Sweep],
) -> tuple[MethodDifference, tuple[Advisory, ...]]:
    """Return how far the `joints` of a method that uses sweeps are from those of the global fit with all its terms.

    The warnings say that they disagree, and that the poses speak for terms which the method's uncertainties lack.
    """
    try:
        robot = _with_all_terms(poses, nominal, sweeps)
    except GridposeError as failure:
        return MethodDifference(method, None, None, None, failure.code), ()
    except np.linalg.LinAlgError:
        return MethodDifference(method, None, None, None, "degenerate_geometry"), ()
    found = _difference(method, robot.joints, joints)
    return found, (*disagreements([found]), *_beyond_chain(method, robot.error_model))


def _with_all_terms(poses: PoseData, nominal: Chain | None, sweeps: Sequence[Sweep]) -> Identification:
    """Identify without holding poses out, which takes half of the time: the likelihood says what terms are worth."""
    return solve_with_start(
        lambda start: identify(poses, nominal, start=start, folds=0, model=ModelChoice.EXTENDED),
        poses,
        nominal,
        sweeps,
    )


def _beyond_chain(method: str, model: ErrorModel | None) -> Iterator[Advisory]:
    if model is None:
        return
    levels = model.fit.levels
    gain = levels[Level.DH].minus_2_log - min(fitted.minus_2_log for fitted in levels.values())
    if gain > STRONG_EVIDENCE:
        yield Advisory(
            "terms_beyond_chain",
            f"The poses speak for terms that no chain has, of gears and compliance (gain {gain:.0f} in -2 ln L of the "
            f"global fit). The uncertainties of {method} take the robot for its chain alone, and are too small.",
            "Take method=global with model=auto, whose uncertainties allow for these terms.",
        )


def disagreements(found: Sequence[MethodDifference]) -> Iterator[Advisory]:
    """Yield a warning where a method is beyond `MAX_DIFFERENCE` of the global fit."""
    far = [one for one in found if one.largest is not None and one.largest > MAX_DIFFERENCE]
    if far:
        which = ", ".join(f"{one.method} by {one.largest:.1f}" for one in far)
        yield Advisory(
            "methods_disagree",
            f"Methods differ from the global fit by more than {MAX_DIFFERENCE:g} stated uncertainties: {which}.",
            "The poses contradict a method's model: look for joints that did not rest during a sweep, and for gears "
            "and bending (`error_model`); the global fit with model=auto allows for these.",
        )


def _difference(
    method: str, joints: Sequence[JointEstimate], others: Sequence[JointEstimate]
) -> MethodDifference:
    a, u = _table(joints)
    b, v = _table(others)
    # Where the data decide by a hair between equal descriptions, methods may differ: the same arm is compared.
    tied = np.isnan(v[:-1, THETA]).tolist()
    tied[:1] = [False] * len(tied[:1])  # of the first θ the base takes the turn
    off = a - with_reversals(b, nearest_description(b, a, tied))
    off[:, ANGLES] = np.mod(off[:, ANGLES] + math.pi, 2.0 * math.pi) - math.pi
    ratio = np.abs(off) / np.sqrt(u**2 + v**2)
    if not np.isfinite(ratio).any():
        return MethodDifference(method, None, None, None, "nothing_in_common")
    joint, parameter = np.unravel_index(int(np.nanargmax(ratio)), ratio.shape)
    return MethodDifference(
        method,
        float(ratio[joint, parameter]),
        int(joint) + 1,
        JOINT_PARAMETERS[int(parameter)],
        None,
    )


def _table(joints: Sequence[JointEstimate]) -> tuple[Float[np.ndarray, "j 5"], Float[np.ndarray, "j 5"]]:
    """Return values and uncertainties, NaN where not identifiable."""
    values = Chain(tuple(joint.parameters for joint in joints)).as_array()
    stated = [
        [math.nan if (u := joint.standard_uncertainty[name]) is None else u for name in JOINT_PARAMETERS]
        for joint in joints
    ]
    return values, np.array(stated)
