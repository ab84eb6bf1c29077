"""Finding rows by ids that came from outside."""

from __future__ import annotations

from typing import TypeVar

import sqlalchemy as sa
from sqlalchemy import orm

from app.errors import NotFound
from app.records.ids import is_id
from app.records.tables import Measurement, Robot, Session, Table, Target

Row = TypeVar("Row", bound=Table)

NOUNS: dict[type[Table], str] = {
    Target: "target",
    Robot: "robot",
    Session: "session",
    Measurement: "measurement",
}
POSE_ID = r"^[A-Za-z0-9_-][A-Za-z0-9._-]{0,127}$"
SHA256 = r"^[0-9A-Fa-f]{64}$"


def find(records: orm.Session, table: type[Row], row_id: str, *, lock: bool = False) -> Row:
    """Return the row with this id or raise NotFound; `lock` makes other writers of it wait for our commit.

    SQLite has one writer at a time anyway.
    """
    row = None
    if is_id(row_id):
        row = records.get(table, row_id, with_for_update={"key_share": True} if lock else None)
    if row is None:
        raise NotFound.of(NOUNS[table])
    return row


def exists(records: orm.Session, table: type[Table], row_id: str) -> bool:
    """Tell whether there is a row with this id."""
    if not is_id(row_id):
        return False
    key = table.__table__.c.id
    return records.scalar(sa.select(key).where(key == row_id)) is not None
