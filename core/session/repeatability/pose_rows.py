"""The poses of a session with the visits that count, those that do not and why, and the figures of each pose.

The process that cycles follow is the robot's: heavy tails of one pose widen the intervals of all. Two kinds of visits
are no evidence of it for other poses. A visit of another pose (`core.session.repeatability.visit_tags`) is a mistake of
a tag. Outliers say nothing of lower ends: a robot that slipped once may slip again, so that the others' upper ends are
those with it; but that it slips at another pose, too, is no reason to say that this one repeats worse than it reads.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Int

from core.metrology import (
    CLUSTERS,
    AccuracyDrift,
    CycleProcess,
    Drift,
    PerComponent,
    PoseAccuracy,
    PoseRepeatability,
    accuracy_drift,
    are_unchanging,
    drift,
    find_resolution,
)
from core.metrology import assess_repeatability as assess_cycles
from core.session.camera_mount import moving_poses
from core.session.estimate import ExcludedMeasurement, SessionEstimate
from core.session.model import MeasuredPose, SessionData, readings
from core.session.repeatability.degraded_images import degraded_images, exclude_degraded
from core.session.repeatability.steadiness import (
    SessionSteadiness,
    not_steady,
    process_without,
    session_steadiness,
    without_robot_verdict,
)
from core.session.repeatability.stops import BurstNoise, burst_noise, with_burst_noise
from core.session.repeatability.visit_tags import VisitTags, visit_tags
from core.session.repeatability.witness import Witness, WitnessMotion, without_motion, witness_motion
from core.session.visits import cycles_of, merge_bursts, positions_of, rotations_of

_Intervals = PerComponent[tuple[float, float] | None]

DRIFT_BLOCK = 10
"""Cycles of one block of drift."""


@dataclass(frozen=True, slots=True)
class PoseRow:
    """One pose: the visits that count for it, in order, those that do not, and its figures.

    Images of one burst are one visit (`core.session.repeatability.stops`).

    `including_degraded` is the repeatability with the cycles that do not count because their images are degraded
    (`core.session.repeatability.degraded_images`); None without such cycles.
    """

    pose_id: str
    visits: tuple[MeasuredPose, ...]
    excluded: tuple[ExcludedMeasurement, ...]
    figures: PoseRepeatability | None
    including_degraded: PerComponent[float | None] | None = None


@dataclass(frozen=True, slots=True)
class PoseRows:
    """All poses of a session in their natural order, whether their cycles are steady, what the tags of their visits
    contradict, how a witness moved, and how the images of bursts scatter; None without a burst.
    """

    rows: tuple[PoseRow, ...]
    steadiness: SessionSteadiness
    tags: VisitTags
    witness: WitnessMotion | None = None
    bursts: BurstNoise | None = None


def image_rows(data: SessionData, estimate: SessionEstimate, witness: Witness | None = None) -> PoseRows:
    """Sort the images by pose, one target a pose, and compute every pose's figures.

    Raises InvalidArgument for a witness that was not visited often enough.
    """
    found = {pose.measurement_id: pose for pose in moving_poses(data, estimate.poses)}
    visits: dict[str, list[MeasuredPose]] = {}
    excluded: dict[str, list[ExcludedMeasurement]] = {}
    for image in data.images:
        visits.setdefault(image.pose_id, [])
        excluded.setdefault(image.pose_id, [])
        if image.measurement_id in estimate.unclear:
            excluded[image.pose_id].append(estimate.unclear[image.measurement_id])
        elif image.measurement_id in found:
            visits[image.pose_id].append(found[image.measurement_id])
        else:
            excluded[image.pose_id].append(estimate.excluded[image.measurement_id])
    for pose_id in visits:
        visits[pose_id], others = _of_one_target(visits[pose_id])
        excluded[pose_id] += others
    degraded = degraded_images(estimate)
    whole: dict[str, list[MeasuredPose]] = {}
    for pose_id in visits:
        counted, others = exclude_degraded(visits[pose_id], degraded)
        if others:
            whole[pose_id] = visits[pose_id]
            visits[pose_id] = counted
            excluded[pose_id] += others
    stops = {pose_id: merge_bursts(of_pose) for pose_id, of_pose in visits.items()}
    bursts = burst_noise(stops)
    assessed = _rows(
        data, with_burst_noise(stops, bursts), excluded, estimate.unsteady | estimate.differing, witness
    )
    with_all = assess_cycles([cycles_of(merge_bursts(of_pose)) for of_pose in whole.values()])
    figures = {pose_id: one.repeatability for pose_id, one in zip(whole, with_all, strict=True)}
    rows = (replace(row, including_degraded=figures.get(row.pose_id)) for row in assessed.rows)
    return replace(assessed, rows=tuple(rows), bursts=bursts)


def measured_rows(data: SessionData, witness: Witness | None = None) -> PoseRows:
    """Sort what another instrument measured by pose, and compute every pose's figures.

    Raises MeasuredPosesMissing, and as `image_rows`.
    """
    visits: dict[str, list[MeasuredPose]] = {}
    for pose in readings(data):
        visits.setdefault(pose.pose_id, []).append(pose)
    return _rows(data, visits, {}, frozenset(), witness)


def drift_of(row: PoseRow) -> tuple[Int[np.ndarray, " n"], Drift] | None:
    """Return the cycles that are numbered, and the drift over them; None where there are not two blocks of cycles, or
    readings do not change.
    """
    visits = [visit for visit in row.visits if visit.cycle is not None]
    if len(visits) < 2 * DRIFT_BLOCK:
        return None
    positions = positions_of(visits)
    if are_unchanging(positions):
        return None
    resolution = find_resolution(positions)
    found = drift(
        positions,
        rotations_of(visits),
        block=DRIFT_BLOCK,
        step_mm=None if resolution is None else resolution.step_mm,
    )
    return np.array([visit.cycle for visit in visits], dtype=np.intp), found


def accuracy_drift_of(row: PoseRow, accuracy: PoseAccuracy | None, found: Drift) -> AccuracyDrift | None:
    """Return AP over the blocks of `found`, the drift of `drift_of`, and dAP; None where AP is not determined."""
    if accuracy is None:
        return None
    visits = [visit for visit in row.visits if visit.cycle is not None]
    return accuracy_drift(
        accuracy,
        positions_of(visits),
        rotations_of(visits),
        [(block.first_cycle - 1, block.last_cycle) for block in found.blocks],
    )


def _rows(
    data: SessionData,
    visits: Mapping[str, Sequence[MeasuredPose]],
    excluded: Mapping[str, Sequence[ExcludedMeasurement]],
    unreliable: frozenset[str],
    witness: Witness | None,
) -> PoseRows:
    motion = None if witness is None else witness_motion(visits, witness)
    if motion is not None and motion.witness.subtract:
        visits = without_motion(visits, motion)
    several = [pose_id for pose_id in visits if visits[pose_id]]
    tags = visit_tags(visits, data.targets, data.camera_mount)
    # What differs between focus groups is no motion.
    steadiness = session_steadiness(
        {p: of_pose for p, of_pose in visits.items() if p not in tags.mixed},
        {one.visit.measurement_id for one in tags.mistaken},
    )
    found = _figures_by_process({p: visits[p] for p in several}, steadiness, tags)
    figures = {pose_id: _noise_unknown_said(one) for pose_id, one in found.items()}
    figures |= {
        pose_id: without_robot_verdict(figures[pose_id]) for pose_id in several if pose_id in unreliable
    }
    # Where the instrument is known to be the cause, its verdict says more.
    apart = [pose_id for pose_id in several if has_clusters(figures[pose_id])]
    figures |= {
        pose_id: not_steady(figures[pose_id])
        for pose_id in (*steadiness.moved, *apart)
        if pose_id not in unreliable
    }
    figures = {pose_id: tags.judged(pose_id, one) for pose_id, one in figures.items()}
    rows = (
        PoseRow(pose_id, tuple(visits[pose_id]), tuple(excluded.get(pose_id, ())), figures.get(pose_id))
        for pose_id in visits
    )
    return PoseRows(tuple(rows), steadiness, tags, motion)


def _figures_by_process(
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
        excluded = {one.visit.measurement_id for one in tags.mistaken} | {
            visits[name][outlier.index].measurement_id
            for name in with_outliers
            for outlier in figures[name].outliers
        }
        others = {name: visits[name] for name in figures if name not in with_outliers | mistaken}
        of_others = _assessed(others, process_without(steadiness, visits, excluded))
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


def figures_by_itself(row: PoseRow) -> PoseRepeatability | None:
    """Return a pose's figures with intervals by what its own cycles show of their process; None without a visit.

    The process of all poses together is known better, and is that of the pose only if the poses are of one kind.
    """
    if not row.visits:
        return None
    process = session_steadiness({row.pose_id: row.visits}).process
    return assess_cycles([cycles_of(row.visits)], process=process)[0]


def _noise_unknown_said(figures: PoseRepeatability) -> PoseRepeatability:
    """Return the figures without the warning that the session gives for all its poses."""
    return replace(figures, warnings=tuple(w for w in figures.warnings if w.code != "noise_unknown"))


def _of_one_target(
    visits: list[MeasuredPose],
) -> tuple[list[MeasuredPose], list[ExcludedMeasurement]]:
    """Return the visits before the target that most show; frames of different targets do not compare."""
    counts = Counter(visit.frame for visit in visits)
    if len(counts) < 2:
        return visits, []
    frame = min(counts, key=lambda frame: (-counts[frame], frame))
    detail = (
        "Most images of this pose show another of the session's targets, whose frame this pose is given in."
    )
    others = [
        ExcludedMeasurement(visit.measurement_id, "images_of_other_target", detail)
        for visit in visits
        if visit.frame != frame
    ]
    return [visit for visit in visits if visit.frame == frame], others
