"""Stored calibrations with the grade of their focal length and its 95 % interval.

Revision: 0012, after 0011
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0012"
down_revision = "0011"
branch_labels = None
depends_on = None
lost_on_the_way_down = "Nothing: a later upgrade computes grades and intervals again."

_BATCH = 500
_RESULTS = sa.table("results", sa.column("measurement_id", sa.String), sa.column("calibration", sa.JSON()))
_MAX_DETERMINED, _NORMAL_95 = 0.02, 1.959964


def _graded(document: dict[str, Any]) -> dict[str, Any]:
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


def _ungraded(document: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in document.items() if name not in ("grade", "interval_95")}


def _read(stored: Any) -> Any:
    """Return a document, which SQLite hands over as text; None for what is no JSON."""
    if not isinstance(stored, str | bytes):
        return stored
    try:
        return json.loads(stored)
    except ValueError:
        return None


def _rewrite(rewritten: Callable[[dict[str, Any]], dict[str, Any]]) -> None:
    """Replace the documents, a batch of rows at a time; a damaged one stays as it is."""
    connection = op.get_bind()
    plain = sa.table("results", sa.column("measurement_id", sa.String), sa.column("calibration"))
    last = ""
    while found := connection.execute(
        sa.select(plain.c.measurement_id, plain.c.calibration)
        .where(plain.c.measurement_id > last, plain.c.calibration.is_not(None))
        .order_by(plain.c.measurement_id)
        .limit(_BATCH)
    ).all():
        documents = [(row, _read(stored)) for row, stored in found]
        sound = [
            {"row": row, "document": rewritten(document)}
            for row, document in documents
            if isinstance(document, dict)
        ]
        if sound:
            connection.execute(
                sa.update(_RESULTS)
                .where(_RESULTS.c.measurement_id == sa.bindparam("row"))
                .values(calibration=sa.bindparam("document", type_=sa.JSON())),
                sound,
            )
        last = found[-1][0]


def upgrade() -> None:
    _rewrite(_graded)


def downgrade() -> None:
    _rewrite(_ungraded)
