"""Figures without the intervals that cannot be stated: of a print without a stated scale, of readings that hide their
scatter.
"""

from __future__ import annotations

from dataclasses import replace

from core.metrology import DistanceAssessment, PerComponent, PoseAccuracy


def unscaled_accuracy(accuracy: PoseAccuracy) -> PoseAccuracy:
    """Return AP without the intervals that depend on the scale. `parts` remain: of differences at one pose it leaves a
    share too small to matter.
    """
    interval = replace(accuracy.interval, position_mm=None, x_mm=None, y_mm=None, z_mm=None)
    return replace(accuracy, interval=interval, held_out_interval=None)


def unchanging_accuracy(accuracy: PoseAccuracy) -> PoseAccuracy:
    """Return AP of a pose whose readings do not change: no interval, and no parts of one."""
    interval: PerComponent[tuple[float, float] | None] = PerComponent(
        None, None, None, None, None, None, None
    )
    return replace(accuracy, interval=interval, held_out_interval=None, parts=None)


def distance_of_hidden_scatter(distance: DistanceAssessment) -> DistanceAssessment:
    """Return AD and RD without intervals, where the readings of an end do not change, or are rounded too much."""
    return replace(unscaled_distance(distance), interval_mm=None)


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
