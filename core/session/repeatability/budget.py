"""Uncertainty budgets of a session's headline figures: RP_l, its corrected value, the noise floor, AP and AD."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum

from core.calibration import ShapePrior
from core.errors import Advisory
from core.metrology import (
    Budget,
    CycleProcess,
    accuracy_budget,
    corrected_budget,
    distance_budget,
    floor_budget,
    long_run_draws,
    repeatability_budget,
)
from core.session.absolute_poses import stated_scale
from core.session.model import SessionData
from core.session.repeatability.assessment import SessionRepeatability
from core.session.repeatability.pose_rows import PoseRow
from core.session.repeatability.steadiness import equal_deviations
from core.session.visits import images_of

MAX_POSES = 40
"""Of more poses those of the largest RP_l have budgets."""
TRIALS = 20_000
"""Draws of each input: the ends of a 95 % interval are known to about 2 % of its width."""


class Figure(StrEnum):
    """The figures that have a budget, by their place in the analysis."""

    READING = "repeatability.rp_l_mm"
    CORRECTED = "corrected.rp_l_mm"
    FLOOR = "noise_floor.rp_l_mm"
    ACCURACY = "accuracy.ap_p_mm"
    DISTANCE = "distances.ad_mm"


@dataclass(frozen=True, slots=True)
class FigureBudget:
    """The budget of one figure of a pose, of a distance that from `pose_id` to `to_pose_id`, and its 95 % interval as
    the analysis states it, mm; None where it has none.
    """

    figure: Figure
    pose_id: str
    to_pose_id: str | None
    budget: Budget
    interval_mm: tuple[float, float] | None


@dataclass(frozen=True, slots=True)
class SessionBudgets:
    """Budgets, the poses' in natural order before the distances', and what to know of them."""

    budgets: tuple[FigureBudget, ...]
    warnings: tuple[Advisory, ...]


def session_budgets(
    data: SessionData,
    found: SessionRepeatability,
    *,
    sampled: bool = False,
    shapes: Mapping[int, ShapePrior] | None = None,
) -> SessionBudgets:
    """Return the budgets of a session's figures; `sampled`, each is recomputed by draws of its inputs as well.

    `shapes` as of `assess_repeatability`.
    """
    rows = [row for row in found.poses if row.figures is not None and row.visits]
    warnings: tuple[Advisory, ...] = ()
    if len(rows) > MAX_POSES:
        largest = sorted(rows, key=_reading, reverse=True)[:MAX_POSES]
        warnings = (
            Advisory(
                "budget_truncated",
                f"Of {len(rows)} poses, the {MAX_POSES} of the largest RP_l have a budget.",
                "Put the poses whose budget matters into a session of their own.",
            ),
        )
        rows = [row for row in rows if row in largest]
    trials = TRIALS if sampled else None
    freedom = sum(
        sum(len(images_of(visit)) for visit in row.visits) - 1
        for row in found.poses
        if row.visits and row.visits[0].image is not None
    )
    known = dict(shapes or {})
    budgets: list[FigureBudget] = []
    for row in rows:
        scale = stated_scale(data, known, row.visits[0])
        budgets += _of_cycles(row, found.steadiness.process, freedom or None, scale, trials)
        accuracy = found.accuracy.poses.get(row.pose_id)
        interval = None if accuracy is None else accuracy.interval.position_mm
        if accuracy is None or interval is None:
            continue
        if accuracy.parts is not None and accuracy.figures.position_mm is not None:
            budget = accuracy_budget(
                accuracy.figures.position_mm, accuracy.parts, found.error_sources, trials
            )
            budgets.append(FigureBudget(Figure.ACCURACY, row.pose_id, None, budget, interval))
    for way in found.performance.distances:
        of_way = distance_budget(way.found, found.error_sources, trials)
        if of_way is not None:
            budgets.append(
                FigureBudget(
                    Figure.DISTANCE, way.from_pose_id, way.to_pose_id, of_way, way.found.accuracy_interval_mm
                )
            )
    return SessionBudgets(tuple(budgets), warnings)


def _reading(row: PoseRow) -> float:
    return (row.figures and row.figures.repeatability.position_mm) or 0.0


def _of_cycles(
    row: PoseRow, process: CycleProcess, freedom: int | None, scale: float | None, trials: int | None
) -> Iterator[FigureBudget]:
    """Yield the budgets of RP_l, of the noise floor and of the corrected RP_l, as far as they are known."""
    figures = row.figures
    assert figures is not None
    reading, interval = figures.repeatability.position_mm, figures.interval.position_mm
    if not reading or interval is None:
        return
    long_run = (
        None if trials is None else long_run_draws(process, equal_deviations(row.visits), interval, trials)
    )
    yield FigureBudget(
        Figure.READING, row.pose_id, None, repeatability_budget(reading, interval, scale, long_run), interval
    )
    floor, corrected = figures.noise_floor.position_mm, figures.corrected.position_mm
    if not floor:
        return
    if freedom is not None and row.visits[0].image is not None:
        yield FigureBudget(Figure.FLOOR, row.pose_id, None, floor_budget(floor, freedom, scale, trials), None)
    left = figures.corrected_interval.position_mm
    if corrected and left is not None:
        of_images = freedom if row.visits[0].image is not None else None
        budget = corrected_budget(corrected, reading, interval, floor, of_images, scale, long_run)
        yield FigureBudget(Figure.CORRECTED, row.pose_id, None, budget, left)
