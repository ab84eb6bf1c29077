"""Printed targets: made once, never changed, so that results always refer to what was measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import sqlalchemy as sa
from sqlalchemy import orm

from app.jobs.admission import admit_target
from app.records.ids import new_id
from app.records.pagination import page
from app.records.tables import Target, target_fields


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
    admit_target(target_fields(target))
    session.add(target)
    return target


def list_targets(
    session: orm.Session, *, limit: int, cursor: str | None
) -> tuple[Sequence[Target], str | None]:
    """Return one page of all targets."""
    return page(session, sa.select(Target), Target.id, limit=limit, cursor=cursor)
