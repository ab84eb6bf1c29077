"""Whether the robot keeps its data sheet, decided of all poses of a session together.

The worst pose counts, and what was not measured may be the worst: a pose that was commanded or photographed and of
which nothing counts leaves the decision open, as does one whose cycles drift, or have no numbers to test that by.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from core.metrology import Acceptance, Reading, decide, repeatability_reading
from core.session.model import SessionData, natural
from core.session.repeatability.assessment import SessionRepeatability
from core.session.repeatability.pose_rows import PoseRow

UNDETERMINED = "whose accuracy is not determined"
UNSCALED = "before a target whose pitch has no stated uncertainty"
_NOTHING = Reading(0, None, None, None)


@dataclass(frozen=True, slots=True)
class LimitAcceptance:
    """The decision on one limit of a data sheet, mm.

    `pose_id` is the pose that decides, and None where none can; `worst_mm` is the largest figure of all poses as
    measured, None without a figure.
    """

    limit_mm: float
    worst_mm: float | None
    pose_id: str | None
    found: Acceptance


@dataclass(frozen=True, slots=True)
class SessionAcceptance:
    """The decisions on RP_l and on AP_p; None where the data sheet states no limit, or no pose has the figure."""

    repeatability: LimitAcceptance | None
    accuracy: LimitAcceptance | None


def assess_acceptance(data: SessionData, found: SessionRepeatability) -> SessionAcceptance:
    """Decide whether every pose keeps what the robot's data sheet states.

    Of RP_l the corrected figure is compared, with its interval: the limit is the robot's, and the instrument adds to
    what is measured. Where no interval of the corrected figure is known, the upper limit of the figure as measured can
    still show that the robot keeps the limit, but nothing that it does not. The interval of AP_p is the robot's own.
    RP_l is decided of all poses that were commanded or photographed, AP_p of those whose position was commanded.
    """
    rows = {row.pose_id: row for row in found.poses}
    every = sorted({*rows, *data.commanded}, key=natural)
    commanded = [pose_id for pose_id in every if _commanded(data, pose_id)]
    spread = {
        pose_id: row.figures.repeatability.position_mm
        for pose_id, row in rows.items()
        if row.figures is not None
    }
    off = {pose_id: one.figures.position_mm for pose_id, one in found.accuracy.poses.items()}
    return SessionAcceptance(
        _decided(data.datasheet.repeatability_mm, {p: _scatter(found, rows.get(p)) for p in every}, spread),
        _decided(data.datasheet.accuracy_mm, {p: _deviation(found, rows.get(p)) for p in commanded}, off),
    )


def _commanded(data: SessionData, pose_id: str) -> bool:
    return pose_id in data.commanded and data.commanded[pose_id].position_mm is not None


def _decided(
    limit_mm: float | None, readings: Mapping[str, Reading], figures: Mapping[str, float | None]
) -> LimitAcceptance | None:
    known = [value for value in figures.values() if value is not None]
    if limit_mm is None or not figures:
        return None
    found = decide(limit_mm, list(readings.values()))
    return LimitAcceptance(
        limit_mm,
        max(known, default=None),
        None if found.reading is None else list(readings)[found.reading],
        found,
    )


def _scatter(found: SessionRepeatability, row: PoseRow | None) -> Reading:
    if row is None or row.figures is None:
        return _NOTHING
    return replace(repeatability_reading(row.figures), flaw=found.steadiness.flaw(row.pose_id))


def _deviation(found: SessionRepeatability, row: PoseRow | None) -> Reading:
    if row is None or not row.visits:
        return _NOTHING
    one = found.accuracy.poses.get(row.pose_id)
    if one is None or one.interval.position_mm is None:
        flaw = UNSCALED if row.pose_id in found.unscaled else UNDETERMINED
        return Reading(len(row.visits), None, None, None, flaw)
    value, interval = one.figures.position_mm, one.interval.position_mm
    return Reading(len(row.visits), value, interval, None, found.steadiness.flaw(row.pose_id))
