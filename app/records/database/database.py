"""The database: engines, transactions, migrations.

SQLite (the embedded default) runs in WAL mode with `synchronous=FULL`: a committed transaction survives a power cut.
Writers begin with BEGIN IMMEDIATE, so that two of them never read the same state and lose an update; readers have an
engine of their own with plain BEGIN and never wait. PostgreSQL uses one engine for both; its connections speak UTC and
ISO dates whatever the server, the database or the role has for a default.

No stored value makes reading its row raise: what cannot be read is an `Unreadable` in its place (`records.readable`).

What every image passes through runs below the ORM (`records.statements`): `read_rows`, `write_rows` and, for
transactions that come together, `write_together`.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, TypeVar

import sqlalchemy as sa
from sqlalchemy import orm
from sqlalchemy.pool import ConnectionPoolEntry

from app.records.activity import current_activity
from app.records.audit import append_entry, append_entry_below_orm, note_created
from app.records.database.engines import NOTICE_LOSS, postgresql_engine, sqlite_driver, sqlite_engine
from app.records.database.group_commit import GroupCommit
from app.records.database.lending import LendingPool
from app.records.database.patience import Patience
from app.records.database.refusals import Damage, map_database_errors
from app.records.statements import DriverRows, EngineRows, Rows

Answer = TypeVar("Answer")


_SQLITE, _ = sqlite_driver()
GUARDS = 8
"""Connections to PostgreSQL for locks between processes: so many uploads to S3 are under way at a time."""
_GUARD = 0x6772_6964  # "grid"
_TURN = 0x7475_726E  # "turn"
_ACCESS_VERSION = "SELECT version FROM access_version"


class Database:
    """Engines and transactions of one database."""

    def __init__(self, url: str | sa.URL) -> None:
        self.url = sa.make_url(url)
        self.is_sqlite = self.url.get_backend_name() == "sqlite"
        self.damage = Damage()
        self._guards: sa.Engine | None = None
        self.patience = Patience()
        if self.is_sqlite:
            self._writer = sqlite_engine(
                self.url, begin="BEGIN IMMEDIATE", connections=1, patience=self.patience
            )
            self._reader = sqlite_engine(self.url, begin="BEGIN", connections=20)
        else:
            self._writer = self._reader = postgresql_engine(self.url)
            # Connections of their own: whoever holds a lock needs a further one to write, and must not wait for it.
            self._guards = postgresql_engine(self.url, connections=GUARDS).execution_options(
                isolation_level="AUTOCOMMIT"
            )
        self._write_session = orm.sessionmaker(self._writer, expire_on_commit=False)
        sa.event.listen(self._write_session, "after_flush", note_created)
        self._read_session = orm.sessionmaker(self._reader, expire_on_commit=False)
        self._group = GroupCommit(self._driver_transaction)
        self._version_cursor: Any = None
        self._version_cursors = 0
        self._version_lock = threading.Lock()

    @property
    def engine(self) -> sa.Engine:
        """The engine writers use."""
        return self._writer

    @contextmanager
    def write(self) -> Iterator[orm.Session]:
        """One write transaction: committed at the end, rolled back on any error. Never nest two of these.

        The first one of a request or command that is audited holds its entry in the audit trail.
        """
        with map_database_errors(self.damage), self._write_session.begin() as session:
            yield session
            append_entry(session)
        activity = current_activity()
        if activity is not None:
            activity.audited = False

    @contextmanager
    def read(self) -> Iterator[orm.Session]:
        """One consistent snapshot to read from."""
        with map_database_errors(self.damage), self._read_session() as session:
            yield session

    @contextmanager
    def snapshot(self) -> Iterator[sa.Connection]:
        """One moment of all tables, however many statements read it; writers go on meanwhile."""
        with map_database_errors(self.damage):
            engine = self._reader
            if not self.is_sqlite:
                engine = engine.execution_options(isolation_level="REPEATABLE READ", postgresql_readonly=True)
            with engine.connect() as connection:
                yield connection

    @contextmanager
    def read_rows(self) -> Iterator[Rows]:
        """One consistent snapshot to read from, below the ORM."""
        with map_database_errors(self.damage):
            if not self.is_sqlite:
                with self._reader.connect() as connection:
                    yield EngineRows(connection)
                return
            with _pool(self._reader).lent() as (driver, _):
                cursor = driver.cursor()
                cursor.execute("BEGIN")
                try:
                    yield DriverRows(cursor, self._reader.dialect)
                finally:
                    if driver.in_transaction:  # the database may have ended it
                        cursor.execute("ROLLBACK")

    @contextmanager
    def write_rows(self, *, durable: bool = True) -> Iterator[Rows]:
        """One write transaction below the ORM, for what is nobody's request: it appends nothing to the audit trail.

        One that is not `durable` may be undone by a power cut, on SQLite, until a later one is committed; it waits for
        no disk.
        """
        with map_database_errors(self.damage):
            if self.is_sqlite:
                with self._driver_transaction(durable=durable) as (_, rows):
                    yield rows
            else:
                with self._writer.begin() as connection:
                    yield EngineRows(connection)

    def write_together(self, work: Callable[[Rows], Answer]) -> Answer:
        """Do work in a write transaction and return its answer once that is committed; audited as `write` is.

        Transactions that several threads ask for at once share one commit (`group_commit`); PostgreSQL does
        that by itself.
        """

        def audited(rows: Rows) -> Answer:
            answer = work(rows)
            append_entry_below_orm(rows)
            return answer

        with map_database_errors(self.damage):
            if self.is_sqlite:
                answer = self._group.run(audited)
            else:
                with self._writer.begin() as connection:
                    answer = audited(EngineRows(connection))
        activity = current_activity()
        if activity is not None:
            activity.audited = False
        return answer

    def access_version(self) -> int | None:
        """Return the version of keys and sessions (`tables.AccessVersion`), whoever changed them; waits for nothing.

        None where it cannot be read at once: on PostgreSQL, behind a network, and while SQLite is occupied.
        """
        rows = self._read_version(_ACCESS_VERSION)
        return None if rows is None else int(rows[0][0]) if rows else 0

    def data_version(self) -> tuple[int, int] | None:
        """Return what is another one after each change, whoever committed it; waits for nothing.

        None where it cannot be read at once, as `access_version`. SQLite counts for each connection anew: the first
        number is that of the connection.
        """
        rows = self._read_version("PRAGMA data_version")
        return (self._version_cursors, int(rows[0][0])) if rows else None

    def _read_version(self, statement: str) -> list[Any] | None:
        if not self.is_sqlite:
            return None
        with self._version_lock:
            try:
                if self._version_cursor is None:
                    self._version_cursor = self._open_version_cursor()
                # Fetched to the end, or the statement would go on holding its snapshot.
                return list(self._version_cursor.execute(statement).fetchall())
            except (sa.exc.SQLAlchemyError, _SQLITE.Error):
                return None

    def _open_version_cursor(self) -> Any:
        driver = self._reader.raw_connection()
        driver.detach()  # it is kept: taking one from the pool costs more than the question
        cursor = driver.cursor()
        cursor.execute("PRAGMA busy_timeout=0")
        self._version_cursors += 1
        return cursor

    @contextmanager
    def _driver_transaction(self, *, durable: bool = True) -> Iterator[tuple[Any, Rows]]:
        with _pool(self._writer).lent() as (driver, entry):
            cursor = driver.cursor()
            try:
                if not durable:
                    cursor.execute("PRAGMA synchronous=NORMAL")
                self.patience.begin(lambda: cursor.execute("BEGIN IMMEDIATE"))
                try:
                    yield cursor, DriverRows(cursor, self._writer.dialect)
                    cursor.execute("COMMIT")
                except BaseException:
                    with suppress(_SQLITE.Error):  # where it undid the transaction itself
                        cursor.execute("ROLLBACK")
                    raise
            finally:
                if not durable:
                    _make_durable(cursor, entry)

    def size_bytes(self) -> int:
        """Return about how much room the database takes, and a copy of it at most."""
        pages = "SELECT page_count * page_size FROM pragma_page_count(), pragma_page_size()"
        statement = pages if self.is_sqlite else "SELECT pg_database_size(current_database())"
        with self._reader.connect() as connection:
            return int(connection.exec_driver_sql(statement).scalar_one())

    @contextmanager
    def exclude_others(self, number: int) -> Iterator[None]:
        """Hold a lock of all processes that use this database, one of many `number`s, without a transaction.

        On SQLite one process serves (`head.lock`), and there is nothing to hold. Raises Unavailable where another
        process has it for too long.
        """
        if self._guards is None:
            yield
            return
        with map_database_errors(self.damage):
            connection = self._guards.connect()
            try:
                connection.execute(sa.select(sa.func.pg_advisory_lock(_GUARD, number)))
            except BaseException:
                connection.invalidate()
                connection.close()
                raise
        try:
            yield
        finally:
            try:
                connection.execute(sa.select(sa.func.pg_advisory_unlock(_GUARD, number)))
            except sa.exc.DBAPIError:
                connection.invalidate()  # its end frees the lock
            connection.close()

    @contextmanager
    def turn(self) -> Iterator[bool]:
        """Say whether this process alone, of those that use this database, does now what one is to do at a time."""
        if self._guards is None:
            yield True
            return
        with self._guards.connect() as connection:
            is_ours = bool(connection.scalar(sa.select(sa.func.pg_try_advisory_lock(_TURN))))
            try:
                yield is_ours
            finally:
                if is_ours:
                    connection.execute(sa.select(sa.func.pg_advisory_unlock(_TURN)))

    def driver_options(self) -> dict[str, Any]:
        """Return what psycopg's own `connect` takes for a further connection to this PostgreSQL database."""
        _, options = self._writer.dialect.create_connect_args(self.url)
        return {**NOTICE_LOSS, **options}

    def dispose(self) -> None:
        """Close every connection: those that threads still use, as soon as they are given back."""
        with self._version_lock:
            if self._version_cursor is not None:
                self._version_cursor.connection.close()
                self._version_cursor = None
        for engine in (self._writer, self._reader, self._guards):
            if engine is None:
                continue
            if not self.is_sqlite:
                sa.event.listen(engine, "checkin", lambda _connection, record: record.close())
            engine.dispose()


def _pool(engine: sa.Engine) -> LendingPool:
    pool = engine.pool
    assert isinstance(pool, LendingPool), "SQLite's"
    return pool


def _make_durable(cursor: Any, entry: ConnectionPoolEntry) -> None:
    """Let the next transactions of a connection wait for the disk again; a connection that cannot is given up."""
    try:
        cursor.execute("PRAGMA synchronous=FULL")
    except _SQLITE.Error:
        entry.invalidate()
