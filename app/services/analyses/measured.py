"""Repeatability and accuracy from poses that another instrument measured, with what it gives of each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from app.services.analyses.documents import advisories
from app.services.analyses.measured_accuracy import assess_measured_accuracy
from app.services.analyses.outcome import CannotAnalyse
from app.services.analyses.performance import assess_performance, of_visit
from app.services.analyses.pose_rows import Row, drift_document, row_document, row_remarks, without_outliers
from app.services.analyses.snapshot import Reading, Snapshot
from core import Advisory
from core.metrology import Figures, PoseCycles, PoseRepeatability, assess_repeatability
from core.transforms import nearest_rotation

NAMED = 5


@dataclass(frozen=True, slots=True)
class MeasuredVisit:
    """One reading as arrays: x, y, z (mm), orientation in the instrument's frame, covariance of (mm, rad)."""

    measurement_id: str
    pose_id: str
    cycle: int | None
    joint_angles_deg: list[float] | None
    position_mm: Float[np.ndarray, "3"]
    rotation: Float[np.ndarray, "3 3"] | None
    covariance: Float[np.ndarray, "6 6"] | None


def measured_visits(snapshot: Snapshot) -> list[MeasuredVisit]:
    """Return the session's readings in their fixed order.

    Raises CannotAnalyse where there are none.
    """
    if not snapshot.measured:
        raise CannotAnalyse(
            "measured_poses_missing",
            "The session holds no poses measured by another instrument.",
            "POST them to the session's measured-poses (`gridpose import` does so from a file), or leave source away "
            "to analyse the session's images.",
        )
    return [
        _visit(m.measurement_id, m.pose_id, m.cycle, snapshot.readings[m.measurement_id])
        for m in snapshot.measured
    ]


def measured_repeatability(snapshot: Snapshot, settings: Mapping[str, str]) -> dict[str, Any]:
    """Return what `GET .../repeatability?source=measured_poses` answers, but for the fields every analysis has."""
    visits = visits_by_pose(snapshot)
    rows = measured_rows(visits)
    accuracy = assess_measured_accuracy(snapshot, {row.pose_id: row.images for row in rows})
    performance = assess_performance(rows, snapshot.commanded, of_visit)
    return {
        "estimator": settings["estimator"],
        "source": settings["source"],
        "confidence_level": float(settings["confidence_level"]),
        "poses": [row_document(row, accuracy) for row in rows],
        "intrinsics": [],
        "drift": drift_document(rows),
        "distances": performance.distances,
        "approach_variation": performance.approach_variation,
        "warnings": advisories(
            (*_remarks(visits), *row_remarks(rows), *accuracy.warnings, *performance.warnings)
        ),
    }


def visits_by_pose(snapshot: Snapshot) -> dict[str, list[MeasuredVisit]]:
    """Return the session's readings pose by pose; raises CannotAnalyse where there are none."""
    visits: dict[str, list[MeasuredVisit]] = {}
    for visit in measured_visits(snapshot):
        visits.setdefault(visit.pose_id, []).append(visit)
    return visits


def measured_rows(visits: Mapping[str, list[MeasuredVisit]]) -> list[Row[MeasuredVisit]]:
    """Return every pose's row with its figures."""
    cycles = [_cycles(of_pose) for of_pose in visits.values()]
    return [
        without_outliers(Row(pose_id, of_pose, [], _told(one, figures)))
        for (pose_id, of_pose), one, figures in zip(
            visits.items(), cycles, assess_repeatability(cycles), strict=True
        )
    ]


def semidefinite(covariance: Float[np.ndarray, "6 6"]) -> Float[np.ndarray, "6 6"]:
    """Return the covariance with what rounding to few digits left of asymmetry and negative eigenvalues taken off."""
    scale = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    unit = np.where(scale > 0.0, scale, 1.0)
    correlation = np.where(np.outer(scale, scale) > 0.0, covariance / np.outer(unit, unit), 0.0)
    values, vectors = np.linalg.eigh((correlation + correlation.T) / 2.0)
    if values[0] >= 0.0:
        mended = (correlation + correlation.T) / 2.0
    else:
        mended = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return np.asarray(mended * np.outer(scale, scale))


def _visit(measurement_id: str, pose_id: str, cycle: int | None, reading: Reading) -> MeasuredVisit:
    rotation = covariance = None
    if reading.rotation is not None:
        rotation = nearest_rotation(np.array(reading.rotation, dtype=np.float64))
    if reading.covariance is not None:
        covariance = semidefinite(np.array(reading.covariance, dtype=np.float64))
    position = np.array(reading.position_mm, dtype=np.float64)
    return MeasuredVisit(
        measurement_id, pose_id, cycle, reading.joint_angles_deg, position, rotation, covariance
    )


def _cycles(visits: Sequence[MeasuredVisit]) -> PoseCycles:
    """Return a pose's cycles; orientations and covariances where every one of them has them."""
    rotations = [v.rotation for v in visits if v.rotation is not None]
    covariances = [v.covariance for v in visits if v.covariance is not None]
    return PoseCycles(
        np.array([v.position_mm for v in visits]),
        np.array(rotations) if len(rotations) == len(visits) else None,
        np.array(covariances) if len(covariances) == len(visits) else None,
    )


def _told(cycles: PoseCycles, figures: PoseRepeatability) -> PoseRepeatability:
    """Return the figures without those of the instrument where it states no covariance."""
    if cycles.covariances is not None:
        return figures
    unknown: Figures[Any] = Figures(None, None, None, None, None, None, None)
    warnings = tuple(w for w in figures.warnings if w.code != "noise_unknown")
    return replace(figures, noise_floor=unknown, corrected=unknown, warnings=warnings)


def _remarks(visits: Mapping[str, list[MeasuredVisit]]) -> list[Advisory]:
    """Say which figures are null, and why."""
    remarks = []
    positions_alone = [p for p, one in visits.items() if any(v.rotation is None for v in one)]
    if positions_alone:
        remarks.append(
            Advisory(
                "rotations_missing",
                f"{_listed(positions_alone, len(visits))}: not every reading has a rotation, so that the figures of "
                "orientation are null.",
                "Use a probe that measures all six degrees of freedom where orientation matters.",
            )
        )
    unknown = [p for p, one in visits.items() if any(v.covariance is None for v in one)]
    if unknown:
        remarks.append(
            Advisory(
                "noise_unknown",
                f"{_listed(unknown, len(visits))}: not every reading has a covariance, so that noise_floor and "
                "corrected are null, and whether the figures speak of the robot or of the instrument cannot be told.",
                "State the instrument's covariance with each reading.",
            )
        )
    return remarks


def _listed(pose_ids: Sequence[str], of: int) -> str:
    if len(pose_ids) == of and of > 1:
        return f"All {of} poses"
    noun = "Pose" if len(pose_ids) == 1 else "Poses"
    more = f" and {len(pose_ids) - NAMED} more" if len(pose_ids) > NAMED else ""
    return f"{noun} {', '.join(pose_ids[:NAMED])}{more}"
