"""What an identification says beside its figures: remarks that travel with the result."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from core.errors import Advisory
from core.kinematics.dh import JOINT_PARAMETERS, Chain
from core.kinematics.identifiability import Conditioning, Gauge
from core.kinematics.poses import PoseData
from core.kinematics.refinement import Refined
from core.kinematics.validation import Validation

ILL_CONDITIONED = 100.0
SHORT_ARC = math.radians(20.0)
FAR_MM, FAR_RAD = 20.0, math.radians(5.0)


def remarks(
    refined: Refined,
    gauge: Gauge,
    how: Conditioning,
    validation: Validation | None,
    poses: PoseData,
    nominal: Chain | None,
) -> Iterator[Advisory]:
    """Return what a reader of the figures has to know."""
    if how.condition_number > ILL_CONDITIONED:
        yield Advisory(
            "ill_conditioned",
            f"The condition number is {how.condition_number:.0f}: some parameters are told far worse than others.",
            "Add poses that move all joints over their range; the parameters' uncertainties say which suffer.",
        )
    yield from _short_arcs(poses.joint_angles[refined.used])
    if nominal is not None:
        yield from _far_from(nominal, refined, gauge)
    out = np.flatnonzero(~refined.used)
    if len(out):
        some = ", ".join(poses.label(int(i)) for i in out[:5]) + (", ..." if len(out) > 5 else "")
        yield Advisory(
            "poses_left_out",
            f"{len(out)} of {len(poses)} poses do not fit the others and were left out: {some}.",
            "Check their joint angles and measurements.",
        )
    yield from of_validation(validation)


def of_validation(validation: Validation | None) -> Iterator[Advisory]:
    """Return what held-out poses say against an identification."""
    if validation is not None and validation.nominal is not None:
        ours, nominals = validation.identified.position_rms_mm, validation.nominal.position_rms_mm
        if ours > nominals:
            yield Advisory(
                "no_better_than_nominal",
                f"On held-out poses the identified chain is off by {ours:.3g} mm, the nominal by {nominals:.3g}.",
                "Add poses; these do not tell the parameters better than the maker knows them.",
            )


def _short_arcs(joint_angles: Float[np.ndarray, "n j"]) -> Iterator[Advisory]:
    arcs = np.ptp(joint_angles, axis=0)
    short = np.flatnonzero(arcs < SHORT_ARC)
    if len(short):
        which = ", ".join(f"{i + 1} by {math.degrees(float(arcs[i])):.1f}°" for i in short)
        yield Advisory(
            "arc_short",
            f"Some joints move little over all poses: {which}.",
            "Move every joint over 40° or more; its axis is told in proportion to that.",
        )


def _far_from(nominal: Chain, refined: Refined, gauge: Gauge) -> Iterator[Advisory]:
    """A parameter that no workshop would miss by so much means angles of another sign or zero."""
    off = np.abs(refined.arm.parameters - nominal.as_array())
    limits = np.array([FAR_RAD if name.endswith("_rad") else FAR_MM for name in JOINT_PARAMETERS])
    far = np.flatnonzero(((off > limits) & gauge.free[: off.size].reshape(off.shape)).ravel())
    if len(far):
        names = refined.arm.layout.names()
        yield Advisory(
            "far_from_nominal",
            f"{', '.join(names[c] for c in far)}: over {FAR_MM:g} mm or {math.degrees(FAR_RAD):g}° off the nominal.",
            "Check the signs and zeros of the joint angles and the nominal's values: the arm found moves as the poses "
            "do, but it may be described by other angles than its maker's.",
        )
