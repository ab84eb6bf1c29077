"""Drift of the poses over their cycles and over time as the API shows it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from core.metrology import PoseAccuracy, drift_rate, length_standard_error, shift_degrees_of_freedom
from core.session import MeasuredPose, PoseRow, SessionData, accuracy_drift_of, drift_of, images_of


def drift_document(
    rows: Sequence[PoseRow], data: SessionData, accuracy: Mapping[str, PoseAccuracy]
) -> dict[str, Any] | None:
    """Return how each pose moved from its first cycles to its last, where there are two blocks of cycles."""
    documents = [
        found for row in rows if (found := _of_pose(row, data, accuracy.get(row.pose_id))) is not None
    ]
    if not documents:
        return None
    is_timed = any(one["duration_h"] is not None for one in documents)
    return {
        "against": "time" if is_timed else "cycle",
        "time_source": data.time_source,
        "poses": documents,
    }


def _of_pose(row: PoseRow, data: SessionData, accuracy: PoseAccuracy | None) -> dict[str, Any] | None:
    drifting = drift_of(row)
    if drifting is None:
        return None
    cycles, found = drifting[0].tolist(), drifting[1]
    visits = [visit for visit in row.visits if visit.cycle is not None]
    hours = visit_hours(visits, data)
    rate = None
    if hours is not None:
        rate = drift_rate(hours, np.array([visit.position_mm for visit in visits]))
    shift_error = np.hypot(found.blocks[0].standard_error_mm, found.blocks[-1].standard_error_mm)
    freedom, length_freedom = shift_degrees_of_freedom(found)
    against = accuracy_drift_of(row, accuracy, found)
    attained = [None] * len(found.blocks) if against is None else against.accuracy_mm
    turn, turn_error = found.shift_rad, found.shift_rad_standard_error
    blocks = [
        {
            "first_cycle": cycles[block.first_cycle - 1],
            "last_cycle": cycles[block.last_cycle - 1],
            "mean_position_mm": block.mean_position_mm.tolist(),
            "mean_standard_uncertainty_mm": block.standard_error_mm.tolist(),
            "rp_l_mm": block.repeatability_mm,
            "ap_p_mm": ap_mm,
            "mean_time_h": None
            if hours is None
            else float(hours[block.first_cycle - 1 : block.last_cycle].mean()),
        }
        for block, ap_mm in zip(found.blocks, attained, strict=True)
    ]
    return {
        "pose_id": row.pose_id,
        "shift_mm": found.shift_mm.tolist(),
        "shift_standard_uncertainty_mm": shift_error.tolist(),
        "shift_degrees_of_freedom": freedom.tolist(),
        "shift_distance_mm": float(np.linalg.norm(found.shift_mm)),
        "shift_distance_standard_uncertainty_mm": length_standard_error(found.shift_mm, shift_error),
        "shift_distance_degrees_of_freedom": length_freedom,
        "shift_deg": None if turn is None else np.degrees(turn).tolist(),
        "shift_standard_uncertainty_deg": None if turn_error is None else np.degrees(turn_error).tolist(),
        "drp_mm": found.repeatability_drift_mm,
        "dap_mm": None if against is None else against.dap_mm,
        "dap_standard_uncertainty_mm": None if against is None else against.standard_uncertainty_mm,
        "duration_h": None if hours is None else blocks[-1]["mean_time_h"] - blocks[0]["mean_time_h"],
        "rate_mm_per_h": None if rate is None else rate.mm_per_h.tolist(),
        "rate_standard_uncertainty_mm_per_h": None if rate is None else rate.standard_error_mm_per_h.tolist(),
        "blocks": blocks,
    }


def visit_hours(visits: Sequence[MeasuredPose], data: SessionData) -> np.ndarray | None:
    """Return when the visits were, h after the session's first image; None where that is not known."""
    if not all(image.measurement_id in data.taken_h for visit in visits for image in images_of(visit)):
        return None
    times = [[data.taken_h[image.measurement_id] for image in images_of(visit)] for visit in visits]
    return np.array([sum(of_visit) / len(of_visit) for of_visit in times])
