"""News of sessions, from whatever process writes: PostgreSQL's triggers notify (migration 0017), and one connection of
each service listens. That connection also holds the service's presence in the database.

SQLite has no notifications; there, as while the connection is lost, whoever follows a session looks by itself.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

from app.logs import Logger
from app.records.database import Database
from app.records.file_lock import AlreadyLocked
from app.records.presence import ADVISORY_LOCK

if TYPE_CHECKING:
    import psycopg

CHANNEL = "gridpose"
LOOK_S = 0.5
"""How often a follower looks by itself where nothing is announced to it."""
LOOK_ANYWAY_S = 10.0
"""The same where news are announced."""
AT_MOST_EVERY_S = 0.2
"""How soon a follower looks again while news keep coming."""
_REST = 10.0
"""How many times as long as its last look a follower waits at least, up to the wait without news."""
_RECONNECT_S = 1.0

log = Logger(__name__)


class Follower:
    """Waits for news of one session, in an event loop."""

    def __init__(self, news: SessionNews) -> None:
        self._news = news
        self._loop = asyncio.get_running_loop()
        self._event = asyncio.Event()
        self._looked_s = time.monotonic()

    def wake(self) -> None:
        """Let the follower look; from any thread."""
        with suppress(RuntimeError):  # its loop has ended
            self._loop.call_soon_threadsafe(self._event.set)

    async def wait(self, *, soon: bool = False) -> bool:
        """Return when there may be news, or when it is time to look anyway, and whether news were announced.

        `soon`: the last look found what is not final yet.
        """
        rest_s = min(_REST * (time.monotonic() - self._looked_s), LOOK_S)
        if not soon:
            with suppress(TimeoutError):
                await asyncio.wait_for(
                    self._event.wait(), LOOK_ANYWAY_S if self._news.is_listening else LOOK_S
                )
        await asyncio.sleep(max(0.0, self._looked_s + max(AT_MOST_EVERY_S, rest_s) - time.monotonic()))
        was_woken = self._event.is_set()
        self._event.clear()
        self._looked_s = time.monotonic()
        return was_woken


class SessionNews:
    """Wakes the followers of sessions that changed."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._followers: defaultdict[str, set[Follower]] = defaultdict(set)
        self._guard = threading.Lock()
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None
        self.is_listening = False

    def start(self) -> None:
        """Begin to listen; raises AlreadyLocked where somebody changes the schema just now."""
        if self._database.is_sqlite:
            return
        connection = self._connect()
        self._thread = threading.Thread(target=self._run, args=(connection,), name="news", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End; every follower is woken."""
        self._ending.set()
        self.wake_all()
        if self._thread is not None:
            self._thread.join(5.0)

    def wake_all(self) -> None:
        """Let every follower look."""
        with self._guard:
            followers = [one for some in self._followers.values() for one in some]
        for follower in followers:
            follower.wake()

    @contextmanager
    def following(self, session_id: str) -> Iterator[Follower]:
        """Return what waits for news of a session; call it in an event loop."""
        follower = Follower(self)
        with self._guard:
            self._followers[session_id].add(follower)
        try:
            yield follower
        finally:
            with self._guard:
                self._followers[session_id].discard(follower)
                if not self._followers[session_id]:
                    del self._followers[session_id]

    def _connect(self) -> psycopg.Connection[Any]:
        import psycopg  # an extra

        connection = psycopg.connect(**self._database.driver_options(), autocommit=True)
        try:
            row = connection.execute("SELECT pg_try_advisory_lock_shared(%s)", [ADVISORY_LOCK]).fetchone()
            if row is None or not row[0]:
                raise AlreadyLocked("database")
            connection.execute(f"LISTEN {CHANNEL}")
        except BaseException:
            connection.close()
            raise
        self.is_listening = True
        return connection

    def _run(self, connection: psycopg.Connection[Any]) -> None:
        import psycopg

        while not self._ending.is_set():
            try:
                with connection:
                    while not self._ending.is_set():
                        for notification in connection.notifies(timeout=1.0):
                            self._wake(notification.payload)
                            if self._ending.is_set():
                                break
            except psycopg.Error as error:
                log.warning("news_lost", error=type(error).__name__)
            self.is_listening = False
            self.wake_all()
            connection = self._connect_again() or connection

    def _connect_again(self) -> psycopg.Connection[Any] | None:
        import psycopg

        while not self._ending.wait(_RECONNECT_S):
            try:
                connection = self._connect()
            except (psycopg.Error, AlreadyLocked) as error:
                log.warning("news_not_reached", error=type(error).__name__)
            else:
                self.wake_all()  # whatever was announced meanwhile
                return connection
        return None

    def _wake(self, session_id: str) -> None:
        """Wake the followers of a session; of all sessions where none is named, as when a key is revoked."""
        if not session_id:
            self.wake_all()
            return
        with self._guard:
            followers = list(self._followers.get(session_id, ()))
        for follower in followers:
            follower.wake()
