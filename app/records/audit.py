"""The audit trail: one entry for each request or command that changed something, in the same transaction."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any

import sqlalchemy as sa
from sqlalchemy import orm

from app.records.activity import Activity, current_activity
from app.records.ids import new_id
from app.records.pagination import page
from app.records.statements import Rows, Statement
from app.records.tables import AuditEntry

_CREATED = "created"
_COLUMNS = tuple(AuditEntry.__table__.c.keys())
_APPEND = Statement(sa.insert(AuditEntry), _COLUMNS)


def note_created(session: orm.Session, _context: orm.UOWTransaction) -> None:
    """Remember the ids of new rows that know who made them; listens to `after_flush`."""
    for row in session.new:
        if hasattr(row, "made_by"):
            session.info.setdefault(_CREATED, []).append(row.id)


def append_entry(session: orm.Session) -> None:
    """Add the current activity's entry to this transaction; its later transactions add none."""
    activity = current_activity()
    if activity is None or not activity.audited:
        return
    session.flush()
    created = session.info.get(_CREATED, ())
    activity.object_ids.extend(row_id for row_id in created if row_id not in activity.object_ids)
    session.connection().execute(_APPEND.core, _entry(activity))


def append_entry_below_orm(rows: Rows) -> None:
    """The same in a transaction below the ORM, where `note_objects` has named what was made."""
    activity = current_activity()
    if activity is not None and activity.audited:
        rows.all(_APPEND, **_entry(activity))


def _entry(activity: Activity) -> dict[str, Any]:
    return {
        "id": new_id("aud"),
        "at": datetime.now(UTC),
        "actor": activity.actor,
        "key_id": activity.key_id,
        "key_name": activity.key_name,
        "client": activity.client,
        "action": activity.action,
        "object_ids": activity.object_ids,
        "request_id": activity.request_id,
    }


def list_entries(
    records: orm.Session,
    *,
    key_id: str | None = None,
    object_id: str | None = None,
    since: datetime | None = None,
    until: datetime | None = None,
    limit: int,
    cursor: str | None,
) -> tuple[Sequence[AuditEntry], str | None]:
    """Return one page of entries, oldest first: of this key, about this object, since and before these times."""
    statement = sa.select(AuditEntry)
    if key_id is not None:
        statement = statement.where(AuditEntry.key_id == key_id)
    if object_id is not None:
        # The list is short JSON text: an id is between quotes in it.
        listed = sa.cast(AuditEntry.object_ids, sa.Text())
        statement = statement.where(listed.contains(f'"{object_id}"', autoescape=True))
    if since is not None:
        statement = statement.where(AuditEntry.at >= since)
    if until is not None:
        statement = statement.where(AuditEntry.at < until)
    return page(records, statement, AuditEntry.id, limit=limit, cursor=cursor)
