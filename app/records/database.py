"""The database: engines, transactions, migrations.

SQLite (the embedded default) runs in WAL mode with `synchronous=FULL`: a committed transaction survives a power cut.
Writers begin with BEGIN IMMEDIATE, so that two of them never read the same state and lose an update; readers have an
engine of their own with plain BEGIN and never wait. PostgreSQL uses one engine for both; its connections speak UTC and
ISO dates whatever the server, the database or the role has for a default.

No stored value makes reading its row raise: what cannot be read is an `Unreadable` in its place (`records.readable`).
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from types import ModuleType
from typing import Any

import sqlalchemy as sa
import structlog
from sqlalchemy import orm
from sqlalchemy.pool import QueuePool

from app.errors import StorageFull, Unavailable
from app.records.activity import current_activity
from app.records.audit import append_entry, note_created
from app.records.readable import read_json, read_time

BUSY_TIMEOUT_S = 20.0
_NOTICE_LOSS = {
    "connect_timeout": 10,  # s
    "tcp_user_timeout": 20_000,  # ms
    "keepalives": 1,
    "keepalives_idle": 10,  # s
    "keepalives_interval": 5,  # s
    "keepalives_count": 3,
}
"""libpq's options that detect a vanished server within half a minute. Without them the system goes on sending for a
quarter of an hour, and waits for an answer without limit. Options in the database's address take precedence.
"""
_SQLITE_TEXT = partial(str, encoding="utf-8", errors="replace")
_DAMAGE = ("database disk image is malformed", "file is not a database")
_NO_ROOM = ("disk is full", "disk i/o error", "no space left", "file too large")

log = structlog.get_logger(__name__)


def sqlite_driver() -> tuple[ModuleType, bool]:
    """Return the SQLite module and whether it is the bundled one (pysqlite3) rather than the standard library's."""
    try:
        from pysqlite3 import dbapi2
    except ImportError:
        return sqlite3, False
    return dbapi2, True


def sqlite_version() -> tuple[str, bool]:
    """Return SQLite's version and whether it has the fix of the WAL-reset bug (3.51.3 and later)."""
    module, _ = sqlite_driver()
    return module.sqlite_version, module.sqlite_version_info >= (3, 51, 3)


class Database:
    """Engines and transactions of one database."""

    def __init__(self, url: str | sa.URL) -> None:
        self.url = sa.make_url(url)
        self.is_sqlite = self.url.get_backend_name() == "sqlite"
        if self.is_sqlite:
            self._writer = _sqlite_engine(self.url, begin="BEGIN IMMEDIATE", connections=1)
            self._reader = _sqlite_engine(self.url, begin="BEGIN", connections=20)
        else:
            self._writer = self._reader = _postgresql_engine(self.url)
        self._write_session = orm.sessionmaker(self._writer, expire_on_commit=False)
        sa.event.listen(self._write_session, "after_flush", note_created)
        self._read_session = orm.sessionmaker(self._reader, expire_on_commit=False)

    @property
    def engine(self) -> sa.Engine:
        """The engine writers use."""
        return self._writer

    @contextmanager
    def write(self) -> Iterator[orm.Session]:
        """One write transaction: committed at the end, rolled back on any error. Never nest two of these.

        The first one of a request or command that is audited holds its entry in the audit trail.
        """
        with _refusals(), self._write_session.begin() as session:
            yield session
            append_entry(session)
        activity = current_activity()
        if activity is not None:
            activity.audited = False

    @contextmanager
    def read(self) -> Iterator[orm.Session]:
        """One consistent snapshot to read from."""
        with _refusals(), self._read_session() as session:
            yield session

    def size_bytes(self) -> int:
        """Return about how much room the database takes, and a copy of it at most."""
        pages = "SELECT page_count * page_size FROM pragma_page_count(), pragma_page_size()"
        statement = pages if self.is_sqlite else "SELECT pg_database_size(current_database())"
        with self._reader.connect() as connection:
            return int(connection.exec_driver_sql(statement).scalar_one())

    def dispose(self) -> None:
        """Close every connection."""
        self._writer.dispose()
        self._reader.dispose()


@contextmanager
def _refusals() -> Iterator[None]:
    """Turn what the database cannot do just now into the service's own errors."""
    try:
        yield
    except sa.exc.OperationalError as error:
        reason = str(error.orig).lower()
        log.error("database_refused", reason=reason)
        if any(sign in reason for sign in _NO_ROOM):
            raise StorageFull() from error
        raise Unavailable(
            "The database cannot be reached or is busy.", "Try again shortly.", code="database_unavailable"
        ) from error
    except sa.exc.DatabaseError as error:
        if not any(sign in str(error.orig).lower() for sign in _DAMAGE):
            raise
        log.critical("database_damaged", reason=str(error.orig))
        raise Unavailable(
            "The database is damaged.",
            "Stop the service, run `gridpose doctor` on the server, and restore a backup.",
            code="database_damaged",
        ) from error
    except sa.exc.TimeoutError as error:
        raise Unavailable(
            "The database is busy.", "Try again shortly.", code="database_unavailable"
        ) from error


def _postgresql_engine(url: sa.URL) -> sa.Engine:
    # psycopg is an extra: it is imported where PostgreSQL is used, and only there.
    from psycopg.adapt import Loader

    class TimeLoader(Loader):
        def load(self, data: Any) -> Any:
            return read_time(bytes(data))

    engine = sa.create_engine(
        url,
        pool_size=10,
        max_overflow=20,
        pool_pre_ping=True,
        json_deserializer=read_json,
        connect_args={name: value for name, value in _NOTICE_LOSS.items() if name not in url.query},
    )

    @sa.event.listens_for(engine, "connect")
    def configure(connection: Any, _record: Any) -> None:
        # By SET, not by `options` in the address: pgbouncer refuses options it does not know, and follows these two.
        autocommit, connection.autocommit = connection.autocommit, True
        connection.execute("SET TimeZone = 'UTC'")
        connection.execute("SET DateStyle = 'ISO, YMD'")
        connection.autocommit = autocommit
        connection.adapters.register_loader("timestamptz", TimeLoader)

    return engine


def _sqlite_engine(url: sa.URL, *, begin: str, connections: int) -> sa.Engine:
    module, _ = sqlite_driver()
    engine = sa.create_engine(
        url,
        module=module,
        json_deserializer=read_json,
        poolclass=QueuePool,
        # One connection for writers: threads of this process queue here, which is fairer and quicker than SQLite's
        # own sleeping and retrying, which remains for other processes.
        pool_size=connections,
        max_overflow=0,
        pool_timeout=BUSY_TIMEOUT_S,
        connect_args={"timeout": BUSY_TIMEOUT_S, "check_same_thread": False},
    )

    @sa.event.listens_for(engine, "connect")
    def configure(connection: Any, _record: Any) -> None:
        connection.isolation_level = None  # we say BEGIN ourselves
        # A text that is no UTF-8 would end the whole query as if the database were out of order.
        connection.text_factory = _SQLITE_TEXT
        cursor = connection.cursor()
        cursor.execute("PRAGMA journal_mode=WAL")
        cursor.execute("PRAGMA synchronous=FULL")
        cursor.execute("PRAGMA foreign_keys=ON")
        cursor.execute("PRAGMA cache_size=-16384")
        cursor.close()

    @sa.event.listens_for(engine, "begin")
    def start(connection: sa.Connection) -> None:
        connection.exec_driver_sql(begin)

    return engine
