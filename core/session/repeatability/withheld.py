"""What a session does not give, and why: poses without a distance, readings without rotation or covariance, figures
without the intervals that cannot be stated (of a print without a stated scale, of readings that hide their scatter),
and warnings that do not matter to the figures.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from enum import Enum

import numpy as np

from core.calibration import PRINT_SHAPE
from core.errors import Advisory, listed
from core.metrology import DistanceAssessment, PerComponent, PoseAccuracy
from core.session.absolute_poses import SHAPE_DOMINATES
from core.session.model import SessionData

MIN_SPREADS_APART = 50.0
"""Poses nearer to one another than so many standard deviations of a position are one place."""
MIN_SHAPE_SHARE = 0.5
"""Of the variance of an AP or of a distance between poses, from which on the print's shape dominates it."""


class Lack(Enum):
    """What keeps two poses from having a distance, in the order in which it is looked for."""

    VISITS = "visits"
    FRAME = "frame"
    REPEATED = "repeated"
    CYCLES = "cycles"
    LENGTH = "length"


_CLAUSES = {
    Lack.VISITS: "one of the two poses has fewer than two visits that count",
    Lack.FRAME: "the poses are before different targets, so that their positions do not compare",
    Lack.REPEATED: "a pose has several visits of one cycle, of which none is known to be that of the distance",
    Lack.CYCLES: "the poses have fewer than two numbered cycles in common",
    Lack.LENGTH: f"the poses are less than {MIN_SPREADS_APART:g} times the scatter of their positions apart",
}
_ADVICE = {
    Lack.VISITS: "Visit every pose again, once in each cycle.",
    Lack.FRAME: "Measure both ends of a distance before the same target.",
    Lack.REPEATED: "Give each visit a cycle of its own, and images of one stop the same cycle and a burst index each.",
    Lack.CYCLES: "Tag every image or reading with its cycle, one visit to each pose a cycle.",
    Lack.LENGTH: "Measure poses that are farther apart.",
}
_OF_SEPARATE_CAMERAS = (
    "; a camera for each image by itself makes that scatter large",
    "Take one camera for all images (estimator=pooled).",
)


def distances_unavailable(lacks: Mapping[Lack, Sequence[str]], *, one_camera: bool) -> Advisory:
    """Return the warning of a session without distances.

    `lacks` names the pairs of poses by what they lack; `one_camera` says that all images of a focus group have one.
    """
    clauses, advice = dict(_CLAUSES), dict(_ADVICE)
    if not one_camera:
        clauses[Lack.LENGTH] += _OF_SEPARATE_CAMERAS[0]
        advice[Lack.LENGTH] = _OF_SEPARATE_CAMERAS[1]
    found = [lack for lack in Lack if lacks.get(lack)]
    reasons = "; ".join(f"{listed(lacks[lack])}: {clauses[lack]}" for lack in found)
    return Advisory(
        "distances_unavailable",
        f"Distances are not given. {reasons}.",
        " ".join(advice[lack] for lack in found),
    )


def distance_pairs_truncated(
    poses: int, pairs: int, given: int, most: int, lacks: Mapping[Lack, Sequence[str]]
) -> Advisory:
    """Return the warning of a session of so many poses that of them only `pairs` of successive ones are looked at;
    `given` have a distance, and `lacks` names the others by what they lack.
    """
    others = "; ".join(f"{listed(lacks[lack])}: {_CLAUSES[lack]}" for lack in Lack if lacks.get(lack))
    return Advisory(
        "distance_pairs_truncated",
        f"Of {poses} poses only the {pairs} pairs of successive ones are looked at, all pairs where there are no more "
        f"than {most}. Distances are given between {given} of these pairs{'. ' if others else ''}{others}.",
        "Put the poses whose distances matter into a session of their own.",
    )


def measured_pose_warnings(data: SessionData) -> list[Advisory]:
    """Return warnings that say which figures another instrument's readings do not give, and why."""
    poses = list(dict.fromkeys(pose.pose_id for pose in data.measured))
    positions = {pose.pose_id for pose in data.measured if pose.rotation is None}
    unknown = {pose.pose_id for pose in data.measured if pose.covariance is None}
    warnings = []
    if positions:
        warnings.append(
            Advisory(
                "rotations_missing",
                f"{_named(positions, poses)}: not every reading has a rotation, so that no figure of orientation is "
                "given.",
                "Use a probe that measures all six degrees of freedom where orientation matters.",
            )
        )
    if unknown:
        warnings.append(
            Advisory(
                "noise_unknown",
                f"{_named(unknown, poses)}: not every reading has a covariance, so that neither noise floor nor "
                "corrected figures are given, and whether the figures describe the robot or the instrument cannot be "
                "determined.",
                "State the instrument's covariance with each reading.",
            )
        )
    return warnings


def _named(pose_ids: set[str], of: Sequence[str]) -> str:
    if len(pose_ids) == len(of) > 1:
        return f"All {len(of)} poses"
    return f"{'Pose' if len(pose_ids) == 1 else 'Poses'} {listed(p for p in of if p in pose_ids)}"


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
