"""Periodic chores while the service runs: one thread, a list of chores.

A chore is a name and a function that takes the round: whether the service is stopping, and what time it is. It does
what there is to do and returns; one that fails is logged, and the others have their turn.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from datetime import UTC, datetime

import sqlalchemy as sa

from app.errors import ServiceError
from app.logs import Logger
from app.services.installation.context import ServiceContext
from app.services.installation.loop import Loop
from app.services.maintenance.orphans import OrphanSweep
from app.services.maintenance.retention import Retention, elapsed_s
from app.services.maintenance.unfinished import UnfinishedFiles
from app.services.originals import finish_removals

INTERVAL_S = 600.0

log = Logger(__name__)


class Round:
    """One turn of all chores: `stopped()` is asked by chores that may take long, `now_s` is the time to judge by.

    `now_s` is the wall clock as it was at the start, advanced by the monotonic one: a clock that is set forward while
    the service runs makes nothing old.
    """

    def __init__(self, now_s: float, stopped: Callable[[], bool]) -> None:
        self.now_s = now_s
        self.stopped = stopped


Chore = tuple[str, Callable[[Round], object]]


def chores(installation: ServiceContext) -> list[Chore]:
    """Return what an installation needs done."""
    database, blobs = installation.database, installation.blobs
    sweep = OrphanSweep(database, blobs, installation.settings.data_dir)
    unfinished = UnfinishedFiles(installation.settings.data_dir)
    retention = Retention(installation)
    return [
        ("finish_removals", lambda turn: finish_removals(database, blobs, stopped=turn.stopped)),
        ("sweep_orphans", lambda turn: sweep.run(turn.now_s, stopped=turn.stopped)),
        ("sweep_unfinished", lambda turn: unfinished.run()),
        # The clock as it is: retention itself judges whether to believe it.
        ("retention", lambda turn: retention.run(datetime.now(UTC), elapsed_s(), stopped=turn.stopped)),
    ]


class Maintenance:
    """Runs chores at the start and every `interval_s` seconds until stopped."""

    def __init__(
        self,
        chores: Sequence[Chore],
        *,
        interval_s: float = INTERVAL_S,
        turn: Callable[[], AbstractContextManager[bool]] = lambda: nullcontext(True),
    ) -> None:
        """`turn` says whether this service does a round: of several with one database, one does at a time."""
        self._turn = turn
        self._chores = tuple(chores)
        self._offset_s = time.time() - time.monotonic()
        self._loop = Loop("maintenance", self.run_once, interval_s)

    def start(self) -> None:
        """Begin; the first round at once, in the thread."""
        self._loop.start()

    def begin_stop(self) -> None:
        """Begin no further chore, and ask a running one to stop."""
        self._loop.begin_stop()

    def stop(self) -> None:
        """End; returns when no chore runs any more."""
        self._loop.stop()

    def run_once(self) -> None:
        """Run every chore once, unless another service is doing so."""
        try:
            with self._turn() as is_ours:
                if is_ours:
                    self._run_chores()
        except (ServiceError, sa.exc.SQLAlchemyError) as error:
            log.warning("chores_put_off", error=type(error).__name__)

    def _run_chores(self) -> None:
        for name, function in self._chores:
            if self._loop.is_stopping():
                return
            try:
                function(Round(time.monotonic() + self._offset_s, self._loop.is_stopping))
            except ServiceError as error:  # a full disk or a busy database passes
                log.warning("chore_put_off", chore=name, code=error.code)
            except Exception:
                log.exception("chore_failed", chore=name)
