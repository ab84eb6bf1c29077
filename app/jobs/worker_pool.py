"""A slot for one worker process with a pipe of its own: a job's crash or time-out affects no other worker.

A shared pool would tie its workers together by the pipe and the lock they take turns at; with a pipe for each it is
always certain whose job a process died of, and a replacement starts from a clean slate.

Time limits are watched here by the monotonic clock: the wall clock steps.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass

from app.jobs.job import Job
from app.jobs.pace import BackOff
from app.jobs.worker_init import start_worker
from app.jobs.worker_process import WorkerProcess
from app.logs import Logger
from app.records.outcome import Outcome

log = Logger(__name__)

Compute = Callable[[Job, str, int], tuple[Outcome, float]]
Initialise = Callable[[int, bool], None]
"""What a process does before its first job, given the most pixels of an image and whether a thread ties it here."""
MAX_START_S = 900.0
"""How long a process may take until it is ready: where nothing was compiled, it compiles every kernel first."""
_CALM_FAILURES = 3
_HOPELESS_FAILURES = 3
"""Starts in a row. After fewer, one that is under way may still come to an end: it takes long where it compiles."""


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
        self._process: WorkerProcess | None = None
        self._starting = False
        self._spent = False
        self._started_s = 0.0
        self._starts = BackOff()
        self._jobs = BackOff(calm_failures=_CALM_FAILURES)

    @property
    def idle(self) -> bool:
        """Whether a job can be given to it."""
        return self.ready and self.task is None

    @property
    def hopeful(self) -> bool:
        """Whether it is ready, or at a start that few failed ones came before."""
        is_starting = self._starting and self._starts.failures < _HOPELESS_FAILURES
        return self.ready or is_starting or self._starts.failures == 0

    def tend(self) -> None:
        """Start a process where none is, note when it is ready, and replace one that died while idle."""
        if self.task is not None:
            return
        if self._spent:
            self._discard()
        if self._process is None:
            if self._starts.due and self._jobs.due:
                self._start()
        elif self._starting:
            self._await_greeting(self._process)
        elif not self._process.active:
            log.warning("worker_lost_while_idle")
            self._discard()

    def submit(self, job: Job, address: str) -> Task:
        """Begin a job; the task's future is done when it is over, unless `verdict` says so first.

        Raises WorkerLost where the process ended while it had nothing to do; `tend` replaces it.
        """
        assert self._process is not None
        try:
            future: Future[tuple[Outcome, float]] = self._process.schedule(
                self._compute, job, address, self._max_pixels
            )
        except OSError as error:
            log.warning("worker_lost_while_idle")
            self.ready, self._spent = False, True
            raise WorkerLost from error
        self.task = Task(job, future, time.monotonic())
        return self.task

    def verdict(self) -> Exception | None:
        """Return why the present job has to be given up: OverTime, else None."""
        if self.task is None or self.task.future.done():
            return None
        return OverTime() if time.monotonic() - self.task.since_s > self._timeout_s else None

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
        process, self._process, self.ready = self._process, None, False
        if process is not None:
            process.end()

    def _discard(self) -> None:
        process, self._process = self._process, None
        self.ready = self._spent = self._starting = False
        if process is not None:
            _run_in_background(process.end)

    def _start(self) -> None:
        try:
            self._process = WorkerProcess(self._initialise, (self._max_pixels, True))
        except Exception as error:  # noqa: BLE001 - no descriptors, processes, threads or memory: it passes
            self._starts.failed()
            log.warning("worker_not_started", failures=self._starts.failures, error=repr(error))
            return
        self._starting, self._started_s = True, time.monotonic()

    def _await_greeting(self, process: WorkerProcess) -> None:
        error: BaseException | None
        if process.greeting.done():
            error = process.greeting.exception()
            if error is None:
                self.ready, self._starting = True, False
                self._starts.succeeded()
                log.info("worker_ready", after_s=round(time.monotonic() - self._started_s, 1))
                return
        elif time.monotonic() - self._started_s > MAX_START_S:
            error = OverTime()
        else:
            return
        self._starts.failed()
        log.warning("worker_not_started", failures=self._starts.failures, error=repr(error))
        self._discard()


def close_all(slots: Sequence[WorkerSlot]) -> None:
    """End the processes of all slots at the same time."""
    closers = []
    for slot in slots:
        closer = threading.Thread(target=slot.close, name="worker-end")
        try:
            closer.start()
        except RuntimeError:  # no thread can be had: one after the other
            slot.close()
        else:
            closers.append(closer)
    for closer in closers:
        closer.join()


def _run_in_background(work: Callable[[], None]) -> None:
    try:
        threading.Thread(target=work, name="worker-end", daemon=True).start()
    except RuntimeError:  # no thread can be had: the caller waits
        work()
