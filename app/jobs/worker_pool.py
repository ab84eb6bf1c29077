"""A slot for one worker process, in a pool of one: a job's crash or time-out affects no other worker.

A shared pool would tie its workers together by the pipe and the lock they take turns at; with one process per pool
it is always certain whose job a process died of, and a replacement starts from a clean slate.

Time limits are watched here by the monotonic clock. The pool's own limit reads the wall clock, which steps.
"""

from __future__ import annotations

import multiprocessing
import os
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass

import structlog
from pebble import ProcessExpired, ProcessPool

from app.jobs.back_off import BackOff
from app.jobs.queue import Job
from app.jobs.worker_init import start_worker
from app.records.codec import Outcome

log = structlog.get_logger(__name__)

Compute = Callable[[Job, str, int], tuple[Outcome, float]]
Initialise = Callable[[int, bool], None]
"""What a process does before its first job, given the most pixels of an image and whether a thread ties it here."""
MAX_START_S = 900.0
"""How long a process may take until it is ready: where nothing was compiled, it compiles every kernel first."""
_CALM_FAILURES = 3
_HOPELESS_FAILURES = 3
"""Starts in a row. After fewer, one that is under way may still come to an end: it takes long where it compiles."""
_SILENCE_S = 5.0
"""How long a pool that has failed may take to report the end of its job."""


class WorkerLost(Exception):
    """The process ended while it had nothing to do."""


class OverTime(Exception):
    """A job took longer than it may."""


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """A job that a slot works on, and since when by the monotonic clock."""

    job: Job
    future: Future[tuple[Outcome, float]]
    since_s: float


class WorkerSlot:
    """One worker process; at most one job at a time. All but `submit` and `finish` belong to the runner's thread."""

    def __init__(
        self,
        compute: Compute,
        *,
        max_pixels: int,
        timeout_s: float,
        initialise: Initialise = start_worker,
    ) -> None:
        self.task: Task | None = None
        self.ready = False
        """Whether the process is alive and has done everything that comes before its first job."""
        self._compute = compute
        self._initialise = initialise
        self._max_pixels = max_pixels
        self._timeout_s = timeout_s
        self._pool: ProcessPool | None = None
        self._greeting: Future[int] | None = None
        self._spent = False
        self._started_s = 0.0
        self._silent_since_s: float | None = None
        self._starts = BackOff()
        self._jobs = BackOff(calm_failures=_CALM_FAILURES)

    @property
    def idle(self) -> bool:
        """Whether a job can be given to it."""
        return self.ready and self.task is None

    @property
    def hopeful(self) -> bool:
        """Whether it is ready, or at a start that few failed ones came before."""
        is_starting = self._greeting is not None and self._starts.failures < _HOPELESS_FAILURES
        return self.ready or is_starting or self._starts.failures == 0

    def tend(self) -> None:
        """Start a process where none is, note when it is ready, and replace one that died while idle."""
        if self.task is not None:
            return
        if self._spent:
            self._discard()
        if self._pool is None:
            if self._starts.due and self._jobs.due:
                self._start()
        elif self._greeting is not None:
            self._await_greeting(self._pool, self._greeting)
        elif not self._pool.active:
            log.warning("worker_lost_while_idle")
            self._discard()

    def submit(self, job: Job, address: str) -> Task:
        """Begin a job; the task's future is done when it is over, unless `verdict` says so first.

        Raises WorkerLost where the process ended while it had nothing to do; `tend` replaces it.
        """
        assert self._pool is not None
        try:
            future: Future[tuple[Outcome, float]] = self._pool.schedule(
                self._compute, args=(job, address, self._max_pixels)
            )
        except RuntimeError as error:
            log.warning("worker_lost_while_idle")
            self.ready, self._spent = False, True
            raise WorkerLost from error
        self._silent_since_s = None
        self.task = Task(job, future, time.monotonic())
        return self.task

    def verdict(self) -> Exception | None:
        """Return why the present job has to be given up: OverTime, or ProcessExpired where no end is reported."""
        if self.task is None or self.task.future.done():
            return None
        now_s = time.monotonic()
        if now_s - self.task.since_s > self._timeout_s:
            return OverTime()
        if self._pool is None or self._pool.active:
            self._silent_since_s = None
        elif self._silent_since_s is None:
            self._silent_since_s = now_s
        elif now_s - self._silent_since_s > _SILENCE_S:
            return ProcessExpired("The pool of the process failed.")  # type: ignore[no-untyped-call]
        return None

    def finish(self, *, alive: bool) -> None:
        """Note that the job is over, and whether the process survived it; `tend` replaces one that did not."""
        self.task = None
        if alive:
            self._jobs.succeeded()
        else:
            self.ready, self._spent = False, True
            self._jobs.failed()

    def close(self) -> None:
        """End the process, whatever it does."""
        pool, self._pool, self.ready = self._pool, None, False
        if pool is not None:
            _end(pool)

    def _discard(self) -> None:
        pool, self._pool, self._greeting = self._pool, None, None
        self.ready = self._spent = False
        if pool is not None:
            _run_in_background(lambda: _end(pool))

    def _start(self) -> None:
        pool = ProcessPool(
            max_workers=1,
            initializer=self._initialise,
            initargs=(self._max_pixels, True),
            context=multiprocessing.get_context("spawn"),
        )
        try:
            # This starts the pool and its process now, from the runner's own thread, which outlives both. The answer
            # comes when the process is initialised.
            self._greeting = pool.schedule(os.getpid)
        except Exception as error:  # noqa: BLE001 - no descriptors, processes, threads or memory: it passes
            self._starts.failed()
            log.warning("worker_not_started", failures=self._starts.failures, error=repr(error))
            _end(pool)
            return
        self._pool, self._started_s = pool, time.monotonic()

    def _await_greeting(self, pool: ProcessPool, greeting: Future[int]) -> None:
        error: BaseException | None
        if greeting.done():
            error = greeting.exception()
            if error is None:
                self.ready, self._greeting = True, None
                self._starts.succeeded()
                log.info("worker_ready", after_s=round(time.monotonic() - self._started_s, 1))
                return
        elif time.monotonic() - self._started_s > MAX_START_S:
            error = OverTime()
        elif not pool.active:
            error = WorkerLost()
        else:
            return
        self._starts.failed()
        log.warning("worker_not_started", failures=self._starts.failures, error=repr(error))
        self._discard()


def close_all(slots: Sequence[WorkerSlot]) -> None:
    """End the processes of all slots at the same time."""
    closers = []
    for slot in slots:
        closer = threading.Thread(target=slot.close, name="pool-end")
        try:
            closer.start()
        except RuntimeError:  # no thread can be had: one after the other
            slot.close()
        else:
            closers.append(closer)
    for closer in closers:
        closer.join()


def _end(pool: ProcessPool) -> None:
    try:
        pool.stop()  # type: ignore[no-untyped-call]
        pool.join()
    except Exception:
        log.exception("worker_not_ended")


def _run_in_background(work: Callable[[], None]) -> None:
    try:
        threading.Thread(target=work, name="pool-end", daemon=True).start()
    except RuntimeError:  # no thread can be had: the caller waits
        work()
