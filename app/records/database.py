"""The database: engines, transactions, migrations.

SQLite (the embedded default) runs in WAL mode with `synchronous=FULL`: a committed transaction survives a power cut.
Writers begin with BEGIN IMMEDIATE, so that two of them never read the same state and lose an update; readers have an
engine of their own with plain BEGIN and never wait. PostgreSQL uses one engine for both.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any

import sqlalchemy as sa
import structlog
from sqlalchemy import orm
from sqlalchemy.pool import QueuePool

from app.errors import StorageFull, Unavailable

BUSY_TIMEOUT_S = 20.0
_DAMAGE = ("database disk image is malformed", "file is not a database")

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

    def __init__(self, url: str) -> None:
        self.url = sa.make_url(url)
        self.is_sqlite = self.url.get_backend_name() == "sqlite"
        if self.is_sqlite:
            self._writer = _sqlite_engine(self.url, begin="BEGIN IMMEDIATE", connections=1)
            self._reader = _sqlite_engine(self.url, begin="BEGIN", connections=20)
        else:
            self._writer = self._reader = sa.create_engine(
                self.url, pool_size=10, max_overflow=20, pool_pre_ping=True
            )
        self._write_session = orm.sessionmaker(self._writer, expire_on_commit=False)
        self._read_session = orm.sessionmaker(self._reader, expire_on_commit=False)

    @property
    def engine(self) -> sa.Engine:
        """The engine writers use."""
        return self._writer

    @contextmanager
    def write(self) -> Iterator[orm.Session]:
        """One write transaction: committed at the end, rolled back on any error. Never nest two of these."""
        with _refusals(), self._write_session.begin() as session:
            yield session

    @contextmanager
    def read(self) -> Iterator[orm.Session]:
        """One consistent snapshot to read from."""
        with _refusals(), self._read_session() as session:
            yield session

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
        if "disk is full" in reason or "disk i/o error" in reason or "no space left" in reason:
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


def _sqlite_engine(url: sa.URL, *, begin: str, connections: int) -> sa.Engine:
    module, _ = sqlite_driver()
    engine = sa.create_engine(
        url,
        module=module,
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
