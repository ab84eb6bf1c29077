"""Rows from one database into another of the same schema, SQLite or PostgreSQL, whatever the schema's version."""

from __future__ import annotations

from typing import Any

import sqlalchemy as sa

from app.records.tables import UtcDateTime

_AT_ONCE = 200
_NOT_ROWS = "alembic_version"


def copy_rows(source: sa.Connection, target: sa.Connection) -> dict[str, int]:
    """Copy every row of every table, parents first, and return how many each table has.

    The tables of `target` are there and empty. What `source` is read by should be one snapshot.
    """
    wanted, given = _tables(target), _tables(source)
    return {name: _copy_table(source, target, given[name], table) for name, table in wanted.items()}


def count_rows(connection: sa.Connection) -> dict[str, int]:
    """Return how many rows each table has; empty where there are no tables."""
    return {
        name: connection.scalar(sa.select(sa.func.count()).select_from(table)) or 0
        for name, table in _tables(connection).items()
    }


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


def _tables(connection: sa.Connection) -> dict[str, sa.TableClause]:
    """Return the tables as they are in the database, parents before children."""
    inspector = sa.inspect(connection)
    return {
        name: sa.table(name, *(sa.column(c["name"], _kind(c["type"])) for c in inspector.get_columns(name)))
        for name, _ in inspector.get_sorted_table_and_fkc_names()
        if name is not None and name != _NOT_ROWS
    }


def _kind(kind: sa.types.TypeEngine[Any]) -> sa.types.TypeEngine[Any]:
    """Return the type that gives and takes the same Python values with both databases."""
    if isinstance(kind, sa.JSON):
        return sa.JSON(none_as_null=True)
    if isinstance(kind, sa.DateTime):
        return UtcDateTime()
    return kind
