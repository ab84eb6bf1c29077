"""Only one runner at a time: a file lock in the data folder and, on PostgreSQL, an advisory lock in the database.

Both are freed by the system when their holder dies.
"""

from __future__ import annotations

import contextlib
from pathlib import Path

import sqlalchemy as sa
import structlog

from app.records.database import Database
from app.records.file_lock import AlreadyLocked, FileLock

log = structlog.get_logger(__name__)

_ADVISORY_LOCK = 0x706F_7365  # "pose"


class RunnerLock:
    """The right to run jobs of one data folder and database."""

    def __init__(self, data_dir: Path, database: Database) -> None:
        self._file = FileLock(data_dir / "runner.lock")
        self._database = database
        self._connection: sa.Connection | None = None

    def acquire(self) -> None:
        """Take the lock, or raise AlreadyLocked at once."""
        self._file.acquire()
        if self._database.is_sqlite:
            return
        try:
            self._connection = self._locked_connection()
        except BaseException:
            self._file.release()
            raise

    def keep(self) -> None:
        """Take the database's lock again where its connection was lost, as soon as that is possible.

        The runner goes on meanwhile: claims keep two runners from writing one result twice. The lock may be held by
        nobody but this runner's lost connection, which a server can take hours to notice.
        """
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
            log.warning("runner_lock_lost", error=type(error).__name__)

    def release(self) -> None:
        """Free the lock; harmless when it is not held."""
        self._drop_connection()
        self._file.release()

    def _drop_connection(self) -> None:
        """Free the lock and close the connection, lost or not."""
        if self._connection is not None:
            if not self._connection.invalidated:
                # Closing alone frees it as well, but only when the server notices.
                with contextlib.suppress(sa.exc.DBAPIError):
                    self._connection.execute(sa.select(sa.func.pg_advisory_unlock(_ADVISORY_LOCK)))
            self._connection.invalidate()
            self._connection.close()
            self._connection = None

    def _locked_connection(self) -> sa.Connection:
        connection = self._database.engine.connect().execution_options(isolation_level="AUTOCOMMIT")
        if not connection.scalar(sa.select(sa.func.pg_try_advisory_lock(_ADVISORY_LOCK))):
            connection.close()
            raise AlreadyLocked("database")
        return connection
