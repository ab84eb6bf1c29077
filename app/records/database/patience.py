"""How long writers of SQLite wait for another program that has the database: not beyond the end of the service.

SQLite's own wait cannot be cut short, so that it is asked for short ones, one after another.
"""

from __future__ import annotations

import math
import sqlite3
import time
from collections.abc import Callable

BUSY_TIMEOUT_S = 20.0
LAST_S = 10.0
"""The same once the service is to end: its parts write a last time, one after another."""
SLICE_S = 0.1
"""SQLite's own wait: what is left of one when the service ends, for each writer."""
_PRIMARY = 0xFF
"""Of SQLite's result codes; extended ones say more of the same (https://sqlite.org/rescode.html)."""


class Patience:
    """The patience of all writers of one database; safe to use from several threads."""

    def __init__(self) -> None:
        self._end_s = math.inf

    def end_within(self, seconds: float = LAST_S) -> None:
        """Let nobody wait for longer than this from now on, whoever waits already included."""
        self._end_s = min(self._end_s, time.monotonic() + seconds)

    def begin(self, begin: Callable[[], object]) -> None:
        """Begin a transaction; raises what `begin` raises, of a busy database once patience is over."""
        deadline_s = time.monotonic() + BUSY_TIMEOUT_S
        while True:
            try:
                begin()
            except Exception as error:  # the driver's own, or SQLAlchemy's of it
                code = getattr(getattr(error, "orig", error), "sqlite_errorcode", sqlite3.SQLITE_ERROR)
                if code & _PRIMARY != sqlite3.SQLITE_BUSY or time.monotonic() >= min(deadline_s, self._end_s):
                    raise
            else:
                return
