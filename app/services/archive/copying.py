"""Examined rows put into an installation: what several sessions share may be there already, if it is the same."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import sqlalchemy as sa
from sqlalchemy import orm

from app.errors import ArchiveRefused
from app.records.database import Database
from app.records.tables import Qualification, Report, ReportForm, Robot, RobotEvent, Session, Table, Target
from app.services.archive.rows import OF_SESSION

Json = dict[str, Any]
_AT_ONCE = 200
_SHARED: dict[type[Table], frozenset[str]] = {
    Robot: frozenset({"name", "created_at", "made_by"}),
    Target: frozenset({"name", "created_at", "made_by"}),
    Report: frozenset(),
    ReportForm: frozenset({"content"}),  # deflated; the hash of what it inflates to is compared
    Qualification: frozenset(),  # outlives its session, as reports do
    RobotEvent: frozenset({"made_by"}),  # the robot's: every session of it brings them
}
"""Tables whose rows may be there already, and the columns in which those may differ without another result."""


def require_absent(database: Database, session_id: str) -> None:
    """Raise ArchiveRefused where the session is there already."""
    with database.read() as records:
        if records.get(Session, session_id) is not None:
            raise _present(session_id)


def put_rows(given: orm.Session, taken: orm.Session) -> dict[str, int]:
    """Copy all rows in the caller's transaction; return how many of each table were there already, the same.

    Raises ArchiveRefused where a row of the same id differs.
    """
    already_there: dict[str, int] = {}
    for table in OF_SESSION:
        rows = given.connection().execution_options(yield_per=_AT_ONCE).execute(sa.select(table.__table__))
        for some in rows.partitions():
            values = [dict(row._mapping) for row in some]
            found = _found(taken, table, values)
            for row in values:
                _require_same(table, row, found.get(_key(table, row)))
            new = [row for row in values if _key(table, row) not in found]
            already_there[table.__tablename__] = already_there.get(table.__tablename__, 0) + len(found)
            if new:
                taken.connection().execute(sa.insert(table), new)
    return {name: count for name, count in already_there.items() if count}


def _found(taken: orm.Session, table: type[Table], rows: Sequence[Json]) -> dict[tuple[Any, ...], Json]:
    """Return the rows that are there with the same keys."""
    key = tuple(table.__table__.primary_key)
    statement = sa.select(table.__table__).where(sa.tuple_(*key).in_([_key(table, row) for row in rows]))
    found = [dict(row._mapping) for row in taken.connection().execute(statement)]
    return {_key(table, row): row for row in found}


def _key(table: type[Table], row: Json) -> tuple[Any, ...]:
    return tuple(row[column.name] for column in table.__table__.primary_key)


def _require_same(table: type[Table], row: Json, there: Json | None) -> None:
    if there is None:
        return
    if table is Session:
        raise _present(row["id"])
    if table not in _SHARED:
        raise ArchiveRefused(
            "archive_conflict",
            f"Another session has the {table.__tablename__} {_key(table, row)[0]} of the archive already.",
            "Restore it in another installation.",
        )
    differing = sorted(name for name in row if name not in _SHARED[table] and row[name] != there[name])
    if differing:
        raise ArchiveRefused(
            "archive_conflict",
            f"{table.__tablename__} {_key(table, row)[0]} is there already with another {', '.join(differing)}, "
            "so that the session would have other results than it was archived with.",
            "Restore it in another installation (a new data folder is one), or give the object its former values "
            "first.",
        )


def _present(session_id: str) -> ArchiveRefused:
    return ArchiveRefused(
        "session_present",
        f"The session {session_id} is there already.",
        "Nothing needs to be restored. To have it as it was archived, delete it first (`gridpose sessions delete`), or "
        "restore it in another installation.",
    )
