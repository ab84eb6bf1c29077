"""Rows from one database into another of the same schema, SQLite or PostgreSQL, whatever the schema's version."""

from __future__ import annotations

import hashlib
import json
from datetime import datetime
from typing import Any

import sqlalchemy as sa

from app.records.tables import UtcDateTime

_AT_ONCE = 200
_NOT_ROWS = frozenset({"alembic_version", "access_version", "measurement_changes"})
"""What belongs to the one database: its schema's version, and what its own triggers write."""
_OF_POSTGRESQL = ("queue_turns", "analysis_answers")


def is_of_queue(table: str) -> bool:
    """Return whether a table exists on PostgreSQL alone: it follows from the rows, and is not copied with them.

    Rows that arrive as `queued` enter the queue by a trigger (migration 0017).
    """
    return table in _OF_POSTGRESQL or table.startswith("procrastinate_")


def copy_rows(source: sa.Connection, target: sa.Connection) -> dict[str, int]:
    """Copy every row of every table, parents first, and return how many each table has.

    The tables of `target` are there and empty. What `source` is read by should be one snapshot.
    """
    wanted, given = tables_in(target), tables_in(source)
    return {name: _copy_table(source, target, given[name], table) for name, table in wanted.items()}


def count_rows(connection: sa.Connection) -> dict[str, int]:
    """Return how many rows each table has; empty where there are no tables."""
    return {
        name: connection.scalar(sa.select(sa.func.count()).select_from(table)) or 0
        for name, table in tables_in(connection).items()
    }


def digest_rows(connection: sa.Connection) -> dict[str, tuple[int, str]]:
    """Return of each table how many rows it has and a digest of what they hold, the same on both databases.

    Rows count in any order, since the databases sort texts differently.
    """
    return {name: _digest(connection, table) for name, table in tables_in(connection).items()}


def _digest(connection: sa.Connection, table: sa.TableClause) -> tuple[int, str]:
    columns = sorted(table.c, key=lambda column: column.name)
    rows = connection.execution_options(yield_per=_AT_ONCE).execute(sa.select(*columns))
    count, total = 0, 0
    for row in rows:
        text = json.dumps([_plain(value) for value in row], sort_keys=True)
        total += int.from_bytes(hashlib.sha256(text.encode()).digest(), "big")
        count += 1
    return count, f"{total % 2**256:064x}"


def _plain(value: Any) -> Any:
    """Return a stored value as JSON holds it: arrays by their hash, times in UTC."""
    if isinstance(value, bytes | memoryview):
        return hashlib.sha256(value).hexdigest()
    if isinstance(value, datetime):
        return value.isoformat()
    return value


def _copy_table(
    source: sa.Connection, target: sa.Connection, given: sa.TableClause, wanted: sa.TableClause
) -> int:
    # In the order of the target's columns, whatever order migrations added them in.
    columns = [given.c[column.name] for column in wanted.c]
    rows = source.execution_options(yield_per=_AT_ONCE).execute(sa.select(*columns))
    copied = 0
    for partition in rows.partitions():
        target.execute(sa.insert(wanted), [dict(row._mapping) for row in partition])
        copied += len(partition)
    if target.dialect.name == "postgresql":
        _advance_counters(target, wanted)
    return copied


def _advance_counters(target: sa.Connection, table: sa.TableClause) -> None:
    """Let numbers that the database gives go on after those of the copied rows."""
    for column in table.c:
        counter = target.scalar(sa.func.pg_get_serial_sequence(table.name, column.name).select())
        if counter is not None:
            highest = sa.select(sa.func.max(column)).scalar_subquery()
            next_one = sa.func.coalesce(highest, 0) + 1
            target.execute(sa.select(sa.func.setval(counter, next_one, False)))


def tables_in(connection: sa.Connection) -> dict[str, sa.TableClause]:
    """Return the tables that hold rows as they are in the database, whatever its schema, parents before children."""
    inspector = sa.inspect(connection)
    return {
        name: sa.table(name, *(sa.column(c["name"], _kind(c["type"])) for c in inspector.get_columns(name)))
        for name, _ in inspector.get_sorted_table_and_fkc_names()
        if name is not None and name not in _NOT_ROWS and not is_of_queue(name)
    }


def _kind(kind: sa.types.TypeEngine[Any]) -> sa.types.TypeEngine[Any]:
    """Return the type that gives and takes the same Python values with both databases."""
    if isinstance(kind, sa.JSON):
        return sa.JSON(none_as_null=True)
    if isinstance(kind, sa.DateTime):
        return UtcDateTime()
    return kind
