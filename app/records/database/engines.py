"""The engines: how a connection to SQLite or PostgreSQL is made, and what its driver reads."""

from __future__ import annotations

import sqlite3
import time
from functools import partial
from types import ModuleType
from typing import Any

import sqlalchemy as sa

from app.records.database.lending import LendingPool
from app.records.database.patience import BUSY_TIMEOUT_S, SLICE_S, Patience
from app.records.outcome import write_json
from app.records.readable import read_json, read_time

CONNECTIONS = 30
"""Connections to PostgreSQL that one process has at most for its transactions."""
NOTICE_LOSS = {
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
MAX_IDLE_WAL_BYTES = 16 * 1024 * 1024
"""What the write-ahead log keeps of the disk once its content is in the database, several times what it usually takes.
While something reads for long, as a backup does, it grows with every change, and would stay as large as it ever was.
"""
_SQLITE_TEXT = partial(str, encoding="utf-8", errors="replace")


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


def postgresql_engine(url: sa.URL, *, connections: int = CONNECTIONS) -> sa.Engine:
    # psycopg is an extra: it is imported where PostgreSQL is used, and only there.
    from psycopg.adapt import Loader

    class TimeLoader(Loader):
        def load(self, data: Any) -> Any:
            return read_time(bytes(data))

    engine = sa.create_engine(
        url,
        isolation_level="READ COMMITTED",  # whatever the role's default: streams read what was committed meanwhile
        pool_size=min(10, connections),
        max_overflow=max(0, connections - 10),
        pool_pre_ping=True,
        json_deserializer=read_json,
        json_serializer=write_json,
        connect_args={name: value for name, value in NOTICE_LOSS.items() if name not in url.query},
    )

    @sa.event.listens_for(engine, "connect")
    def configure(connection: Any, _record: Any) -> None:
        # By SET, not by `options` in the address: pgbouncer refuses options it does not know, and follows these two.
        autocommit, connection.autocommit = connection.autocommit, True
        connection.execute("SET TimeZone = 'UTC'")
        connection.execute("SET DateStyle = 'ISO, YMD'")
        connection.execute(f"SET lock_timeout = '{BUSY_TIMEOUT_S:.0f}s'")
        connection.autocommit = autocommit
        connection.adapters.register_loader("timestamptz", TimeLoader)

    return engine


def sqlite_engine(
    url: sa.URL, *, begin: str, connections: int, patience: Patience | None = None
) -> sa.Engine:
    module, _ = sqlite_driver()
    engine = sa.create_engine(
        url,
        module=module,
        json_deserializer=read_json,
        json_serializer=write_json,
        poolclass=LendingPool,
        # One connection for writers: threads of this process queue here, which is fairer and quicker than SQLite's
        # own sleeping and retrying, which remains for other processes.
        pool_size=connections,
        max_overflow=0,
        pool_timeout=BUSY_TIMEOUT_S,
        connect_args={"timeout": SLICE_S if patience else BUSY_TIMEOUT_S, "check_same_thread": False},
    )

    @sa.event.listens_for(engine, "connect")
    def configure(connection: Any, _record: Any) -> None:
        connection.isolation_level = None  # we say BEGIN ourselves
        # A text that is no UTF-8 would end the whole query as if the database were out of order.
        connection.text_factory = _SQLITE_TEXT
        cursor = connection.cursor()
        _write_ahead(cursor)
        cursor.execute("PRAGMA synchronous=FULL")
        cursor.execute("PRAGMA foreign_keys=ON")
        # KiB a connection. The system keeps the file's pages, too; a larger cache fills as the database grows, so that
        # the memory of a service seems to grow with its uploads.
        cursor.execute("PRAGMA cache_size=-4096")
        cursor.execute(f"PRAGMA journal_size_limit={MAX_IDLE_WAL_BYTES}")
        cursor.close()

    @sa.event.listens_for(engine, "begin")
    def start(connection: sa.Connection) -> None:
        if patience is None:
            connection.exec_driver_sql(begin)
        else:
            patience.begin(lambda: connection.exec_driver_sql(begin))

    return engine


def _write_ahead(cursor: Any) -> None:
    """Have SQLite write ahead. It does not wait for others to change a new file's mode: two first starts collided."""
    deadline = time.monotonic() + BUSY_TIMEOUT_S
    while True:
        try:
            cursor.execute("PRAGMA journal_mode=WAL")
        except (sqlite3.OperationalError, sqlite_driver()[0].OperationalError) as error:
            if error.sqlite_errorcode != sqlite3.SQLITE_BUSY or time.monotonic() > deadline:
                raise
            time.sleep(0.02)
        else:
            return
