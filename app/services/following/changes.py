"""Changes of the status of a session's measurements, in an order that is final: none appears before one that was read.

Triggers number them (migration 0027). SQLite has one writer, which numbers in the order of commits. Transactions of
PostgreSQL commit in another order; each holds an advisory lock from before its first number to its end, whose key is no
greater than that number. Numbers from the least such key on are not final.
"""

from __future__ import annotations

from typing import NamedTuple

import sqlalchemy as sa
from sqlalchemy import orm

from app.records.tables import Measurement, MeasurementChange
from app.services.following.position import BEGINNING, Position

AT_ONCE = 500
"""Changes of one reading."""
MAX_WAIT_S = 60.0
"""A transaction that is open longer holds nobody up; its changes may be passed over."""
_FINAL = sa.text(
    """
    SELECT greatest(
        microsecond - CAST(:most AS bigint),
        least(
            greatest(
                microsecond,
                1 + coalesce((SELECT max(number) FROM measurement_changes WHERE session_id = :session_id), 0)
            ),
            (
                SELECT min((CAST(classid AS bigint) << 32) | CAST(objid AS bigint)) FROM pg_locks
                WHERE locktype = 'advisory' AND objsubid = 1 AND CAST(classid AS bigint) > 0
                    AND database = (SELECT oid FROM pg_database WHERE datname = current_database())
            )
        )
    )
    FROM (SELECT CAST(extract(epoch FROM statement_timestamp()) * 1000000 AS bigint) AS microsecond) AS clock
    """
)
_NUMBER, _ID = MeasurementChange.number, MeasurementChange.measurement_id


class StatusChange(NamedTuple):
    """The latest change of a measurement's status, and the measurement as it is now."""

    number: int
    measurement_id: str
    pose_id: str
    status: str

    @property
    def position(self) -> Position:
        return Position(self.number, self.measurement_id)


class Changes(NamedTuple):
    """Final changes, oldest first; `are_all`: nothing else is known now that follows them."""

    final: list[StatusChange]
    are_all: bool


def first_open_number(records: orm.Session, session_id: str) -> int | None:
    """Return the least number that is not final, None where all are. Ask before the changes are read."""
    if records.get_bind().dialect.name == "sqlite":
        return None
    number = records.scalar(_FINAL, {"session_id": session_id, "most": int(MAX_WAIT_S * 1e6)})
    assert isinstance(number, int)
    return number


def read_changes(records: orm.Session, session_id: str, after: Position) -> Changes:
    """Return up to AT_ONCE changes that follow a position, each measurement by its latest change alone."""
    end = first_open_number(records, session_id)
    rows = records.execute(
        sa.select(_NUMBER, _ID, Measurement.pose_id, Measurement.status)
        .join(Measurement, Measurement.id == _ID)
        .where(
            MeasurementChange.session_id == session_id,
            sa.tuple_(_NUMBER, _ID) > sa.tuple_(sa.literal(after.number), sa.literal(after.measurement_id)),
        )
        .order_by(_NUMBER, _ID)
        .limit(AT_ONCE)
    ).all()
    final = [StatusChange(*row) for row in rows if end is None or row.number < end]
    return Changes(final, are_all=len(final) == len(rows) < AT_ONCE)


def latest_position(records: orm.Session, session_id: str) -> Position:
    """Return the position after all changes that are final."""
    end = first_open_number(records, session_id)
    statement = sa.select(_NUMBER, _ID).where(MeasurementChange.session_id == session_id)
    if end is not None:
        statement = statement.where(end > _NUMBER)
    row = records.execute(statement.order_by(_NUMBER.desc(), _ID.desc()).limit(1)).first()
    return BEGINNING if row is None else Position(row.number, row.measurement_id)
