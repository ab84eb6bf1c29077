"""What a pose's readings say of the instrument: that they do not change, or are rounded; and all warnings of a pose."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from core.errors import Advisory
from core.geometry import is_near_gimbal_lock, rotation_to_rpy
from core.metrology.pose_cycles import PoseCycles
from core.metrology.repeatability.statistics import CycleStatistics
from core.metrology.resolution import Resolution

MAX_STEP_SHARE = 1.0
"""Of the scatter along an axis: a coarser step of the readings is warned of."""
_AXES = ("x", "y", "z")


def with_resolution(cycles: PoseCycles, resolution: Resolution | None) -> PoseCycles:
    """Return the cycles with stated covariances that are at least what rounding adds."""
    if resolution is None or cycles.covariances is None:
        return cycles
    covariances = cycles.covariances.copy()
    for axis, least in enumerate(resolution.variance.tolist()):
        np.maximum(covariances[:, axis, axis], least, out=covariances[:, axis, axis])
    return replace(cycles, covariances=covariances)


def scatter_unknown(readings: Sequence[float], resolution: Resolution | None) -> list[bool]:
    """Return which figures of scatter say nothing of the robot: nothing scatters, or the resolution hides it.

    `readings` are RP_l, those of the axes and those of the angles, as far as there are any.
    """
    unknown = [reading == 0.0 for reading in readings]
    if resolution is not None and unknown:
        unknown[0] |= resolution.hides_position
        for axis, hidden in enumerate(resolution.hidden.tolist()):
            unknown[1 + axis] |= hidden
    return unknown


def reading_warnings(sample: CycleStatistics, resolution: Resolution | None) -> tuple[Advisory, ...]:
    """Return what to know of a pose's readings before its figures are read."""
    warnings = []
    if sample.cycles.covariances is None:
        warnings.append(
            Advisory(
                "noise_unknown",
                "The poses carry no covariances: noise floor and corrected figures are not given, and whether the "
                "figures describe the robot or the instrument cannot be determined.",
                "State the instrument's covariance with each pose.",
            )
        )
    if sample.mean_rotation is not None:
        pitch = float(rotation_to_rpy(sample.mean_rotation)[1])
        if is_near_gimbal_lock(pitch):
            warnings.append(
                Advisory(
                    "near_gimbal_lock",
                    f"At a pitch of {math.degrees(pitch):.2f}° roll and yaw turn about nearly the same axis, and their "
                    "scatter is magnified.",
                    "Judge the orientation by the rotation vectors, or measure in a frame turned away from it.",
                )
            )
    if len(sample.cycles) > 1 and not sample.variance[:3].any():
        warnings.append(
            Advisory(
                "no_scatter",
                f"All {len(sample.cycles)} cycles read the same position to the last digit. No figure of scatter has "
                "an interval, and nothing is decided by it.",
                "Check that each cycle was measured anew: that the instrument's stream was not frozen, that it is not "
                "the commanded pose read back from the controller, and that the resolution is finer than the scatter.",
            )
        )
    elif resolution is not None:
        warnings += _rounded(sample, resolution)
    return tuple(warnings)


def _rounded(sample: CycleStatistics, resolution: Resolution) -> list[Advisory]:
    deviation = np.sqrt(sample.variance[:3])
    if not (resolution.step_mm > deviation / MAX_STEP_SHARE).any():
        return []
    step = float(resolution.step_mm.max())
    hidden = [axis for axis, is_hidden in zip(_AXES, resolution.hidden.tolist(), strict=True) if is_hidden]
    what = (
        f"Along {', '.join(hidden)} they scatter by less than half of it: what is read depends on where the robot "
        "stands between two steps, so that these figures have no interval."
        if hidden
        else "They scatter by hardly more, and rounding is a visible part of it."
    )
    return [
        Advisory(
            "readings_rounded",
            f"All readings are multiples of {step:.3g} mm, the resolution of the instrument or of its output. {what}",
            "Let the instrument put out more digits, or take one whose resolution is a fifth of the robot's scatter.",
        )
    ]
