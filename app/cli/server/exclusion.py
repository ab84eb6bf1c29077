"""Refusals where another process already serves a data folder, or runs its jobs."""

from __future__ import annotations

from app.cli.context import data_failures
from app.client.commands import fail
from app.records.file_lock import AlreadyLocked, FileLock
from app.settings import Settings


def require_no_runner(settings: Settings) -> None:
    """End the command where another process already runs jobs of this data folder."""
    require_unlocked(settings, "runner.lock", f"Another process computes the images of {settings.data_dir}.")


def require_unlocked(settings: Settings, name: str, message: str) -> None:
    """End the command where another process holds a lock that this one needs; create no file."""
    lock = FileLock(settings.data_dir / name)
    try:
        with data_failures(settings):
            if not lock.path.exists():
                return
            lock.acquire()
    except AlreadyLocked:
        fail(message, "Stop that process, or choose another --data-dir.")
    lock.release()
