"""Only one runner at a time: a file lock in the data folder and, on PostgreSQL, an advisory lock in the database.

Both are freed by the system when their holder dies.
"""

from __future__ import annotations

from pathlib import Path

import sqlalchemy as sa

from app.records.database import Database
from app.records.lock import AlreadyLocked, FileLock

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
        connection = self._database.engine.connect().execution_options(isolation_level="AUTOCOMMIT")
        if not connection.scalar(sa.select(sa.func.pg_try_advisory_lock(_ADVISORY_LOCK))):
            connection.close()
            self._file.release()
            raise AlreadyLocked("database")
        self._connection = connection

    def release(self) -> None:
        """Free the lock; harmless when it is not held."""
        if self._connection is not None:
            self._connection.execute(sa.select(sa.func.pg_advisory_unlock(_ADVISORY_LOCK)))
            self._connection.close()
            self._connection = None
        self._file.release()
