"""The qualification of a session's set-up by known lengths as the API shows it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from app.analyses.documents.findings import Findings
from core.metrology import CONFIDENCE, RULE, KnownLength, LengthError
from core.session import SessionData, estimate_session, qualify_session


def qualification_findings(data: SessionData, settings: Mapping[str, str]) -> Findings:
    """Return what `POST .../qualification` answers."""
    of_images = settings["source"] == "images"
    estimate = estimate_session(data, settings["estimator"]) if of_images else None
    lengths = [KnownLength(**one) for one in json.loads(settings["lengths"])]
    limit_mm = json.loads(settings["maximum_permissible_error_mm"])
    found = qualify_session(data, estimate, lengths, limit_mm)
    fields = {
        "estimator": settings["estimator"],
        "source": settings["source"],
        "confidence_level": CONFIDENCE,
        "lengths": [_length(one) for one in found.errors],
        "worst_error_mm": found.worst.error_mm,
        "maximum_permissible_error_mm": limit_mm,
        "decision": found.decision,
        "rule": RULE,
        "probing_scatter_mm": found.probing_scatter_mm,
        "scale_ppm": found.scale_ppm,
        "scale_standard_uncertainty_ppm": found.scale_standard_uncertainty_ppm,
    }
    if estimate is None:
        return Findings(fields, (), ())
    return Findings(fields, estimate.excluded.values(), estimate.warnings)


def _length(one: LengthError) -> dict[str, Any]:
    return {
        "from_pose_id": one.known.from_pose_id,
        "to_pose_id": one.known.to_pose_id,
        "length_mm": one.known.length_mm,
        "length_standard_uncertainty_mm": one.known.standard_uncertainty_mm,
        "measured_mm": one.measured_mm,
        "error_mm": one.error_mm,
        "standard_uncertainty_mm": one.standard_uncertainty_mm,
        "interval_mm": list(one.interval_mm),
    }
