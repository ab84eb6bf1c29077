"""Repeatability of every pose of a session by ISO 9283, whatever measured it: figures, accuracy, drift, distances."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Int

from core.calibration import ShapePrior
from core.errors import Advisory, listed
from core.metrology import Drift, PerComponent, PoseCycles, PoseRepeatability, Verdict, drift
from core.metrology import assess_repeatability as assess_cycles
from core.session.absolute_poses import absolute_poses
from core.session.commanded_poses import Accuracy, assess_accuracy
from core.session.confirmation import unconfirmed
from core.session.degraded_images import DEGRADED, degraded_images, degraded_warning, exclude_degraded
from core.session.measured_pose_warnings import measured_pose_warnings
from core.session.model import (
    ExcludedMeasurement,
    MeasuredPose,
    SessionData,
    SessionEstimate,
    readings,
)
from core.session.performance import Performance, assess_performance
from core.session.steadiness import SessionSteadiness, not_steady, session_steadiness, steadiness_warnings

DRIFT_BLOCK = 10
"""Cycles of one block of drift."""


@dataclass(frozen=True, slots=True)
class PoseRow:
    """One pose: the visits that count for it, in order, those that do not, and its figures.

    `including_degraded` is the repeatability with the cycles that do not count because their images are degraded
    (`core.session.degraded_images`); None without such cycles.
    """

    pose_id: str
    visits: tuple[MeasuredPose, ...]
    excluded: tuple[ExcludedMeasurement, ...]
    figures: PoseRepeatability | None
    including_degraded: PerComponent[float | None] | None = None


@dataclass(frozen=True, slots=True)
class SessionRepeatability:
    """All poses of a session in their natural order, in mm and rad.

    `poses` hold each pose's figures (None without a visit), `steadiness` whether their cycles are independent and
    identically distributed, `accuracy` those of the poses that compare with what was commanded, `performance` distances
    between poses and variation over approaches.
    """

    poses: tuple[PoseRow, ...]
    steadiness: SessionSteadiness
    accuracy: Accuracy
    performance: Performance
    warnings: tuple[Advisory, ...]


def assess_repeatability(
    data: SessionData,
    estimate: SessionEstimate | None = None,
    shapes: Mapping[int, ShapePrior] | None = None,
) -> SessionRepeatability:
    """Assess the repeatability and accuracy of every pose of a session by ISO 9283.

    Parameters
    ----------
    data
        The session.
    estimate
        Its cameras and poses (`core.session.estimation.estimate_session`), each pose in its target's frame; None: the
        poses that another instrument measured, in that instrument's frame.
    shapes
        What is known of the prints, by the target's place in the session's list, in place of what the targets state:
        of a target whose shape was estimated (`core.session.targets.RefinedTarget.shapes`).

    Returns figures in mm and rad with 95 % intervals and the part of the instrument.

    Raises MeasuredPosesMissing where there is neither.

    References
    ----------
    ISO 9283:1998, 7.2 (AP, RP), 7.2.3 (vAP), 7.3 (AD, RD), 7.6 (drift).
    """
    assessed, withheld = (measured_rows(data), ()) if estimate is None else _confirmed_rows(data, estimate)
    rows = assessed.rows
    visits = {row.pose_id: row.visits for row in rows if row.visits}
    absolute: Mapping[str, tuple[MeasuredPose, ...]] = visits
    before = measured_pose_warnings(data) if estimate is None else estimate.warnings
    of_prints: tuple[Advisory, ...] = ()
    if estimate is not None:
        found = absolute_poses(data, estimate, shapes)
        absolute = {
            pose_id: tuple(found.poses[visit.measurement_id] for visit in of_pose)
            for pose_id, of_pose in visits.items()
        }
        of_prints = found.warnings
    accuracy = assess_accuracy(data, absolute)
    performance = assess_performance(visits, absolute, data.commanded)
    if not accuracy.poses and not performance.distances:
        of_prints = ()
    return SessionRepeatability(
        rows,
        assessed.steadiness,
        accuracy,
        performance,
        (
            *before,
            *of_prints,
            *_row_warnings(rows),
            *withheld,
            *_outlier_warnings(rows),
            *steadiness_warnings(assessed.steadiness),
            *accuracy.warnings,
            *performance.warnings,
        ),
    )


@dataclass(frozen=True, slots=True)
class PoseRows:
    """All poses of a session in their natural order, and whether their cycles are steady."""

    rows: tuple[PoseRow, ...]
    steadiness: SessionSteadiness


def _confirmed_rows(data: SessionData, estimate: SessionEstimate) -> tuple[PoseRows, tuple[Advisory, ...]]:
    """Return the rows, those without the verdict `robot` that the session's common camera does not confirm."""

    def figures_of(one: SessionEstimate) -> dict[str, PoseRepeatability]:
        return {row.pose_id: row.figures for row in image_rows(data, one).rows if row.figures is not None}

    held, warnings = unconfirmed(data, estimate, figures_of)
    assessed = image_rows(data, estimate)
    rows = (
        replace(row, figures=_without_robot_verdict(row.figures))
        if row.figures is not None and row.pose_id in held
        else row
        for row in assessed.rows
    )
    return PoseRows(tuple(rows), assessed.steadiness), warnings


def image_rows(data: SessionData, estimate: SessionEstimate) -> PoseRows:
    """Sort the images by pose, one target a pose, and compute every pose's figures."""
    found = {pose.measurement_id: pose for pose in estimate.poses}
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
    assessed = _rows(visits, excluded, estimate.unsteady | estimate.differing)
    with_all = assess_cycles([_cycles(of_pose) for of_pose in whole.values()])
    figures = {pose_id: one.repeatability for pose_id, one in zip(whole, with_all, strict=True)}
    rows = (replace(row, including_degraded=figures.get(row.pose_id)) for row in assessed.rows)
    return PoseRows(tuple(rows), assessed.steadiness)


def measured_rows(data: SessionData) -> PoseRows:
    """Sort what another instrument measured by pose, and compute every pose's figures.

    Raises MeasuredPosesMissing.
    """
    visits: dict[str, list[MeasuredPose]] = {}
    for pose in readings(data):
        visits.setdefault(pose.pose_id, []).append(pose)
    return _rows(visits, {}, frozenset())


def drift_of(row: PoseRow) -> tuple[Int[np.ndarray, " n"], Drift] | None:
    """Return the cycles that are numbered, and the drift over them; None where there are not two blocks of cycles."""
    visits = [visit for visit in row.visits if visit.cycle is not None]
    if len(visits) < 2 * DRIFT_BLOCK:
        return None
    rotations = [visit.rotation for visit in visits if visit.rotation is not None]
    found = drift(
        np.array([visit.position_mm for visit in visits]),
        np.array(rotations) if len(rotations) == len(visits) else None,
        block=DRIFT_BLOCK,
    )
    return np.array([visit.cycle for visit in visits], dtype=np.intp), found


def _rows(
    visits: Mapping[str, Sequence[MeasuredPose]],
    excluded: Mapping[str, Sequence[ExcludedMeasurement]],
    unreliable: frozenset[str],
) -> PoseRows:
    several = [pose_id for pose_id in visits if visits[pose_id]]
    cycles = {pose_id: _cycles(visits[pose_id]) for pose_id in several}
    steadiness = session_steadiness(visits)
    assessed = assess_cycles(list(cycles.values()), process=steadiness.process)
    assessed_poses = zip(several, assessed, strict=True)
    figures = {pose_id: _without_instrument(cycles[pose_id], one) for pose_id, one in assessed_poses}
    figures |= {
        pose_id: _without_robot_verdict(figures[pose_id]) for pose_id in several if pose_id in unreliable
    }
    # Where the instrument is known to be the cause, its verdict says more.
    figures |= {
        pose_id: not_steady(figures[pose_id]) for pose_id in steadiness.moved if pose_id not in unreliable
    }
    rows = (
        PoseRow(pose_id, tuple(visits[pose_id]), tuple(excluded.get(pose_id, ())), figures.get(pose_id))
        for pose_id in visits
    )
    return PoseRows(tuple(rows), steadiness)


def _cycles(visits: Sequence[MeasuredPose]) -> PoseCycles:
    """Return a pose's cycles; orientations and covariances where every one of them has them."""
    rotations = [visit.rotation for visit in visits if visit.rotation is not None]
    scatter = [visit.scatter for visit in visits if visit.scatter is not None]
    return PoseCycles(
        np.array([visit.position_mm for visit in visits]),
        np.array(rotations) if len(rotations) == len(visits) else None,
        np.array(scatter) if len(scatter) == len(visits) else None,
    )


def _without_instrument(cycles: PoseCycles, figures: PoseRepeatability) -> PoseRepeatability:
    """Return the figures without those of the instrument where it states no covariance."""
    if cycles.covariances is not None:
        return figures
    unknown: PerComponent[Any] = PerComponent(None, None, None, None, None, None, None)
    warnings = tuple(w for w in figures.warnings if w.code != "noise_unknown")
    return replace(figures, noise_floor=unknown, corrected=unknown, warnings=warnings)


def _without_robot_verdict(figures: PoseRepeatability) -> PoseRepeatability:
    """Return the figures of a pose that scatters by its camera's change, or by what its images do not all show.

    No verdict is `robot`, and nothing is subtracted from the figures: the instrument's share is not known.
    """

    def judged(verdict: Verdict | None) -> Verdict | None:
        return Verdict.INSTRUMENT_LIMITED if verdict == Verdict.ROBOT else verdict

    return replace(
        figures,
        verdict=judged(figures.verdict) or figures.verdict,
        verdicts=PerComponent(*(judged(verdict) for _, verdict in figures.verdicts.items())),
        corrected=figures.repeatability,
        corrected_interval=PerComponent(None, None, None, None, None, None, None),
    )


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


def _row_warnings(rows: Sequence[PoseRow]) -> list[Advisory]:
    """Return the poses' own warnings, those of one code together."""
    kinds: dict[str, list[tuple[str, Advisory]]] = {}
    for row in rows:
        for warning in row.figures.warnings if row.figures else ():
            kinds.setdefault(warning.code, []).append((row.pose_id, warning))
    warnings = degraded_warning(
        {
            row.pose_id: [one.measurement_id for one in row.excluded if one.code == DEGRADED]
            for row in rows
            if row.including_degraded is not None
        }
    )
    for code, found in kinds.items():
        first = found[0][1]
        noun, also = ("Pose", "") if len(found) == 1 else ("Poses", " (of the first)")
        names = listed(pose_id for pose_id, _ in found)
        warnings.append(Advisory(code, f"{noun} {names}: {first.detail}{also}", first.advice))
    if not any(len(row.visits) > 1 for row in rows):
        warnings.append(
            Advisory(
                "too_few_cycles",
                "No pose has two images that count, so that nothing is known of repeatability.",
                "Visit every pose again: the standard asks for 30 cycles.",
            )
        )
    return warnings


def _outlier_warnings(rows: Sequence[PoseRow]) -> list[Advisory]:
    """Name the poses and cycles of outliers, which count."""
    named = []
    for row in rows:
        for outlier in row.figures.outliers if row.figures else ():
            cycle = row.visits[outlier.index].cycle
            named.append(
                f"{row.pose_id} {f'cycle {cycle}' if cycle is not None else 'without a cycle number'}"
            )
    if not named:
        return []
    return [
        Advisory(
            "outliers",
            f"Cycles that the scatter of the others does not explain: {listed(named)}. They count, as ISO 9283 "
            "demands; without_outliers has the figures of the others.",
            "Look at the images of these cycles. A slip of the robot belongs to its repeatability; a bad image can be "
            "excluded with its reason, and the cycle repeated.",
        )
    ]
