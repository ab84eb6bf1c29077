"""What processes left in the data folder that were killed while they wrote it.

A small file, and an original of a restored session, is written under its name with sixteen digits appended, then
renamed; a session is restored by way of a folder of its own, which is locked meanwhile. Only time shows that a file was
left and is not being written, and no clock has to measure it: writing one never lasts from one round to
the next.
"""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from app.blobs.durable import remove_file
from app.logs import Logger
from app.records.file_lock import AlreadyLocked, FileLock

RESTORING_SESSION, RESTORING_LOCK = "restoring-session-", "restoring.lock"
FOLDERS_LOCK = "migrate.lock"
"""The data folder's own, which only changes of the schema hold otherwise."""
_UNFINISHED = re.compile(r".+\.[0-9a-f]{16}")

log = Logger(__name__)


class UnfinishedFiles:
    """Removes what was left in one data folder; made once in a process, run every so often."""

    def __init__(self, data_dir: Path) -> None:
        self._data_dir = data_dir
        self._seen: frozenset[Path] = frozenset()

    def run(self) -> int:
        """Remove folders of restores that ended, and the files that were there a round ago; return how many files."""
        with FileLock(self._data_dir / FOLDERS_LOCK):
            remove_left_folders(self._data_dir)
        found = frozenset(self._unfinished())
        removed = sum(remove_file(path) for path in found & self._seen)
        self._seen = found
        if removed:
            log.info("unfinished_removed", files=removed)
        return removed

    def _unfinished(self) -> Iterator[Path]:
        for folder in (self._data_dir, *(self._data_dir / "originals").glob("??")):
            with suppress(FileNotFoundError, NotADirectoryError), os.scandir(folder) as entries:
                for entry in entries:
                    if _UNFINISHED.fullmatch(entry.name) and entry.is_file(follow_symlinks=False):
                        yield Path(entry.path)


def remove_left_folders(data_dir: Path) -> None:
    """Remove the folders of restores that were killed; the caller holds `FOLDERS_LOCK`."""
    for folder in data_dir.glob(f"{RESTORING_SESSION}*"):
        lock = FileLock(folder / RESTORING_LOCK)
        with suppress(AlreadyLocked, FileNotFoundError):  # in use, or gone meanwhile
            lock.acquire()
            lock.release()
            shutil.rmtree(folder, ignore_errors=True)
