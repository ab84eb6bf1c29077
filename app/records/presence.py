"""Who uses an installation: one runner a data folder, by a file lock, and on PostgreSQL who uses the database.

There services and workers share a lock in it, and who changes its schema holds it alone; on SQLite the data folder's
lock files say the same. The system frees the file's lock when its holder dies, the server its own when the holder's
connection ends.
"""

from __future__ import annotations

import contextlib
import time
from pathlib import Path

import sqlalchemy as sa

from app.logs import Logger
from app.records.database import Database
from app.records.file_lock import AlreadyLocked, FileLock

log = Logger(__name__)

ADVISORY_LOCK = 0x706F_7365  # "pose"
_CHECK_S = 5.0


class Presence:
    """The right to use one database together with others or, `alone`, without any; nothing on SQLite."""

    def __init__(self, database: Database, *, alone: bool = False) -> None:
        self._database = database
        self._alone = alone
        self._connection: sa.Connection | None = None

    def acquire(self) -> None:
        """Take the lock, or raise AlreadyLocked at once."""
        if not self._database.is_sqlite:
            self._connection = self._locked_connection()

    def keep(self) -> None:
        """Take the lock again where its connection was lost, as soon as that is possible."""
        if self._database.is_sqlite:
            return
        try:
            if self._connection is not None:
                self._connection.execute(sa.select(1))
                return
        except sa.exc.DBAPIError:
            self._drop_connection()
        try:
            self._connection = self._locked_connection()
        except (AlreadyLocked, sa.exc.DBAPIError) as error:
            log.warning("presence_lost", error=type(error).__name__)

    def release(self) -> None:
        """Free the lock; harmless when it is not held."""
        self._drop_connection()

    def _drop_connection(self) -> None:
        """Free the lock and close the connection, lost or not."""
        if self._connection is not None:
            if not self._connection.invalidated:
                # Closing alone frees it as well, but only when the server notices.
                with contextlib.suppress(sa.exc.DBAPIError):
                    self._connection.execute(sa.select(sa.func.pg_advisory_unlock_all()))
            self._connection.invalidate()
            self._connection.close()
            self._connection = None

    def _locked_connection(self) -> sa.Connection:
        connection = self._database.engine.connect().execution_options(isolation_level="AUTOCOMMIT")
        take = sa.func.pg_try_advisory_lock if self._alone else sa.func.pg_try_advisory_lock_shared
        if not connection.scalar(sa.select(take(ADVISORY_LOCK))):
            connection.close()
            raise AlreadyLocked("database")
        return connection


class RunnerLock:
    """The right to run jobs of one data folder and database; `alone`: the right that nobody else does."""

    def __init__(self, data_dir: Path, database: Database, *, alone: bool = False) -> None:
        self._file = FileLock(data_dir / "runner.lock")
        self._presence = Presence(database, alone=alone)
        self._checked_s = time.monotonic()

    def acquire(self) -> None:
        """Take the lock, or raise AlreadyLocked at once."""
        self._file.acquire()
        try:
            self._presence.acquire()
        except BaseException:
            self._file.release()
            raise

    def keep(self) -> None:
        """Take the database's lock again where its connection was lost; it is looked at every few seconds.

        The runner goes on meanwhile: claims keep two runners from writing one result twice.
        """
        if time.monotonic() - self._checked_s >= _CHECK_S:
            self._checked_s = time.monotonic()
            self._presence.keep()

    def release(self) -> None:
        """Free the lock; harmless when it is not held."""
        self._presence.release()
        self._file.release()
