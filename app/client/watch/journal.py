"""The journal of a watched folder: what became of each file, kept over restarts, kills and power cuts.

A row is written after the service has acknowledged an image, never before. What is lost between the two is sent again
and recognised by the service. One process at a time has a journal open; the lock ends with the process.
"""

from __future__ import annotations

import contextlib
import sqlite3
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

State = Literal["stored", "refused", "measured", "failed", "done"]
"""`stored`: acknowledged, result unknown; `refused`: never stored; `measured`, `failed`: the result, not yet acted on;
`done`: nothing is left to do."""

_SCHEMA = """
CREATE TABLE IF NOT EXISTS files (
    session_id TEXT NOT NULL, name TEXT NOT NULL, signature TEXT NOT NULL,
    pose_id TEXT NOT NULL, cycle INTEGER, sha256 TEXT NOT NULL,
    state TEXT NOT NULL, measurement_id TEXT, detail TEXT, changed_s INTEGER NOT NULL,
    PRIMARY KEY (session_id, name)
) WITHOUT ROWID;
CREATE INDEX IF NOT EXISTS files_by_image ON files (session_id, pose_id, sha256);
DROP INDEX IF EXISTS files_by_state;
CREATE INDEX IF NOT EXISTS files_by_change ON files (session_id, state, changed_s);
CREATE INDEX IF NOT EXISTS files_by_cycle ON files (session_id, pose_id, cycle);
CREATE TABLE IF NOT EXISTS poses (
    session_id TEXT NOT NULL, pose_id TEXT NOT NULL, body TEXT NOT NULL,
    PRIMARY KEY (session_id, pose_id)
) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS numbers (
    session_id TEXT NOT NULL, pose_id TEXT NOT NULL, sha256 TEXT NOT NULL, cycle INTEGER NOT NULL,
    PRIMARY KEY (session_id, pose_id, sha256)
) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS sessions (given TEXT PRIMARY KEY, session_id TEXT NOT NULL, target_id TEXT) WITHOUT ROWID;
"""
_COLUMNS = "name, signature, pose_id, cycle, sha256, state, measurement_id, detail"
_KEPT_S = 90 * 86_400


class JournalInUse(Exception):
    """Another process has the journal open."""


class JournalUnusable(Exception):
    """The journal cannot be opened or written; the message gives the reason."""


@dataclass(frozen=True, slots=True)
class Entry:
    """What became of one file. `signature` is the file's size, time and identity when it was read."""

    name: str
    signature: str
    pose_id: str
    cycle: int | None
    sha256: str
    state: State
    measurement_id: str | None = None
    detail: str | None = None


class Journal:
    """A journal file; safe to use from several threads of one process.

    Parameters
    ----------
    path
        The file; it is made where it does not exist. It belongs on a local disk: SQLite's locks are not dependable on
        network shares.

    Raises
    ------
    JournalInUse
        Another process watches with this journal.
    JournalUnusable
        The file cannot be made or opened. A damaged one is not an error: it is kept under another name, which
        `replaced` gives, and a new one begun; the service knows which images it has.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.replaced: Path | None = None
        self._lock = threading.Lock()
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._connection = self._opened()
        except OSError as error:
            raise JournalUnusable(f"{path} cannot be made: {error.strerror or error}") from error

    def close(self) -> None:
        """Release the file."""
        with self._lock:
            self._connection.close()

    def entries(self, session_id: str) -> dict[str, Entry]:
        """Return every file's entry by its name."""
        return {entry.name: entry for entry in self._select("session_id = ?", session_id)}

    def in_state(self, session_id: str, *states: State, most: int = -1) -> list[Entry]:
        """Return the entries in these states, in the order in which they got there; `most` of them, all for -1."""
        marks = ", ".join("?" * len(states))
        where = f"session_id = ? AND state IN ({marks}) ORDER BY changed_s LIMIT {most:d}"
        return self._select(where, session_id, *states)

    def has_state(self, session_id: str, *states: State) -> bool:
        """Return whether an entry is in one of these states."""
        return bool(self.in_state(session_id, *states, most=1))

    def find_image(self, session_id: str, pose_id: str, sha256: str) -> Entry | None:
        """Return an entry of this image at this pose that the service has stored, under whatever name."""
        where = "session_id = ? AND pose_id = ? AND sha256 = ? AND state != 'refused' LIMIT 1"
        found = self._select(where, session_id, pose_id, sha256)
        return found[0] if found else None

    def record(self, session_id: str, entry: Entry) -> None:
        """Write what became of a file, durably, in place of what was known of its name and of its image's number."""
        with self._transaction() as connection:
            connection.execute(
                f"INSERT OR REPLACE INTO files (session_id, {_COLUMNS}, changed_s) "  # noqa: S608 - constants
                "VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
                (
                    *(session_id, entry.name, entry.signature, entry.pose_id, entry.cycle, entry.sha256),
                    *(entry.state, entry.measurement_id, entry.detail, int(time.time())),
                ),
            )
            connection.execute(
                "DELETE FROM numbers WHERE session_id = ? AND pose_id = ? AND sha256 = ?",
                (session_id, entry.pose_id, entry.sha256),
            )

    def advance(self, session_id: str, entry: Entry, state: State, detail: str | None) -> None:
        """Write a further state of an entry, unless its file was replaced and sent anew meanwhile."""
        with self._transaction() as connection:
            connection.execute(
                "UPDATE files SET state = ?, detail = ?, changed_s = ? "
                "WHERE session_id = ? AND name = ? AND signature = ? AND sha256 = ?",
                (state, detail, int(time.time()), session_id, entry.name, entry.signature, entry.sha256),
            )

    def last_cycle(self, session_id: str, pose_id: str) -> int:
        """Return the highest cycle of a pose, 0 for none."""
        with self._reading() as connection:
            query = (
                "SELECT cycle FROM files WHERE session_id = ? AND pose_id = ? AND state != 'refused' "
                "ORDER BY cycle DESC LIMIT 1"
            )
            row = connection.execute(query, (session_id, pose_id)).fetchone()
        return 0 if row is None else int(row[0] or 0)

    def numbers(self, session_id: str) -> list[tuple[str, str, int]]:
        """Return pose, SHA-256 and cycle of each image that was numbered and has no entry yet."""
        with self._reading() as connection:
            query = "SELECT pose_id, sha256, cycle FROM numbers WHERE session_id = ?"
            return connection.execute(query, (session_id,)).fetchall()

    def record_number(self, session_id: str, pose_id: str, sha256: str, cycle: int) -> None:
        """Write which cycle an image has that is not acknowledged yet."""
        with self._transaction() as connection:
            row = (session_id, pose_id, sha256, cycle)
            connection.execute("INSERT OR REPLACE INTO numbers VALUES (?, ?, ?, ?)", row)

    def forget(self, session_id: str, names: list[str]) -> None:
        """Remove entries, so that their files are sent again."""
        with self._transaction() as connection:
            rows = [(session_id, name) for name in names]
            connection.executemany("DELETE FROM files WHERE session_id = ? AND name = ?", rows)

    def prune(self, session_id: str, present: set[str]) -> None:
        """Remove entries that were done long ago and whose files are gone, so that the journal stays small."""
        with self._reading() as connection:
            query = "SELECT name FROM files WHERE session_id = ? AND state IN ('done', 'refused') AND changed_s < ?"
            old = connection.execute(query, (session_id, int(time.time()) - _KEPT_S)).fetchall()
        if gone := [name for (name,) in old if name not in present]:
            self.forget(session_id, gone)

    def pose(self, session_id: str, pose_id: str) -> str | None:
        """Return the commanded pose that was last sent, as it was written by `record_pose`."""
        with self._reading() as connection:
            query = "SELECT body FROM poses WHERE session_id = ? AND pose_id = ?"
            row = connection.execute(query, (session_id, pose_id)).fetchone()
        return None if row is None else str(row[0])

    def record_pose(self, session_id: str, pose_id: str, body: str) -> None:
        """Write which commanded pose the service has stored."""
        with self._transaction() as connection:
            connection.execute("INSERT OR REPLACE INTO poses VALUES (?, ?, ?)", (session_id, pose_id, body))

    def session(self, given: str) -> tuple[str, str | None] | None:
        """Return the ids of the session and target that an earlier run found for a name, or None."""
        with self._reading() as connection:
            query = "SELECT session_id, target_id FROM sessions WHERE given = ?"
            row = connection.execute(query, (given,)).fetchone()
        return None if row is None else (row[0], row[1])

    def record_session(self, given: str, session_id: str, target_id: str | None) -> None:
        """Write which session and target a name stands for."""
        with self._transaction() as connection:
            connection.execute(
                "INSERT OR REPLACE INTO sessions VALUES (?, ?, ?)", (given, session_id, target_id)
            )

    def _opened(self) -> sqlite3.Connection:
        try:
            return _connect(self.path)
        except sqlite3.OperationalError as error:
            if "locked" in str(error):
                raise JournalInUse(f"Another process watches with the journal {self.path}.") from error
            raise JournalUnusable(f"{self.path} cannot be opened: {error}") from error
        except sqlite3.DatabaseError:
            self.replaced = self.path.with_name(f"{self.path.name}.damaged-{int(time.time())}")
            self.path.replace(self.replaced)
            for suffix in ("-journal", "-wal", "-shm"):
                with contextlib.suppress(FileNotFoundError):
                    self.path.with_name(self.path.name + suffix).unlink()
        try:
            return _connect(self.path)
        except sqlite3.DatabaseError as error:
            raise JournalUnusable(f"{self.path} cannot be made: {error}") from error

    def _select(self, where: str, *values: str) -> list[Entry]:
        with self._reading() as connection:
            rows = connection.execute(f"SELECT {_COLUMNS} FROM files WHERE {where}", values).fetchall()  # noqa: S608
        return [Entry(*row) for row in rows]

    @contextlib.contextmanager
    def _reading(self) -> Iterator[sqlite3.Connection]:
        with self._lock:
            try:
                yield self._connection
            except sqlite3.DatabaseError as error:
                raise JournalUnusable(f"{self.path} cannot be read: {error}") from error

    @contextlib.contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        with self._lock:
            try:
                with self._connection:
                    yield self._connection
            except sqlite3.DatabaseError as error:
                raise JournalUnusable(f"{self.path} cannot be written: {error}") from error


def _connect(path: Path) -> sqlite3.Connection:
    """Open the file for this process alone; raises sqlite3.DatabaseError where it is locked or damaged."""
    connection = sqlite3.connect(path, timeout=0.5, check_same_thread=False)
    try:
        # A lock kept for the whole run, and so a write-ahead log without shared memory. FULL: a row that was committed
        # is on the disk, by one sync, where a rollback journal needs four.
        connection.execute("PRAGMA locking_mode = EXCLUSIVE")
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA wal_autocheckpoint = 250")  # 1 MB of log
        connection.execute("PRAGMA synchronous = FULL")
        connection.execute("BEGIN EXCLUSIVE")
        connection.execute("COMMIT")  # the lock stays, by the locking mode
        (verdict,) = connection.execute("PRAGMA quick_check(1)").fetchone()
        if verdict != "ok":
            raise sqlite3.DatabaseError(verdict)
        connection.executescript(_SCHEMA)
    except BaseException:
        connection.close()
        raise
    return connection
