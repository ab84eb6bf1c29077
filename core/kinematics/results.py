"""Results of an identification: each joint with its uncertainties, arc and residuals, and the warnings."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import chdtri

from core.calibration import CORRECT_PITCH
from core.errors import Advisory, listed
from core.kinematics.arm_model import NOMINAL_LENGTH_MM, ArmState
from core.kinematics.dh import JOINT_PARAMETERS, Chain, JointParameters
from core.kinematics.error_model import FEW_POSES, ErrorModel, Level, joint_approach
from core.kinematics.global_fit import Conditioning, FitResult, Gauge, Validation
from core.kinematics.pose_observations import PoseData


@dataclass(frozen=True, slots=True)
class JointEstimate:
    """One joint, counted from 1. The mappings have the names of `JOINT_PARAMETERS`; an uncertainty is None where the
    parameter is not identifiable, and the parameter then has the nominal's value, or zero. `arc_rad` is the range of
    the joint's angles, of joints identified by sweeps alone that of the longest. `poses` are those of its sweeps, or
    all that were fitted.
    """

    joint: int
    parameters: JointParameters
    standard_uncertainty: Mapping[str, float | None]
    identifiable: Mapping[str, bool]
    nominal: JointParameters | None
    parallel_to_next: bool
    arc_rad: float
    poses: int


def joint_estimates(
    arm: ArmState,
    gauge: Gauge,
    covariance: Float[np.ndarray, "f f"],
    nominal: Chain | None,
    joint_angles: Float[np.ndarray, "n j"],
) -> tuple[JointEstimate, ...]:
    """Return the estimates of every joint; `covariance` is of the free columns."""
    layout, chain = arm.layout, arm.chain
    sigma = np.full(layout.kinematic, np.nan)
    sigma[np.flatnonzero(gauge.free)] = np.sqrt(np.diag(covariance))
    joints = []
    for i in range(layout.joints):
        uncertainty: dict[str, float | None] = {}
        for k, name in enumerate(JOINT_PARAMETERS):
            column = layout.column(i, k)
            uncertainty[name] = float(sigma[column]) if gauge.free[column] else None
        joints.append(
            JointEstimate(
                joint=i + 1,
                parameters=chain.joints[i],
                standard_uncertainty=uncertainty,
                identifiable={name: value is not None for name, value in uncertainty.items()},
                nominal=None if nominal is None else nominal.joints[i],
                parallel_to_next=bool(gauge.parallel[i]),
                arc_rad=float(np.ptp(joint_angles[:, i])),
                poses=len(joint_angles),
            )
        )
    return tuple(joints)


ILL_CONDITIONED = 100.0
SHORT_ARC = math.radians(20.0)
MIN_SCALED_MM, MIN_SCALED_LENGTHS = 100.0, 2
"""Which lengths say of a common scale, and how many of them it takes."""
MIN_SCALE, MIN_SCALE_RATIO, SCALE_LEVEL = 1.5e-3, 4.0, 1e-3
"""The smallest common scale, less 1, that is worth a warning; its least ratio to its standard uncertainty; the level at
which lengths that depart from it otherwise than the nominal's do speak against it."""
FAR_MM, FAR_RAD = 20.0, math.radians(5.0)
MAX_SHARE_APART = 0.005
"""Of the variance that independent joints have in a combination: what moves less moves together."""
MIN_PART_OF_COMBINATION = 0.2
LARGE_APPROACH, SURE_APPROACH = math.radians(0.005), 3.0
"""Offset of a joint by the side it comes from that is worth a warning, and how many of its uncertainties it must be."""
MIN_SPARE_CONFIGURATIONS = 4
"""More than joints: fewer configurations lie near a plane by chance."""


def warnings_for(
    refined: FitResult,
    gauge: Gauge,
    how: Conditioning,
    validation: Validation | None,
    poses: PoseData,
    nominal: Chain | None,
) -> Iterator[Advisory]:
    """Yield the warnings of an identification."""
    if how.condition_number > ILL_CONDITIONED:
        yield Advisory(
            "ill_conditioned",
            f"The condition number is {how.condition_number:.0f}: some parameters are determined far less accurately "
            "than others.",
            "Add poses that move all joints over their range; the parameters' uncertainties say which suffer.",
        )
    yield from _short_arcs(poses.joint_angles[refined.used])
    yield from _moved_together(poses.joint_angles[refined.used])
    if nominal is not None:
        yield from _far_from(nominal, refined, gauge)
        yield from _scaled(nominal, refined, gauge, instrument=poses.instrument)
    out = np.flatnonzero(~refined.used)
    if len(out):
        some = listed([poses.label(int(i)) for i in out])
        yield Advisory(
            "poses_excluded",
            f"{len(out)} of {len(poses)} poses do not fit the others and were rejected: {some}.",
            "Check their joint angles and measurements.",
        )
    yield from validation_warnings(validation)


def validation_warnings(validation: Validation | None) -> Iterator[Advisory]:
    """Yield a warning where held-out poses contradict an identification."""
    if validation is not None and validation.nominal is not None:
        ours, nominals = validation.identified.position_rms_mm, validation.nominal.position_rms_mm
        if ours > nominals:
            yield Advisory(
                "no_better_than_nominal",
                f"On held-out poses the identified chain is off by {ours:.3g} mm, the nominal by {nominals:.3g}.",
                "Add poses; these do not determine the parameters better than the data sheet states them.",
            )


def model_warnings(model: ErrorModel) -> Iterator[Advisory]:
    """Yield warnings where few poses carry all terms, where gravity is not along the base's z axis, and where joints
    stop elsewhere when they come from the other side.
    """
    gravity = model.fit.design.gravity
    if gravity[2] == 0.0:
        yield Advisory(
            "gravity_across_base",
            "The weight of the robot's links acts across the z axis of its base, about along "
            f"({gravity[0]:.1f}, {gravity[1]:.1f}, 0) or against it: the robot is mounted on a wall, or the data "
            "sheet's first axis is not vertical. Compliance is that of such a robot.",
            "If it stands or hangs, check the data sheet's first joint, and the order of the joint angles.",
        )
    count = len(model.fit.design)
    if model.level is Level.ALL and count < FEW_POSES:
        yield Advisory(
            "scatter_uncertain",
            f"{count} configurations carry all terms beyond the chain, which may take up part of the noise: the "
            "robot's scatter and the residuals can be several times too small. Errors at poses held out are sound.",
            f"Measure {FEW_POSES} configurations or more before relying on them.",
        )
    large = [
        one
        for one in joint_approach(model)
        if abs(one.offset) > max(LARGE_APPROACH, SURE_APPROACH * one.standard_uncertainty)
    ]
    if large:
        which = ", ".join(f"{one.joint} by {2.0 * abs(math.degrees(one.offset)):.3f}°" for one in large)
        yield Advisory(
            "approach_matters",
            f"Some joints stop elsewhere when they come from the other side: {which} between the sides. Predictions "
            "lie in the middle, and their uncertainty covers both sides.",
            "Let the robot's program reach every pose by moves of these joints from one side; the rest of their play "
            "is a matter of the gears.",
        )


def _short_arcs(joint_angles: Float[np.ndarray, "n j"]) -> Iterator[Advisory]:
    arcs = np.ptp(joint_angles, axis=0)
    short = np.flatnonzero(arcs < SHORT_ARC)
    if len(short):
        which = ", ".join(f"{i + 1} by {math.degrees(float(arcs[i])):.1f}°" for i in short)
        yield Advisory(
            "short_arc",
            f"Some joints move little over all poses: {which}.",
            "Move every joint over 40° or more; the accuracy of its axis is proportional to the arc.",
        )


def _moved_together(joint_angles: Float[np.ndarray, "n j"]) -> Iterator[Advisory]:
    """A combination of joints that hardly varies while each of them does: q5 = q1, or a tool that is kept upright."""
    spread = joint_angles.std(axis=0)
    moved = np.flatnonzero(spread > 0.0)
    if (
        len(moved) < 2
        or len(np.unique(np.round(joint_angles, 3), axis=0)) < len(moved) + MIN_SPARE_CONFIGURATIONS
    ):
        return
    values, vectors = np.linalg.eigh(np.corrcoef(joint_angles[:, moved], rowvar=False))
    for k in np.flatnonzero(values < MAX_SHARE_APART):
        joints = [str(i + 1) for i in moved[np.abs(vectors[:, k]) > MIN_PART_OF_COMBINATION]]
        yield Advisory(
            "joints_move_together",
            f"Joints {', '.join(joints[:-1])} and {joints[-1]} moved together in all poses, so that these do "
            "not separate what is wrong with one from what is wrong with another.",
            "Add poses at which each of these joints turns while the others rest.",
        )


def _far_from(nominal: Chain, refined: FitResult, gauge: Gauge) -> Iterator[Advisory]:
    """A parameter that no workshop would miss by so much means angles of another sign or zero."""
    off = np.abs(refined.arm.parameters - nominal.as_array())
    limits = np.array([FAR_RAD if name.endswith("_rad") else FAR_MM for name in JOINT_PARAMETERS])
    far = np.flatnonzero(((off > limits) & gauge.free[: off.size].reshape(off.shape)).ravel())
    if len(far):
        names = refined.arm.layout.names()
        yield Advisory(
            "deviation_from_nominal_large",
            f"{', '.join(names[c] for c in far)}: over {FAR_MM:g} mm or {math.degrees(FAR_RAD):g}° off the nominal.",
            "Check the signs and zeros of the joint angles and the nominal's values: the arm found moves as the poses "
            "do, but it may be described by other angles than its maker's.",
        )


def _scaled(nominal: Chain, refined: FitResult, gauge: Gauge, *, instrument: bool) -> Iterator[Advisory]:
    """Lengths that are all off by one factor are off by the scale of the print, or of the other instrument."""
    columns = [k for k, name in enumerate(JOINT_PARAMETERS) if name.endswith("_mm")]
    stated = nominal.as_array()[:, columns]
    free = gauge.free[: nominal.as_array().size].reshape(nominal.as_array().shape)[:, columns]
    long = free & (np.abs(stated) >= MIN_SCALED_MM)
    if int(long.sum()) < MIN_SCALED_LENGTHS:
        return
    off = refined.arm.parameters[:, columns][long] / stated[long] - 1.0
    variances = np.zeros(refined.arm.layout.size)
    variances[refined.free] = np.diag(refined.covariance)
    own = variances[: nominal.as_array().size].reshape(nominal.as_array().shape)[:, columns][long]
    weights = stated[long] ** 2 / (NOMINAL_LENGTH_MM**2 + own)
    scale = float(np.average(off, weights=weights))
    left = float(weights @ (off - scale) ** 2)
    # Lengths of the other sign are another arm's, and no scale makes them.
    if (
        abs(scale) < max(MIN_SCALE, MIN_SCALE_RATIO / math.sqrt(float(weights.sum())))
        or scale <= -1.0
        or left > float(chdtri(len(off) - 1, SCALE_LEVEL))
    ):
        return
    factor = (
        f"All {len(off)} lengths of {MIN_SCALED_MM:g} mm or more are {100.0 * abs(scale):.3g} % "
        f"{'longer' if scale > 0.0 else 'shorter'} than the nominal ones."
    )
    if instrument:
        yield Advisory(
            "instrument_scale_mismatch",
            factor,
            "Check the instrument's scale against a known length, its correction for temperature and air, and the unit "
            "of its export; or the nominal lengths, where they are another model's.",
        )
        return
    yield Advisory(
        "print_scale_mismatch",
        factor,
        CORRECT_PITCH,
    )
