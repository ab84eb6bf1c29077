"""Absolute figures before a target whose scale nobody states: what they read is given, how uncertain they are is not.

A pitch that is .1 % wrong makes every length .1 % wrong, and no image shows it. AP and AD of such poses keep their
values; intervals that left this out would be false.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from core.calibration import ShapePrior
from core.metrology import DistanceAssessment, PoseAccuracy
from core.session.model import MeasuredPose, SessionData


def stated_scale(data: SessionData, shapes: Mapping[int, ShapePrior], visit: MeasuredPose) -> float | None:
    """Return the relative standard uncertainty of the print's scale; None for another instrument, or not stated.

    `shapes` as of `core.session.assess_repeatability`.
    """
    if visit.image is None:
        return None
    return shapes.get(visit.frame, ShapePrior.of(data.targets[visit.frame])).scale


def scale_unknown(data: SessionData, shapes: Mapping[int, ShapePrior], visit: MeasuredPose) -> bool:
    """Return whether the visit is to a print of which no scale is stated; `shapes` as of `stated_scale`."""
    return visit.image is not None and stated_scale(data, shapes, visit) is None


def unscaled_accuracy(accuracy: PoseAccuracy) -> PoseAccuracy:
    """Return AP without the intervals that depend on the scale. `parts` remain: of differences at one pose it leaves a
    share too small to matter.
    """
    interval = replace(accuracy.interval, position_mm=None, x_mm=None, y_mm=None, z_mm=None)
    return replace(accuracy, interval=interval)


def unscaled_distance(distance: DistanceAssessment) -> DistanceAssessment:
    """Return AD and RD without the uncertainty of the mean distance."""
    return replace(
        distance,
        standard_uncertainty_mm=None,
        accuracy_interval_mm=None,
        cycles_uncertainty_mm=None,
        degrees_of_freedom=None,
        common_mm=None,
    )
