"""The steadiness of a session's cycles as the API shows it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from app.analyses.documents.repeatability.readings import ids_of
from core.metrology import ChangePoint, PoseMotion, Trend, TwoPoints
from core.session import PoseRow, SessionSteadiness


def steadiness_document(steadiness: SessionSteadiness, rows: Sequence[PoseRow]) -> dict[str, Any]:
    """Return the object `steadiness` of `GET .../repeatability`."""
    found = steadiness.found
    p_values, grid = found.p_values, found.grid
    by_id = {row.pose_id: row for row in rows}
    tested = p_values is not None
    return {
        "steady": found.steady,
        "cycles": found.cycles,
        "counted_in": "visits" if grid is not None and grid.by_visit else "cycles",
        "p_values": {
            "overall_p_value": p_values.overall,
            "trend_p_value": p_values.trend,
            "change_point_p_value": p_values.change_point,
            "autocorrelation_p_value": p_values.autocorrelation,
            "permutations": p_values.permutations,
        }
        if p_values is not None
        else None,
        "trend": _trend(found.trend),
        "change_point": _change_point(found.change_point),
        "autocorrelation": steadiness.process.lag_correlation if tested else None,
        "effective_cycles": steadiness.effective_cycles if tested else None,
        "heavy_tails_probability": float(steadiness.process.tails.sum()),
        "common_motion": {"attribution": found.attribution, "share": found.common_share}
        if found.attribution is not None
        else None,
        "poses": [_pose(one, steadiness) for one in found.poses],
        "two_points": [_two_points(one, by_id[steadiness.pose_ids[one.pose]]) for one in found.two_points],
    }


def _trend(found: Trend | None) -> dict[str, Any] | None:
    if found is None:
        return None
    return {
        "change_mm": found.change_mm.tolist(),
        "change_standard_uncertainty_mm": found.standard_uncertainty_mm.tolist(),
        "change_distance_mm": float(np.linalg.norm(found.change_mm)),
    }


def _change_point(found: ChangePoint | None) -> dict[str, Any] | None:
    if found is None:
        return None
    return {
        "cycle": found.cycle,
        "step_mm": found.step_mm.tolist(),
        "step_standard_uncertainty_mm": found.standard_uncertainty_mm.tolist(),
        "step_distance_mm": float(np.linalg.norm(found.step_mm)),
    }


def _pose(one: PoseMotion, steadiness: SessionSteadiness) -> dict[str, Any]:
    return {
        "pose_id": steadiness.pose_ids[one.pose],
        "steady": one.pose not in steadiness.found.moved,
        "p_value": one.p_value,
        "change_mm": one.change_mm.tolist(),
        "change_distance_mm": float(np.linalg.norm(one.change_mm)),
        "step_mm": None if one.step_mm is None else one.step_mm.tolist(),
        "change_cycle": one.change_cycle,
    }


def _two_points(one: TwoPoints, row: PoseRow) -> dict[str, Any]:
    return {
        "pose_id": row.pose_id,
        "distance_mm": one.distance_mm,
        "within_share": one.within_share,
        **ids_of(visit for visit, second in zip(row.visits, one.second.tolist(), strict=True) if second),
    }
