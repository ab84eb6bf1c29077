"""The qualification of a session's set-up by known lengths as the API shows it."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

from app.analyses.documents.findings import Findings
from core.metrology import CONFIDENCE, MIN_POINTS, RULE, KnownLength, LengthError, chart_figure
from core.session import SessionData, estimate_session, qualify_session

_LENGTHS = frozenset({"probing_scatter_mm"})
"""Figures that are above zero by their nature, and charted by their logarithms."""
_SIZES = frozenset({"worst_error_mm"})
"""Figures that are charted by their size: of lengths whose errors are as large either way the sign is chance's."""
_ROUNDING = 1e-9


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


def control_document(name: str, earlier: Sequence[float], value: float | None) -> dict[str, Any] | None:
    """Return the control limits of a record's figure from the earlier records, oldest first, and whether it keeps them.

    None where fewer than `MIN_POINTS` are known, or the figure itself is not.
    """
    logarithms = name in _LENGTHS
    known = [charted_value(name, one) for one in earlier]
    usable = [one for one in known if math.isfinite(one) and (not logarithms or one > 0.0)]
    if value is None or len(usable) < MIN_POINTS:
        return None
    value = charted_value(name, value)
    limits = chart_figure(usable, logarithms=logarithms).limits
    inside = limits.lower <= value <= limits.upper
    return {
        "centre": limits.centre,
        "low": limits.lower,
        "high": limits.upper,
        "records": len(usable),
        # Equal figures have limits of no width, but for rounding.
        "in_control": inside
        or any(math.isclose(value, e, rel_tol=_ROUNDING) for e in (limits.lower, limits.upper)),
    }


def charted_value(name: str, value: float) -> float:
    """Return what control charts take of a record's figure, by its column's name."""
    return abs(value) if name in _SIZES else value


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
