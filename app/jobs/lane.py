"""One worker process and the pool of one that keeps it: a job's crash or time-out touches nobody else.

A shared pool would tie its workers together by the pipe and the lock they take turns at; with one process per pool
it is always certain whose job a process died of, and a replacement starts from a clean slate.
"""

from __future__ import annotations

import multiprocessing
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path

from pebble import ProcessPool

from app.jobs.queue import Job
from app.jobs.worker_process import start_worker
from app.records.codec import Outcome

Compute = Callable[[Job, str, int], tuple[Outcome, float]]
_CALM_FAILURES = 3
_LONGEST_PAUSE_S = 2.0


class Lane:
    """One worker process; at most one job at a time."""

    def __init__(self, compute: Compute, *, max_pixels: int, timeout_s: float) -> None:
        self.job: Job | None = None
        self.broken = False
        self._compute = compute
        self._max_pixels = max_pixels
        self._timeout_s = timeout_s
        self._failures = 0
        self._not_before = 0.0
        self._pool = self._open()

    def _open(self) -> ProcessPool:
        pool = ProcessPool(
            max_workers=1,
            initializer=start_worker,
            initargs=(self._max_pixels, True),
            context=multiprocessing.get_context("spawn"),
        )
        # Asking starts the pool and its process now, from the runner's own thread, which outlives both.
        assert pool.active
        return pool

    @property
    def idle(self) -> bool:
        """Whether a job can be given to it."""
        return self.job is None and not self.broken and time.monotonic() >= self._not_before

    def submit(self, job: Job, path: Path) -> Future[tuple[Outcome, float]]:
        """Begin a job; the future is done when it is over, in whatever way.

        Raises RuntimeError where the process was lost while it had nothing to do; then `replace` is due.
        """
        try:
            future: Future[tuple[Outcome, float]] = self._pool.schedule(
                self._compute, args=(job, str(path), self._max_pixels), timeout=self._timeout_s
            )
        except RuntimeError:
            self.broken = True
            raise
        self.job = job
        return future

    def succeeded(self) -> None:
        """Note that a job came to its end."""
        self.job = None
        self._failures = 0

    def replace(self) -> None:
        """Leave a pool whose process died or hung, and start another; a short pause stops a storm of restarts."""
        self.job = None
        self.broken = False
        self._failures += 1
        if self._failures > _CALM_FAILURES:
            self._not_before = time.monotonic() + min(0.1 * 2**self._failures, _LONGEST_PAUSE_S)
        threading.Thread(target=_end, args=(self._pool,), name="pool-end", daemon=True).start()
        self._pool = self._open()

    def close(self) -> None:
        """End the process, whatever it does."""
        _end(self._pool)


def _end(pool: ProcessPool) -> None:
    pool.stop()  # type: ignore[no-untyped-call]
    pool.join()
