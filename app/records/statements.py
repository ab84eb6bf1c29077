"""Core statements for the paths that every image takes: compiled once, run below the ORM.

On SQLite the driver's own cursor runs them: putting a statement together costs SQLAlchemy several times what SQLite
takes to answer it. On PostgreSQL, where the way to the server costs more, SQLAlchemy runs the same statements. The
types' conversions are the same either way.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import sqlalchemy as sa
from sqlalchemy import orm

Convert = Callable[[Any], Any]
Row = tuple[Any, ...]


class Statement:
    """A Core statement whose values are named parameters; no lists (`IN`), which are expanded anew each time.

    `columns` are the columns of an INSERT, each one a parameter.
    """

    def __init__(self, statement: sa.Executable, columns: Sequence[str] = ()) -> None:
        self.core = statement
        self._columns = list(columns)
        self._plan: _Plan | None = None

    def plan(self, dialect: sa.Dialect) -> _Plan:
        """Return the statement as SQLite's driver takes it."""
        if self._plan is None:
            self._plan = _Plan(self.core, self._columns, dialect)
        return self._plan


class Rows(Protocol):
    """One transaction in which statements run."""

    def all(self, statement: Statement, **values: Any) -> Sequence[Row]:
        """Run a statement and return its rows; none for one that returns none."""
        ...

    def first(self, statement: Statement, **values: Any) -> Row | None:
        """Run a statement and return its first row, None where there is no row."""
        ...


class DriverRows:
    """A transaction on a connection of SQLite's driver."""

    def __init__(self, cursor: Any, dialect: sa.Dialect) -> None:
        self._cursor, self._dialect = cursor, dialect

    def all(self, statement: Statement, **values: Any) -> Sequence[Row]:
        plan = statement.plan(self._dialect)
        self._cursor.execute(plan.text, plan.arguments(values))
        # Fetched to the end, or the statement would go on holding its snapshot.
        rows: list[Row] = self._cursor.fetchall() if plan.returns_rows else []
        return plan.converted(rows)

    def first(self, statement: Statement, **values: Any) -> Row | None:
        rows = self.all(statement, **values)
        return rows[0] if rows else None


class EngineRows:
    """A transaction on a connection of SQLAlchemy's."""

    def __init__(self, connection: sa.Connection) -> None:
        self.connection = connection

    def all(self, statement: Statement, **values: Any) -> Sequence[Row]:
        result = self.connection.execute(statement.core, values)
        return [tuple(row) for row in result] if result.returns_rows else []

    def first(self, statement: Statement, **values: Any) -> Row | None:
        rows = self.all(statement, **values)
        return rows[0] if rows else None


def rows_of(session: orm.Session) -> Rows:
    """Return a session's own transaction for statements below the ORM, with what the session holds flushed to it."""
    session.flush()
    connection = session.connection()
    if connection.dialect.name != "sqlite":
        return EngineRows(connection)
    driver = connection.connection.driver_connection
    assert driver is not None
    return DriverRows(driver.cursor(), connection.dialect)


class _Plan:
    """A statement compiled for the driver: its text, its parameters in order, and the conversions of values."""

    def __init__(self, statement: sa.Executable, columns: list[str], dialect: sa.Dialect) -> None:
        assert isinstance(statement, sa.ClauseElement)
        compiled = statement.compile(dialect=dialect, column_keys=columns or None)
        assert isinstance(compiled, sa.sql.compiler.SQLCompiler)
        assert compiled.positional, "SQLite's drivers take parameters by their places"
        assert not compiled.post_compile_params | compiled.literal_execute_params, (
            "lists are not compiled once"
        )
        self.text = str(compiled)
        given = compiled.construct_params(_check=False)
        binds = {name: bind for bind, name in compiled.bind_names.items()}
        self._parameters = [
            (name, given.get(name), binds[name].type.dialect_impl(dialect).bind_processor(dialect))
            for name in compiled.positiontup or ()
        ]
        results = [
            entry.type.dialect_impl(dialect).result_processor(dialect, None)
            for entry in compiled._result_columns
        ]
        self.returns_rows = bool(results)
        self._conversions: list[tuple[int, Convert]] = [
            (place, convert) for place, convert in enumerate(results) if convert is not None
        ]

    def arguments(self, values: dict[str, Any]) -> list[Any]:
        """Return the values in the driver's order, as it stores them."""
        return [
            values.get(name, default) if convert is None else convert(values.get(name, default))
            for name, default, convert in self._parameters
        ]

    def converted(self, rows: list[Row]) -> Sequence[Row]:
        """Return rows as the columns' types read them."""
        if not self._conversions or not rows:
            return rows
        found = []
        for row in rows:
            values = list(row)
            for place, convert in self._conversions:
                values[place] = convert(values[place])
            found.append(tuple(values))
        return found
