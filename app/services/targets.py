"""Printed targets: made once, never changed, so that results always refer to what was measured; deleted unused."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import sqlalchemy as sa
from sqlalchemy import orm

from app.errors import Conflict
from app.jobs.validation import validate_target
from app.records.ids import new_id
from app.records.pagination import page
from app.records.tables import Measurement, SessionTarget, Target, target_fields
from app.services.queries import lock_for_deletion, visible


@dataclass(frozen=True, slots=True, kw_only=True)
class NewTarget:
    """What a client says about a target."""

    name: str
    kind: str
    columns: int
    rows: int
    pitch_mm: float
    marker_mm: float | None
    dictionary: str | None
    legacy_layout: bool
    pitch_standard_uncertainty_mm: float | None


def create_target(session: orm.Session, new: NewTarget) -> Target:
    """Store a target. Raises InvalidContent for one that cannot be."""
    target = Target(
        id=new_id("tgt"),
        name=new.name,
        kind=new.kind,
        columns=new.columns,
        rows=new.rows,
        pitch_mm=new.pitch_mm,
        marker_mm=new.marker_mm,
        dictionary=new.dictionary,
        legacy_layout=new.legacy_layout,
        pitch_standard_uncertainty_mm=new.pitch_standard_uncertainty_mm,
        created_at=datetime.now(UTC),
    )
    validate_target(target_fields(target))
    session.add(target)
    return target


def list_targets(
    session: orm.Session, *, limit: int, cursor: str | None
) -> tuple[Sequence[Target], str | None]:
    """Return one page of all targets the caller's key may see."""
    return page(session, sa.select(Target).where(*visible(Target)), Target.id, limit=limit, cursor=cursor)


MAX_NAMED = 5
"""Sessions listed in a refusal; a target may have many more."""


def delete_target(records: orm.Session, target_id: str) -> None:
    """Delete a target that no session and no measurement refers to. Raises NotFound, Conflict."""
    target = lock_for_deletion(records, Target, target_id)
    for column, verb in (
        (SessionTarget.session_id, "look at the target"),
        (Measurement.session_id, "have measurements of the target"),
    ):
        sessions = records.scalars(
            sa.select(column)
            .where(column.class_.target_id == target_id)
            .distinct()
            .order_by(column)
            .limit(MAX_NAMED)
        ).all()
        if sessions:
            raise Conflict(
                f"Sessions {verb}: {', '.join(sessions)}.",
                "Change the sessions' target_ids (PATCH /v1/sessions/{session_id}, `gridpose sessions change`), which "
                "searches their images again; delete measurements that still name it, or the sessions.",
                code="target_in_use",
                errors=[("session_id", session_id) for session_id in sessions],
            )
    records.delete(target)
