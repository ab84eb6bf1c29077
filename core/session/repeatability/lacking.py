"""What a session lacks for figures: readings without rotation or covariance, and poses that have no distance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import Enum

from core.errors import Advisory, listed
from core.session.model import SessionData

MIN_SPREADS_APART = 50.0
"""Poses nearer to one another than so many standard deviations of a position are one place."""


class Lack(Enum):
    """What keeps two poses from having a distance, in the order in which it is looked for."""

    VISITS = "visits"
    FRAME = "frame"
    CYCLES = "cycles"
    LENGTH = "length"


_CLAUSES = {
    Lack.VISITS: "one of the two poses has fewer than two visits that count",
    Lack.FRAME: "the poses are before different targets, so that their positions do not compare",
    Lack.CYCLES: "the poses have fewer than two numbered cycles in common",
    Lack.LENGTH: f"the poses are less than {MIN_SPREADS_APART:g} times the scatter of their positions apart",
}
_ADVICE = {
    Lack.VISITS: "Visit every pose again, once in each cycle.",
    Lack.FRAME: "Measure both ends of a distance before the same target.",
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
