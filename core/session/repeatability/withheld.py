"""Figures without the intervals that cannot be stated: of a print without a stated scale, of readings that hide their
scatter. Warnings without those that do not matter to the figures.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from core.calibration import PRINT_SHAPE
from core.errors import Advisory
from core.metrology import DistanceAssessment, PerComponent, PoseAccuracy
from core.session.absolute_poses import SHAPE_DOMINATES

MIN_SHAPE_SHARE = 0.5
"""Of the variance of an AP or of a distance between poses, from which on the print's shape dominates it."""


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


def print_warnings(
    warnings: Sequence[Advisory],
    deviations: Iterable[PoseAccuracy],
    distances: Iterable[DistanceAssessment],
    sources: Sequence[str],
) -> tuple[Advisory, ...]:
    """Return what is to know of the prints: that their shape dominates only where it does of some AP or distance.

    Both contain what the robot's scatter leaves open, next to which camera and print may be small. `sources` says of
    what each error is that the figures share.
    """
    if all(one.code != SHAPE_DOMINATES for one in warnings):
        return tuple(warnings)
    of_shape = np.array([source == PRINT_SHAPE for source in sources], dtype=np.bool_)
    shares = [0.0]
    for one in deviations:
        if one.parts is not None and one.interval.position_mm is not None:
            shared = np.sum(one.parts.shared**2)
            of_print = np.sum(one.parts.shared[:, of_shape] ** 2)
            shares.append(float(of_print / (np.trace(one.parts.own) + shared)))
    for way in distances:
        if way.common_mm is not None and way.standard_uncertainty_mm:
            shares.append(float(np.sum(way.common_mm[of_shape] ** 2)) / way.standard_uncertainty_mm**2)
    if max(shares) >= MIN_SHAPE_SHARE:
        return tuple(warnings)
    return tuple(one for one in warnings if one.code != SHAPE_DOMINATES)
