"""Repeatability of every pose of a session by ISO 9283, whatever measured it: figures, accuracy, drift, distances."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from core.calibration import SEPARATE_CAMERAS, ShapePrior
from core.errors import Advisory, listed
from core.metrology import PoseAccuracy, PoseRepeatability
from core.session.absolute_poses import absolute_poses, scale_unknown
from core.session.camera_mount import moving_poses
from core.session.commanded_poses import (
    Accuracy,
    UnitContradiction,
    assess_accuracy,
    contradicted_unit,
)
from core.session.estimate import SessionEstimate
from core.session.model import MeasuredPose, SessionData
from core.session.repeatability.confirmation import unconfirmed
from core.session.repeatability.degraded_images import degraded_warning
from core.session.repeatability.performance import Performance, assess_performance
from core.session.repeatability.pose_rows import PoseRow, PoseRows, image_rows, measured_rows
from core.session.repeatability.steadiness import (
    SessionSteadiness,
    steadiness_warnings,
    without_robot_verdict,
)
from core.session.repeatability.stops import BurstNoise, burst_warnings
from core.session.repeatability.visit_tags import (
    VisitTags,
    cycle_warnings,
    tag_warnings,
)
from core.session.repeatability.withheld import (
    measured_pose_warnings,
    print_warnings,
    unchanging_accuracy,
    unscaled_accuracy,
)
from core.session.repeatability.witness import Witness, WitnessMotion, witness_warnings
from core.session.visits import images_of, stop_mean


@dataclass(frozen=True, slots=True)
class SessionRepeatability:
    """All poses of a session in their natural order, in mm and rad.

    `poses` hold each pose's figures (None without a visit), `steadiness` whether their cycles are independent and
    identically distributed, `tags` what the tags of their visits contradict, `accuracy` those of the poses that compare
    with what was commanded, `performance` distances between poses and variation over approaches. `unscaled` are the
    poses before a target whose scale nobody states: their absolute figures have no uncertainty. `error_sources` says of
    what each error is that absolute figures share, `witness` how a witness moved, where one is named, `bursts` what
    images scatter within stops, where there are any. `units` says how measured and commanded poses contradict one
    another in their unit; None where they do not. `camera_covariances` are those of the estimate's focus groups, with
    what the prints may depart by in shape.
    """

    poses: tuple[PoseRow, ...]
    steadiness: SessionSteadiness
    tags: VisitTags
    accuracy: Accuracy
    performance: Performance
    unscaled: frozenset[str]
    error_sources: tuple[str, ...]
    camera_covariances: tuple[Float[np.ndarray, "s s"], ...]
    witness: WitnessMotion | None
    bursts: BurstNoise | None
    units: UnitContradiction | None
    warnings: tuple[Advisory, ...]


def assess_repeatability(
    data: SessionData,
    estimate: SessionEstimate | None = None,
    shapes: Mapping[int, ShapePrior] | None = None,
    witness: Witness | None = None,
) -> SessionRepeatability:
    """Assess the repeatability and accuracy of every pose of a session by ISO 9283.

    Parameters
    ----------
    data
        The session.
    estimate
        Its cameras and poses (`core.session.estimate_session`); figures are of the camera in its target's frame, of
        the target in the frame of a fixed camera. None: the poses that another instrument measured, in that
        instrument's frame.
    shapes
        What is known of the prints, by the target's place in the session's list, in place of what the targets state:
        of a target whose shape was estimated (`core.session.RefinedTarget.shapes`).

    witness
        A pose revisited in every cycle, whose slow motion is reported, and subtracted from repeatability if it says so.

    Returns figures in mm and rad with 95 % intervals and the part of the instrument.

    Raises MeasuredPosesMissing where there is neither, WitnessUnusable for a witness without five numbered cycles.

    References
    ----------
    ISO 9283:1998, 7.2 (AP, RP), 7.2.3 (vAP), 7.3 (AD, RD), 7.6 (drift).
    """
    assessed, withheld = (
        (measured_rows(data, witness), ()) if estimate is None else _confirmed_rows(data, estimate, witness)
    )
    rows = assessed.rows
    visits = {row.pose_id: row.visits for row in rows if row.visits}
    absolute: Mapping[str, tuple[MeasuredPose, ...]] = visits
    before = measured_pose_warnings(data) if estimate is None else estimate.warnings
    of_prints: tuple[Advisory, ...] = ()
    sources: tuple[str, ...] = ()
    cameras: tuple[Float[np.ndarray, "s s"], ...] = ()
    if estimate is not None:
        found = absolute_poses(data, estimate, shapes)
        moving = {pose.measurement_id: pose for pose in moving_poses(data, list(found.poses.values()))}
        absolute = {
            pose_id: tuple(
                stop_mean([moving[image.measurement_id] for image in images_of(visit)]) for visit in of_pose
            )
            for pose_id, of_pose in visits.items()
        }
        of_prints, sources, cameras = found.warnings, found.sources, found.cameras
    unscaled = frozenset(
        pose_id for pose_id, of_pose in visits.items() if scale_unknown(data, shapes or {}, of_pose[0])
    )
    unchanging = {
        row.pose_id
        for row in rows
        if row.figures is not None and row.figures.repeatability.position_mm == 0.0
    }
    accuracy = assess_accuracy(data, absolute, assessed.steadiness.process)
    accuracy = replace(
        accuracy,
        poses={
            pose_id: _with_known_interval(
                one, scaled=pose_id not in unscaled, changing=pose_id not in unchanging
            )
            for pose_id, one in accuracy.poses.items()
        },
    )
    units = contradicted_unit(absolute, data.commanded)
    performance = assess_performance(
        visits,
        absolute,
        data.commanded,
        process=assessed.steadiness.process,
        unscaled=unscaled,
        one_camera=estimate is None or estimate.estimator not in SEPARATE_CAMERAS,
    )
    if not accuracy.poses and not performance.distances:
        of_prints = ()
    ways = [way.found for way in performance.distances]
    of_prints = print_warnings(of_prints, accuracy.poses.values(), ways, sources)
    return SessionRepeatability(
        rows,
        assessed.steadiness,
        assessed.tags,
        accuracy,
        performance,
        unscaled,
        sources,
        cameras,
        assessed.witness,
        assessed.bursts,
        units,
        (
            *_unit_warning(units),
            *cycle_warnings(visits),
            *tag_warnings(assessed.tags),
            *before,
            *of_prints,
            *_row_warnings(rows),
            *withheld,
            *burst_warnings(assessed.bursts),
            *_outlier_warnings(rows, assessed),
            *steadiness_warnings(assessed.steadiness, instrument=bool(data.measured)),
            *witness_warnings(assessed.witness, visits),
            *accuracy.warnings,
            *performance.warnings,
        ),
    )


def _with_known_interval(accuracy: PoseAccuracy, *, scaled: bool, changing: bool) -> PoseAccuracy:
    """Return AP with its interval where the scale is stated and the readings change."""
    if not changing:
        return unchanging_accuracy(accuracy)
    return accuracy if scaled else unscaled_accuracy(accuracy)


def _confirmed_rows(
    data: SessionData, estimate: SessionEstimate, witness: Witness | None
) -> tuple[PoseRows, tuple[Advisory, ...]]:
    """Return the rows, those without the verdict `robot` that the session's common camera does not confirm."""
    assessed = image_rows(data, estimate, witness)

    def figures_of(one: SessionEstimate) -> dict[str, PoseRepeatability]:
        found = assessed if one is estimate else image_rows(data, one, witness)
        return {row.pose_id: row.figures for row in found.rows if row.figures is not None}

    held, warnings = unconfirmed(data, estimate, figures_of)
    rows = (
        replace(row, figures=without_robot_verdict(row.figures))
        if row.figures is not None and row.pose_id in held
        else row
        for row in assessed.rows
    )
    return replace(assessed, rows=tuple(rows)), warnings


def _unit_warning(units: UnitContradiction | None) -> list[Advisory]:
    if units is None:
        return []
    return [
        Advisory(
            "units_contradict",
            f"Measured distances between poses are {units.scale:.2g} times the commanded ones: almost surely "
            f"{units.guess}. Every length is wrong by that, and nothing is decided by it.",
            "Delete the measured poses and import them with their unit (`gridpose measured-poses import "
            "--length-unit`), or store the commanded poses in mm.",
        )
    ]


def _row_warnings(rows: Sequence[PoseRow]) -> list[Advisory]:
    """Return the poses' own warnings, those of one code together."""
    kinds: dict[str, list[tuple[str, Advisory]]] = {}
    for row in rows:
        for warning in row.figures.warnings if row.figures else ():
            kinds.setdefault(warning.code, []).append((row.pose_id, warning))
    warnings = degraded_warning(
        {
            row.pose_id: [one.measurement_id for one in row.excluded if one.code == "image_degraded"]
            for row in rows
            if row.including_degraded is not None
        }
    )
    for code, found in kinds.items():
        first = found[0][1]
        noun, also = ("Pose", "") if len(found) == 1 else ("Poses", " (of the first)")
        names = listed(pose_id for pose_id, _ in found)
        warnings.append(Advisory(code, f"{noun} {names}: {first.detail}{also}", first.advice))
    return warnings


def _outlier_warnings(rows: Sequence[PoseRow], assessed: PoseRows) -> list[Advisory]:
    """Name the poses and cycles of outliers, which count, but not those of which another warning says what they are."""
    named = []
    of_images = False
    mistaken = {id(one.visit) for one in assessed.tags.mistaken}
    bumped = {one.cycle for one in assessed.steadiness.found.displaced}
    for row in rows:
        for outlier in row.figures.outliers if row.figures else ():
            cycle = row.visits[outlier.index].cycle
            if id(row.visits[outlier.index]) in mistaken or cycle in bumped:
                continue
            of_images |= row.visits[outlier.index].image is not None
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
            "excluded with its reason, and the cycle repeated."
            if of_images
            else "Look at the readings of these cycles. A slip of the robot belongs to its repeatability; a wrong "
            "reading can be deleted (`gridpose measured-poses delete`), and the cycle repeated.",
        )
    ]
