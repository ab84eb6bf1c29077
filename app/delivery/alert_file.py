"""A file for systems of the shop floor that call nobody and are called by nobody: a line of JSON for each notice.

A line is there whole or not at all, each once: what is written is flushed to the disk before the place is stored, the
line names its number, and a line that a power cut halved is removed before the next. A full disk, or a share that is
away, is tried again, and nothing else waits for it.
"""

from __future__ import annotations

import json
import os
from pathlib import Path

from app.blobs.durable import write_durably
from app.logs import Logger
from app.records.database import Database
from app.services.notices import document_of, latest_number, numbered_after

MAX_BYTES = 10 * 1024 * 1024
"""Beyond it the file becomes FILE.1, in place of the one before, and a new one begins."""
_AT_ONCE = 100
_TAIL = 64 * 1024

log = Logger(__name__)


class AlertFile:
    """Appends notices to a file."""

    def __init__(self, database: Database, path: Path, data_dir: Path, *, max_bytes: int = MAX_BYTES) -> None:
        self._database = database
        self._path = path
        self._place = data_dir / "alert-file.place"
        self._max_bytes = max_bytes
        self._number: int | None = None
        self._is_failing = False

    def append(self) -> bool:
        """Write what is new; return whether there was anything."""
        try:
            written = self._append()
        except OSError as error:
            self._number = None  # look again at what the file holds
            if not self._is_failing:
                log.warning("alert_file_not_written", file=str(self._path), reason=error.strerror)
            self._is_failing = True
            return False
        if self._is_failing:
            log.info("alert_file_written_again", file=str(self._path))
        self._is_failing = False
        return written

    def _append(self) -> bool:
        if self._number is None:
            self._number = self._find_place()
        with self._database.read() as records:
            rows = numbered_after(records, self._number, limit=_AT_ONCE)
            lines = [
                json.dumps({"number": row.number, **document_of(row)}, separators=(",", ":")).encode() + b"\n"
                for row in rows
            ]
        if not rows:
            return False
        self._write(b"".join(lines))
        self._number = rows[-1].number
        self._store_place()
        return True

    def _write(self, content: bytes) -> None:
        """Append bytes and flush them to the disk, or leave the file as it was. Raises OSError."""
        if self._path.exists() and self._path.stat().st_size + len(content) > self._max_bytes:
            self._path.replace(self._path.with_name(self._path.name + ".1"))
        with self._path.open("ab", buffering=0) as file:
            before = os.fstat(file.fileno()).st_size
            try:
                left = memoryview(content)
                while left:
                    left = left[file.write(left) :]
                os.fsync(file.fileno())
            except OSError:
                file.truncate(before)
                raise

    def _find_place(self) -> int:
        """Return the number of the last notice in the file; at the very first, of the last notice there is.

        An older database may have been put back: numbers go on from its last, and lines of later ones do not count.
        """
        with self._database.read() as records:
            latest = latest_number(records)
        if not self._place.exists():
            number = latest
        else:
            try:
                stored = int(self._place.read_text(encoding="ascii"))
            except ValueError:
                stored = 0
            number = max(min(stored, latest), self._last_in_file())
        self._number = number
        self._store_place()
        return number

    def _last_in_file(self) -> int:
        """Remove half a line at the end of the file, and return the number of the notice that its last line names.

        0 where the database has no such notice.
        """
        if not self._path.exists():
            return 0
        with self._path.open("rb+") as file:
            size = file.seek(0, os.SEEK_END)
            file.seek(max(0, size - _TAIL))
            tail = file.read()
            whole = tail[: tail.rfind(b"\n") + 1]
            if len(whole) < len(tail):
                file.truncate(size - len(tail) + len(whole))
        for line in reversed(whole.splitlines()):
            try:
                document = json.loads(line)
                number, notice_id = int(document["number"]), document["id"]
            except (ValueError, TypeError, KeyError):
                continue
            with self._database.read() as records:
                found = numbered_after(records, number - 1, limit=1)
            return number if found and (found[0].number, found[0].id) == (number, notice_id) else 0
        return 0

    def _store_place(self) -> None:
        write_durably(self._place, str(self._number).encode("ascii"))
