"""Whether the robot keeps its data sheet, decided of all poses of a session together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from core.metrology import Acceptance, PoseAccuracy, Reading, decide, repeatability_reading
from core.session.model import Datasheet
from core.session.repeatability.assessment import SessionRepeatability
from core.session.repeatability.pose_rows import PoseRow


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
    """The decisions on RP_l and on AP_p; None where the data sheet states no limit, or no pose counts."""

    repeatability: LimitAcceptance | None
    accuracy: LimitAcceptance | None


def assess_acceptance(found: SessionRepeatability, datasheet: Datasheet) -> SessionAcceptance:
    """Decide whether every pose keeps what the robot's data sheet states.

    Of RP_l the corrected figure is compared, with its interval: the limit is the robot's, and the instrument adds to
    what is measured. Where no interval of the corrected figure is known, the upper limit of the figure as measured can
    still show that the robot keeps the limit, but nothing that it does not. The interval of AP_p is the robot's own.
    """
    rows = [row for row in found.poses if row.visits]
    spread = [row.figures.repeatability.position_mm if row.figures is not None else None for row in rows]
    accuracy = found.accuracy.poses
    off = [accuracy[row.pose_id].figures.position_mm for row in rows if row.pose_id in accuracy]
    compared = [row for row in rows if row.pose_id in accuracy]
    return SessionAcceptance(
        _decided(datasheet.repeatability_mm, rows, [_scatter(row) for row in rows], spread),
        _decided(datasheet.accuracy_mm, compared, [_deviation(row, accuracy) for row in compared], off),
    )


def _decided(
    limit_mm: float | None,
    rows: Sequence[PoseRow],
    readings: Sequence[Reading],
    figures: Sequence[float | None],
) -> LimitAcceptance | None:
    if limit_mm is None or not rows:
        return None
    found = decide(limit_mm, readings)
    return LimitAcceptance(
        limit_mm,
        max((value for value in figures if value is not None), default=None),
        None if found.reading is None else rows[found.reading].pose_id,
        found,
    )


def _scatter(row: PoseRow) -> Reading:
    return Reading(0, None, None, None) if row.figures is None else repeatability_reading(row.figures)


def _deviation(row: PoseRow, accuracy: Mapping[str, PoseAccuracy]) -> Reading:
    one = accuracy[row.pose_id]
    interval = one.interval.position_mm
    steady = row.figures is None or row.figures.verdict != "not_steady"
    value = None if interval is None else one.figures.position_mm
    return Reading(len(row.visits), value, interval, None, steady)
