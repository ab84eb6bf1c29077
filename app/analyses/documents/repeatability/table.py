"""The repeatability of a session as the API shows it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from app.analyses.documents.encoding import (
    AP,
    RP,
    VAP,
    camera_fields,
    figures_document,
    intervals_document,
)
from app.analyses.documents.findings import ExcludedList, Findings
from app.analyses.documents.repeatability.budget import budget_fields
from app.analyses.documents.repeatability.drift import drift_document
from app.analyses.documents.repeatability.readings import ids_of, is_image
from app.analyses.documents.repeatability.steadiness import steadiness_document
from core.calibration import ShapePrior
from core.metrology import CONFIDENCE, RULE, PerComponent, PoseAccuracy, PoseRepeatability
from core.session import (
    Approaches,
    BurstFloor,
    BurstNoise,
    PoseDistance,
    PoseRow,
    SessionAcceptance,
    SessionData,
    SessionRepeatability,
    Witness,
    WitnessMotion,
    assess_acceptance,
    assess_repeatability,
    estimate_session,
    images_of,
    refine_target,
    session_budgets,
)

_NOTHING: PerComponent[Any] = PerComponent(None, None, None, None, None, None, None)


def repeatability_findings(data: SessionData, settings: Mapping[str, str]) -> Findings:
    """Return what `GET .../repeatability` answers."""
    of_images = settings["source"] == "images"
    estimate = estimate_session(data, settings["estimator"]) if of_images else None
    shapes: Mapping[int, ShapePrior] = {}
    if estimate is not None and settings.get("refine_target") == "true":
        refined = refine_target(data, estimate)
        estimate, shapes = refined.estimate, refined.shapes
    witness = None
    if "witness" in settings:
        witness = Witness(settings["witness"], settings.get("subtract_witness") == "true")
    found = assess_repeatability(data, estimate, shapes, witness)
    budgets = session_budgets(data, found, sampled=settings.get("method") == "monte_carlo", shapes=shapes)
    performance, listed = found.performance, ExcludedList(data)
    fields = {
        "estimator": settings["estimator"],
        "source": settings["source"],
        "confidence_level": CONFIDENCE,
        "poses": [_row(row, found, listed) for row in found.poses],
        "groups": [
            camera_fields(group, covariance)
            for group, covariance in zip(
                estimate.groups if estimate is not None else (), found.camera_covariances, strict=True
            )
        ],
        "steadiness": steadiness_document(found.steadiness, found.poses),
        "witness": None if found.witness is None else _witness(found.witness),
        "drift": drift_document(found.poses, data, found.accuracy.poses),
        "bursts": _bursts(found.bursts),
        **_acceptance(assess_acceptance(data, found)),
        "distances": [_distance(one) for one in performance.distances] or None,
        "approach_variation": [_approaches(one) for one in performance.approaches] or None,
        **budget_fields(budgets),
    }
    warnings = (*found.warnings, *budgets.warnings)
    return Findings(fields, (one for row in found.poses for one in row.excluded), warnings)


def _row(row: PoseRow, found: SessionRepeatability, listed: ExcludedList) -> dict[str, Any]:
    figures, accuracy = row.figures, found.accuracy.poses.get(row.pose_id)
    without = figures.without_outliers if figures else None
    return {
        "pose_id": row.pose_id,
        "cycles": len(row.visits),
        "mean": _mean(figures),
        "repeatability": figures_document(figures.repeatability if figures else _NOTHING),
        "interval": intervals_document(figures.interval if figures else _NOTHING),
        "noise_floor": figures_document(figures.noise_floor if figures else _NOTHING),
        "corrected": figures_document(figures.corrected if figures else _NOTHING),
        "corrected_interval": intervals_document(figures.corrected_interval if figures else _NOTHING),
        "without_outliers": figures_document(without) if without else None,
        "outliers": _outliers(row),
        "including_degraded": figures_document(row.including_degraded) if row.including_degraded else None,
        "accuracy": _accuracy(accuracy) if accuracy is not None else None,
        "verdict": figures.verdict if figures else "too_few_cycles",
        "verdicts": _verdicts(figures),
        "orientation_scatter": _orientation(figures),
        "within_stops": _within_stops(None if found.bursts is None else found.bursts.poses.get(row.pose_id)),
        **ids_of(image for visit in row.visits for image in images_of(visit)),
        "excluded": listed.documents(row.excluded),
    }


def _accuracy(found: PoseAccuracy) -> dict[str, Any]:
    return {
        **figures_document(found.figures, AP),
        "ap_rotation_vector_deg": None if found.rotation is None else np.degrees(found.rotation).tolist(),
        "interval": intervals_document(found.interval, AP),
        "held_out": figures_document(found.held_out, AP),
        "degrees_of_freedom": found.degrees_of_freedom,
        "tie": "best_fit",
    }


def _bursts(found: BurstNoise | None) -> dict[str, Any] | None:
    """Return what images scatter within their stops, over what the model of the noise says."""
    if found is None:
        return None
    return {
        "stop_count": found.stops,
        "image_count": found.images,
        **{
            f"of_{name}": {"ratio_to_model": ratio, "p_value": p, "added": added}
            for name, ratio, p, added in zip(
                ("position", "orientation"), found.ratios, found.p_values, found.above_model, strict=True
            )
        },
    }


def _within_stops(found: BurstFloor | None) -> dict[str, Any] | None:
    if found is None:
        return None
    return {
        "stop_count": found.stops,
        "image_count": found.images,
        "degrees_of_freedom": float(found.degrees_of_freedom),
        "noise_floor": figures_document(found.noise_floor) if found.noise_floor else None,
    }


def _outliers(row: PoseRow) -> list[dict[str, Any]]:
    """Return the cycles that no scatter explains, which count all the same."""
    found = []
    for outlier in row.figures.outliers if row.figures else ():
        visit = row.visits[outlier.index]
        of_image = is_image(visit)
        found.append(
            {
                "measurement_id": visit.measurement_id if of_image else None,
                "measured_pose_id": None if of_image else visit.measurement_id,
                "cycle": visit.cycle,
                "code": outlier.code,
                "distance_mm": outlier.distance_mm,
                "detail": outlier.detail,
            }
        )
    return found


def _verdicts(figures: PoseRepeatability | None) -> list[dict[str, Any]]:
    found = figures.verdicts if figures else _NOTHING
    return [
        {"figure": name, "verdict": verdict}
        for name, (_, verdict) in zip(RP, found.items(), strict=True)
        if verdict is not None
    ]


def _orientation(figures: PoseRepeatability | None) -> dict[str, Any] | None:
    """Return the scatter of orientation by rotation vectors, and by angles as such."""
    if figures is None or figures.orientation is None:
        return None
    return {
        "rotation_vector_deg": np.degrees(figures.orientation.vector_xyz).tolist(),
        "roll_pitch_yaw_deg": np.degrees(figures.orientation.roll_pitch_yaw).tolist(),
    }


def _mean(figures: PoseRepeatability | None) -> dict[str, Any]:
    angles = figures.mean_roll_pitch_yaw if figures else None
    degrees = np.degrees(angles).tolist() if angles is not None else [None] * 3
    return {
        "position_mm": figures.mean_position_mm.tolist() if figures else None,
        **dict(zip(("roll_deg", "pitch_deg", "yaw_deg"), degrees, strict=True)),
    }


def _witness(motion: WitnessMotion) -> dict[str, Any]:
    u = motion.found.standard_uncertainty_mm
    return {
        "pose_id": motion.witness.pose_id,
        "moved": motion.moved,
        "subtracted": motion.witness.subtract,
        "shift_mm": motion.shift_mm.tolist(),
        "shift_distance_mm": float(np.linalg.norm(motion.shift_mm)),
        "motion": [
            {"cycle": cycle, "motion_mm": by, "motion_standard_uncertainty_mm": uncertainty}
            for cycle, by, uncertainty in zip(
                motion.cycles.tolist(), motion.found.motion_mm.tolist(), u.tolist(), strict=True
            )
        ],
    }


def _acceptance(found: SessionAcceptance) -> dict[str, Any]:
    """Return whether the robot keeps its data sheet, as far as one is stated."""
    return {
        name: one
        and {
            limit: one.limit_mm,
            worst: one.worst_mm,
            "pose_id": one.pose_id,
            "decision": one.found.decision,
            "rule": RULE,
            "reason": one.found.reason,
            "interval_mm": None if one.found.interval is None else list(one.found.interval),
            "cycles_needed": one.found.cycles_needed,
            "poses_needed": one.found.poses_needed,
        }
        for name, one, limit, worst in (
            ("acceptance", found.repeatability, "datasheet_repeatability_mm", "worst_rp_l_mm"),
            ("accuracy_acceptance", found.accuracy, "datasheet_accuracy_mm", "worst_ap_p_mm"),
        )
    }


def _distance(one: PoseDistance) -> dict[str, Any]:
    found = one.found
    return {
        "from_pose_id": one.from_pose_id,
        "to_pose_id": one.to_pose_id,
        "cycles": found.performance.cycles,
        "mean_mm": found.performance.mean_distance_mm,
        "standard_uncertainty_mm": found.standard_uncertainty_mm,
        "commanded_mm": one.commanded_mm,
        "ad_mm": found.performance.accuracy_mm,
        "ad_interval_mm": None if found.accuracy_interval_mm is None else list(found.accuracy_interval_mm),
        "rd_mm": found.performance.repeatability_mm,
        "interval_mm": None if found.interval_mm is None else list(found.interval_mm),
        "noise_floor_mm": found.noise_floor_mm,
    }


def _approaches(one: Approaches) -> dict[str, Any]:
    return {
        "directions": [
            {"approach": approach, "pose_ids": list(pose_ids), "cycles": one.visits[approach]}
            for approach, pose_ids in one.pose_ids.items()
        ],
        "variation": figures_document(one.variation.figures, VAP),
        "expected_variation": figures_document(one.variation.noise_floor, VAP),
    }
