"""Rows by ids that a client sent."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import sqlalchemy as sa
from sqlalchemy import orm

from app.errors import NotFound, RowUnreadable
from app.records.activity import current_activity
from app.records.ids import is_id
from app.records.pagination import page
from app.records.readable import unreadable_columns
from app.records.tables import (
    Measurement,
    Qualification,
    Report,
    Robot,
    Session,
    SessionTarget,
    Table,
    Target,
    Webhook,
)

Row = TypeVar("Row", bound=Table)
Named = TypeVar("Named", Robot, Session, Target)

NOUNS: dict[type[Table], str] = {
    Target: "target",
    Robot: "robot",
    Session: "session",
    Measurement: "measurement",
    Report: "report",
    Qualification: "qualification",
    Webhook: "webhook",
}
MAX_NAMED = 5
"""Sessions listed in a refusal; a robot or a target may have many more."""
POSE_ID = r"^[A-Za-z0-9_-][A-Za-z0-9._-]{0,127}$"


def visible(table: type[Table]) -> list[sa.ColumnElement[bool]]:
    """Return the conditions that leave of `table` what the caller's key may see: all of it, unless it is limited.

    A key limited to sessions sees these, their measurements, and the targets and robots they name. Every list and
    every lookup by an id from outside needs this; what only keeps rows and files in step must not have it.
    """
    activity = current_activity()
    if activity is None or activity.session_ids is None:
        return []
    sessions = sorted(activity.session_ids)
    if table is Session:
        return [Session.id.in_(sessions)]
    if table is Measurement:
        return [Measurement.session_id.in_(sessions)]
    if table is Report:
        return [Report.session_id.in_(sessions)]
    if table is Qualification:
        return [Qualification.session_id.in_(sessions)]
    if table is Target:
        return [
            Target.id.in_(sa.select(SessionTarget.target_id).where(SessionTarget.session_id.in_(sessions)))
        ]
    if table is Robot:
        return [Robot.id.in_(sa.select(Session.robot_id).where(Session.id.in_(sessions)))]
    return [sa.false()]


def page_by_name(
    records: orm.Session, table: type[Named], *, name: str | None = None, limit: int, cursor: str | None
) -> tuple[Sequence[Named], str | None]:
    """Return one page of a table's rows that the caller's key may see, or of those with exactly this name."""
    statement = sa.select(table).where(*visible(table))
    if name is not None:
        statement = statement.where(table.name == name)
    return page(records, statement, table.id, limit=limit, cursor=cursor)


def may_see_session(session_id: str) -> bool:
    """Return whether the caller's key may see a session, if there is one."""
    activity = current_activity()
    return activity is None or activity.session_ids is None or session_id in activity.session_ids


def get_or_raise(records: orm.Session, table: type[Row], row_id: str, *, lock: bool = False) -> Row:
    """Return the row with this id or raise NotFound; `lock` makes other writers of it wait for our commit.

    SQLite has one writer at a time anyway. What a limited key may not see does not exist for it.
    """
    row = None
    if is_id(row_id) and (not visible(table) or exists(records, table, row_id)):
        row = records.get(table, row_id, with_for_update={"key_share": True} if lock else None)
    if row is None:
        raise NotFound.of(NOUNS[table])
    return row


def require_readable(row: Table) -> None:
    """Raise RowUnreadable for a row that holds what its table does not allow, before anything is computed from it."""
    damaged = unreadable_columns(row)
    if damaged:
        raise RowUnreadable(NOUNS[type(row)], damaged)


def exists(records: orm.Session, table: type[Table], row_id: str, *, keep: bool = False) -> bool:
    """Return whether there is a row with this id that the caller's key may see.

    With `keep`, nobody deletes it before our commit.
    """
    if not is_id(row_id):
        return False
    key = table.__table__.c.id
    query = sa.select(key).where(key == row_id, *visible(table))
    if keep:
        query = query.with_for_update(read=True, key_share=True)
    return records.scalar(query) is not None


def lock_for_deletion(records: orm.Session, table: type[Row], row_id: str) -> Row:
    """Return the row with this id once no other writer can refer to it before our commit. Raises NotFound."""
    row = get_or_raise(records, table, row_id)
    if records.scalar(sa.select(table).where(table.__table__.c.id == row_id).with_for_update()) is None:
        raise NotFound.of(NOUNS[table])
    return row
