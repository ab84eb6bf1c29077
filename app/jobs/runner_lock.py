"""One runner a data folder, by a file lock; and on PostgreSQL, where runners share a database, that it is in use.

Both are freed by the system when their holder dies.
"""

from __future__ import annotations

import time
from pathlib import Path

from app.records.database import Database
from app.records.file_lock import FileLock
from app.records.presence import Presence

_CHECK_S = 5.0


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
