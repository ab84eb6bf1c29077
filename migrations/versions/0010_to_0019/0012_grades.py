"""Stored calibrations with the grade of their focal length and its 95 % interval.

Revision: 0012, after 0011
"""

from __future__ import annotations

import math
from typing import Any

from migrations.documents import rewrite_documents

revision = "0012"
down_revision = "0011"
branch_labels = None
depends_on = None
lost_on_the_way_down = "Nothing: a later upgrade computes grades and intervals again."

_MAX_DETERMINED, _NORMAL_95 = 0.02, 1.959964


def _graded(document: Any) -> dict[str, Any] | None:
    if not isinstance(document, dict):
        return None
    try:
        relative = document["observability"]["focal_relative_uncertainty"]
        intervals = {
            name: _interval(document["intrinsics"][name], document["standard_uncertainty"][name])
            for name in ("fx_px", "fy_px")
        }
    except (KeyError, TypeError):  # damaged: it stays as it is, for `doctor` to find
        return document
    grade = "determined" if relative <= _MAX_DETERMINED else "weak"
    return {**document, "grade": grade, "interval_95": intervals}


def _interval(focal_px: float, standard_uncertainty_px: float) -> list[float]:
    factor = math.exp(_NORMAL_95 * standard_uncertainty_px / focal_px)
    return [focal_px / factor, focal_px * factor]


def _ungraded(document: Any) -> dict[str, Any] | None:
    if not isinstance(document, dict):
        return None
    return {name: value for name, value in document.items() if name not in ("grade", "interval_95")}


def upgrade() -> None:
    rewrite_documents("results", "measurement_id", "calibration", _graded)


def downgrade() -> None:
    rewrite_documents("results", "measurement_id", "calibration", _ungraded)
