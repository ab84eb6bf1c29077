"""Whether the robot keeps its data sheet, decided of all poses of a session together.

The worst pose counts, and what was not measured may be the worst: a pose that was commanded or photographed and of
which nothing counts leaves the decision open, as does one whose cycles drift, or have no numbers to test that by. A
view that was taken once and belongs to no cycle determines the lens, and is no pose of the test: the reason names it.

What the poses have in common narrows their intervals: of RP_l the process that cycles follow, of AP_p the size of the
deviations. The worst pose may be of another kind. So a robot passes only if its intervals lie within the limit without
that, too: by each pose's own cycles, and in the frames that the other poses tie.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from core.errors import listed
from core.metrology import (
    UNCHANGING,
    UNSTEADY,
    WITHOUT_DEGRADED,
    Acceptance,
    Decision,
    FrameTie,
    Reading,
    decide,
    repeatability_reading,
    scatter_flaw,
)
from core.session.commanded_poses import MOUNT_UNLIKELY, SCALE_MISMATCHES, distinct_commands
from core.session.model import SessionData, natural
from core.session.repeatability.assessment import SessionRepeatability
from core.session.repeatability.pose_rows import PoseRow, figures_by_itself, has_clusters

UNDETERMINED = "whose accuracy is not determined"
UNITS = "measured and commanded poses are not in one unit"
SCALE = "measured and commanded distances differ by one factor"
MOUNT = "the poses agree far better with the camera mounted the other way"
UNSCALED = "before a target whose pitch has no stated uncertainty"
CLEAR_SHARE = 1.0 / 3.0
"""Of the limit: no pose whose upper limit is below it is looked at by itself, which takes a tenth of a second."""
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
    AP_p is about the best fit of base and tool: an error that all poses share is not decided.
    """
    rows = {row.pose_id: row for row in found.poses}
    apart = {pose_id for pose_id, row in rows.items() if _is_apart(row)}
    known = {*rows, *data.commanded}
    every = _tested(known, apart)
    commanded = _tested({pose_id for pose_id in known if _commanded(data, pose_id)}, apart)
    spread = {
        pose_id: row.figures.repeatability.position_mm
        for pose_id, row in rows.items()
        if row.figures is not None
    }
    off = {pose_id: one.figures.position_mm for pose_id, one in found.accuracy.poses.items()}
    limit = data.datasheet.repeatability_mm
    repeatability = _decided(limit, {p: _scatter(found, rows.get(p), limit) for p in every}, spread)
    if repeatability is not None and repeatability.found.decision is Decision.PASS:
        by_itself = {p: _scatter(found, rows.get(p), limit, by_itself=True) for p in every}
        repeatability = _decided(limit, by_itself, spread)
    accuracy = _decided(
        data.datasheet.accuracy_mm, {p: _deviation(data, found, rows.get(p)) for p in commanded}, off
    )
    codes = {warning.code for warning in found.accuracy.warnings}
    if found.units is not None:
        repeatability, accuracy = _without_decision(repeatability, UNITS), _without_decision(accuracy, UNITS)
    elif codes & SCALE_MISMATCHES:
        accuracy = _without_decision(accuracy, SCALE)
    elif MOUNT_UNLIKELY in codes:
        accuracy = _without_decision(accuracy, MOUNT)
    excluded = sum(len(row.excluded) for row in found.poses)
    limitations = (
        [f"{excluded} measurement{'s do' if excluded > 1 else ' does'} not count"] if excluded else []
    )
    if found.witness is not None and found.witness.witness.subtract:
        limitations.append("the witness's motion was subtracted")
    if apart:
        are = "is" if len(apart) == 1 else "are"
        limitations.append(
            f"{listed(sorted(apart, key=natural))}, seen once and in no cycle, {are} not tested"
        )
    return SessionAcceptance(
        _limited(repeatability, limitations),
        _limited(accuracy, ["what base and tool are off is not tested", *limitations]),
    )


def _without_decision(of_limit: LimitAcceptance | None, reason: str) -> LimitAcceptance | None:
    """Return what is decided where measured and commanded poses contradict one another as a whole: nothing."""
    if of_limit is None:
        return None
    return replace(of_limit, pose_id=None, found=Acceptance(Decision.INCONCLUSIVE, None, reason))


def _limited(of_limit: LimitAcceptance | None, limitations: Sequence[str]) -> LimitAcceptance | None:
    """Return a decision that a robot passes with what it does not say."""
    if of_limit is None or of_limit.found.decision is not Decision.PASS:
        return of_limit
    reason = "; ".join([of_limit.found.reason, *limitations])
    return replace(of_limit, found=replace(of_limit.found, reason=reason))


def _is_apart(row: PoseRow) -> bool:
    """Return whether a pose was seen once and in no numbered cycle, as views are that determine the lens."""
    return len(row.visits) == 1 and row.visits[0].cycle is None and not row.excluded


def _tested(poses: set[str], apart: set[str]) -> list[str]:
    return sorted(poses - apart or poses, key=natural)


def _commanded(data: SessionData, pose_id: str) -> bool:
    return pose_id in data.commanded and data.commanded[pose_id].position_mm is not None


def _decided(
    limit_mm: float | None, readings: Mapping[str, Reading], figures: Mapping[str, float | None]
) -> LimitAcceptance | None:
    known = [value for value in figures.values() if value is not None]
    if limit_mm is None or not figures:
        return None
    found = decide(limit_mm, list(readings.values()), list(readings))
    return LimitAcceptance(
        limit_mm,
        max(known, default=None),
        None if found.reading is None else list(readings)[found.reading],
        found,
    )


def _scatter(
    found: SessionRepeatability, row: PoseRow | None, limit_mm: float | None, *, by_itself: bool = False
) -> Reading:
    """Return what RP_l of a pose decides with; `by_itself` by its own cycles, too."""
    if row is None or row.figures is None:
        return _NOTHING
    reading = repeatability_reading(row.figures)
    if by_itself and limit_mm is not None and reading.upper > CLEAR_SHARE * limit_mm:
        alone = figures_by_itself(row)
        if alone is not None:
            reading = _wider(reading, repeatability_reading(alone))
    with_all = None if row.including_degraded is None else row.including_degraded.position_mm
    flaw = scatter_flaw(row.figures) or _flaw(found, row)
    if flaw is None and limit_mm is not None and with_all is not None and with_all > limit_mm:
        flaw = WITHOUT_DEGRADED
    return replace(reading, flaw=flaw)


def _wider(one: Reading, other: Reading) -> Reading:
    """Return a reading with the limits of both; None stays unknown."""
    interval = at_most = None
    if one.interval is not None:
        others = other.interval or one.interval
        interval = min(one.interval[0], others[0]), max(one.interval[1], others[1])
    if one.at_most is not None:
        at_most = max(one.at_most, other.at_most or 0.0)
    return replace(one, interval=interval, at_most=at_most)


def _flaw(found: SessionRepeatability, row: PoseRow) -> str | None:
    """Return why a pose's cycles decide nothing; None where they can."""
    flaw = found.tags.flaw(row.pose_id) or found.steadiness.flaw(row.pose_id)
    if flaw is None and row.figures is not None and has_clusters(row.figures):
        return UNSTEADY
    return flaw


def _deviation(data: SessionData, found: SessionRepeatability, row: PoseRow | None) -> Reading:
    if row is None or not row.visits:
        return _NOTHING
    one = found.accuracy.poses.get(row.pose_id)
    if one is None or one.interval.position_mm is None:
        flaw = None if row.figures is None else scatter_flaw(row.figures)
        if flaw != UNCHANGING:
            flaw = UNSCALED if row.pose_id in found.unscaled else UNDETERMINED
        return Reading(len(row.visits), None, None, None, flaw)
    if one.held_out_interval is None:
        return Reading(len(row.visits), None, None, None, UNDETERMINED)
    reading = Reading(len(row.visits), one.figures.position_mm, one.interval.position_mm, None)
    alone = Reading(len(row.visits), None, one.held_out_interval, None)
    share = 1.0 if one.parts is None else one.parts.visits_share
    wider = _wider(reading, alone)
    return replace(
        wider,
        flaw=_flaw(found, row),
        cycles_share=share,
        tie=_tie(data, found),
        frames=" in the frames that the other poses tie" if wider.upper > reading.upper else "",
    )


def _tie(data: SessionData, found: SessionRepeatability) -> FrameTie | None:
    """Return what tied the frames of the session's poses; None where nothing is known of it."""
    tied = {p: one for p, one in found.accuracy.poses.items() if one.parts is not None}
    known = [(one, one.parts) for one in tied.values() if one.parts is not None]
    if not known or known[0][1].variance <= 0.0:
        return None
    variance = known[0][1].variance
    return FrameTie(
        variance,
        distinct_commands({p: data.commanded[p] for p in tied}),
        known[0][0].degrees_of_freedom,
        max(float(np.trace(parts.of_tie)) / (3.0 * variance) for _, parts in known),
        max(one.figures.position_mm or 0.0 for one, _ in known),
    )
