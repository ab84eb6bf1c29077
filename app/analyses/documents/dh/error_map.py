"""The position error of a robot's nominal kinematics over its workspace as JSON: millimetres and degrees."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from app.analyses.documents.encoding import limits_of, refined_estimate
from app.analyses.documents.findings import Findings
from core.kinematics import KinematicErrorMap
from core.session import SessionData, SessionErrorMap, session_error_map, with_nominal_orientations


def error_map_findings(data: SessionData, settings: Mapping[str, str]) -> Findings:
    """Return what `GET .../dh/error-map` answers."""
    _, found = error_map_of(data, settings)
    fields = {
        "estimator": settings["estimator"],
        "source": settings["source"],
        **_document(found.map),
        "limits_stated": list(found.limits_stated),
    }
    return Findings(fields, found.found.excluded, found.found.warnings)


def error_map_of(data: SessionData, settings: Mapping[str, str]) -> tuple[SessionData, SessionErrorMap]:
    """Return the map by a request's settings, with the session as it was read."""
    estimate = None
    if settings["source"] == "images":
        data = with_nominal_orientations(data)
        estimate = refined_estimate(data, settings)
    return data, session_error_map(data, estimate, limits=limits_of(settings))


def _document(found: KinematicErrorMap) -> dict[str, Any]:
    worst = found.worst
    return {
        "measured_configurations": found.measured,
        "median_error_mm": found.median_mm,
        "median_uncertainty_mm": found.median_uncertainty_mm,
        "largest_error_place": {
            "joint_angles_deg": np.degrees(found.worst_joint_angles).tolist(),
            "position_mm": found.worst_position_mm.tolist(),
            "error_mm": float(worst.length_mm[0]),
            "standard_uncertainty_mm": float(worst.standard_uncertainty_mm[0]),
            "error_vector_mm": found.worst_difference_mm.tolist(),
        },
        "error_map": {
            "cell_mm": found.cell_mm,
            "samples": found.samples,
            "error_cells": [
                {
                    "radius_mm": cell.radius_mm,
                    "height_mm": cell.height_mm,
                    "configurations": cell.configurations,
                    "measured_configurations": cell.measured,
                    "extrapolated": cell.extrapolated,
                    "median_error_mm": cell.median_mm,
                    "largest_error_mm": cell.largest_mm,
                    "median_uncertainty_mm": cell.median_uncertainty_mm,
                }
                for cell in found.cells
            ],
        },
    }
