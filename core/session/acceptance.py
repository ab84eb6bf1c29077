"""Whether the robot keeps its data sheet, decided of all poses of a session together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from core.metrology import Acceptance, Reading, decide
from core.session.model import Datasheet
from core.session.repeatability import PoseRow


@dataclass(frozen=True, slots=True)
class RepeatabilityAcceptance:
    """The decision on the RP_l of a data sheet, mm.

    `pose_id` is the pose that decides, and None where none can; `worst_mm` is the largest RP_l of all poses as
    measured, None without a figure.
    """

    limit_mm: float
    worst_mm: float | None
    pose_id: str | None
    found: Acceptance


def assess_acceptance(rows: Sequence[PoseRow], datasheet: Datasheet) -> RepeatabilityAcceptance | None:
    """Decide whether every pose keeps the data sheet's RP_l; None where the data sheet states none, or no pose counts.

    The corrected figure is compared, with its interval: the limit is the robot's, and the instrument adds to what is
    measured. Where no interval of the corrected figure is known, the upper limit of the figure as measured can still
    show that the robot keeps the limit, but nothing that it does not.
    """
    limit = datasheet.repeatability_mm
    counting = [row for row in rows if row.visits]
    if limit is None or not counting:
        return None
    found = decide(limit, [_reading(row) for row in counting])
    measured = [row.figures.repeatability.position_mm for row in counting if row.figures is not None]
    return RepeatabilityAcceptance(
        limit,
        max((value for value in measured if value is not None), default=None),
        None if found.reading is None else counting[found.reading].pose_id,
        found,
    )


def _reading(row: PoseRow) -> Reading:
    figures = row.figures
    if figures is None or figures.interval.position_mm is None:
        return Reading(len(row.visits), None, None, None)
    corrected = figures.corrected_interval.position_mm
    return Reading(
        figures.n,
        None if corrected is None else figures.corrected.position_mm,
        corrected,
        figures.interval.position_mm[1],
        figures.verdict != "not_steady",
    )
