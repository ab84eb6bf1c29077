"""The figures of poses, with intervals by what the cycles of all poses follow.

The process is the robot's: heavy tails of one pose widen the intervals of all. Three kinds of visits are no evidence
of it for other poses:

- one of another pose (`core.session.repeatability.visit_tags`), which is a mistake of a tag. It counts in its own pose;
- outliers, as far as lower ends go. A robot that slipped once may slip again, so that the others' upper ends are those
  with it; but that it slips at another pose, too, is no reason to say that this one repeats worse than it reads.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from core.metrology import CLUSTERS, CycleProcess, PerComponent, PoseRepeatability
from core.metrology import assess_repeatability as assess_cycles
from core.session.model import MeasuredPose
from core.session.repeatability.steadiness import SessionSteadiness, process_without
from core.session.repeatability.visit_tags import VisitTags
from core.session.visits import cycles_of

_Intervals = PerComponent[tuple[float, float] | None]


def figures_by_process(
    visits: Mapping[str, Sequence[MeasuredPose]], steadiness: SessionSteadiness, tags: VisitTags
) -> dict[str, PoseRepeatability]:
    """Return the figures of poses, each with a visit at least, `steadiness` without visits of other poses."""
    figures = _assessed(visits, steadiness.process)
    mistaken = {one.visit.pose_id for one in tags.mistaken}
    with_outliers = {name for name, one in figures.items() if one.outliers and name not in mistaken}
    if mistaken:
        of_all = process_without(steadiness, visits, ())
        figures |= _assessed({name: visits[name] for name in mistaken}, of_all)
    if with_outliers:
        left_out = {one.visit.measurement_id for one in tags.mistaken} | {
            visits[name][outlier.index].measurement_id
            for name in with_outliers
            for outlier in figures[name].outliers
        }
        others = {name: visits[name] for name in figures if name not in with_outliers | mistaken}
        of_others = _assessed(others, process_without(steadiness, visits, left_out))
        figures |= {name: _with_lower_ends(figures[name], one) for name, one in of_others.items()}
    return {name: figures[name] for name in visits}


def has_clusters(figures: PoseRepeatability) -> bool:
    """Return whether a part of a pose's cycles lies far from the others: it is no scatter of one process."""
    return any(warning.code in CLUSTERS for warning in figures.warnings)


def _assessed(
    visits: Mapping[str, Sequence[MeasuredPose]], process: CycleProcess
) -> dict[str, PoseRepeatability]:
    found = assess_cycles([cycles_of(of_pose) for of_pose in visits.values()], process=process)
    return dict(zip(visits, found, strict=True))


def _with_lower_ends(figures: PoseRepeatability, others: PoseRepeatability) -> PoseRepeatability:
    return replace(
        figures,
        interval=_lowered(figures.interval, others.interval),
        corrected_interval=_lowered(figures.corrected_interval, others.corrected_interval),
    )


def _lowered(one: _Intervals, other: _Intervals) -> _Intervals:
    pairs = zip(one.items(), other.items(), strict=True)
    return PerComponent(
        *(a if a is None or b is None else (min(a[0], b[0]), a[1]) for (_, a), (_, b) in pairs)
    )
