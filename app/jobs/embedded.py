"""The embedded runner: one thread that hands queued rows to worker processes and saves what comes back.

One runner works on a data folder at a time (`runner.lock`; on PostgreSQL one on a database, by an advisory lock). Under
that lock, `running` rows can only be what a runner that is gone left behind, so they go back to `queued` at start.
"""

from __future__ import annotations

import signal
import threading
import time
from collections import deque
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeout
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass

import structlog
from pebble import ProcessExpired

from app.blobs.local import LocalBlobs
from app.errors import ServiceError
from app.jobs.lane import Compute, Lane
from app.jobs.process_image import process_image
from app.jobs.queue import Finished, Job, Queue
from app.jobs.runner_lock import RunnerLock
from app.jobs.worker_process import keep_compiled_code, prepare_environment
from app.records.codec import Failure, Outcome
from app.records.database import Database
from app.settings import Settings

log = structlog.get_logger(__name__)

IDLE_POLL_S = 0.5
"""How often an idle runner looks by itself; jobs of the same process wake it at once."""
BATCH = 4
"""Jobs taken at a time for each worker, so that the next one is at hand while results are being saved."""
GRACE_S = 5.0
"""How long running jobs may take to end by themselves when the runner stops."""

INTERNAL_ERROR = Failure(
    "internal_error",
    "The computation ended in an unexpected way.",
    "This is a defect of the service, noted in its log. Retry after an update.",
)


@dataclass(frozen=True, slots=True)
class _Ended:
    lane: Lane
    job: Job
    future: Future[tuple[Outcome, float]]


class EmbeddedRunner:
    """Runs jobs in `workers` processes until stopped."""

    def __init__(
        self,
        queue: Queue,
        blobs: LocalBlobs,
        lock: RunnerLock,
        *,
        workers: int,
        timeout_s: float,
        max_pixels: int,
        compute: Compute = process_image,
    ) -> None:
        self._queue = queue
        self._blobs = blobs
        self._lock = lock
        self._workers = workers
        self._timeout_s = timeout_s
        self._max_pixels = max_pixels
        self._compute = compute
        self._ready: deque[Job] = deque()
        self._ended: deque[_Ended] = deque()
        self._lanes: list[Lane] = []
        self._hand_out = threading.RLock()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="runner", daemon=True)
        self.finished = 0
        self.crashes = 0
        self.timeouts = 0

    @classmethod
    def for_data_dir(
        cls, settings: Settings, database: Database, queue: Queue, blobs: LocalBlobs
    ) -> EmbeddedRunner:
        """Return the runner that `settings` describe; at least one worker."""
        keep_compiled_code(settings.data_dir)
        return cls(
            queue,
            blobs,
            RunnerLock(settings.data_dir, database),
            workers=max(1, settings.worker_count),
            timeout_s=settings.job_timeout_s,
            max_pixels=settings.max_image_pixels,
        )

    def start(self) -> None:
        """Take the lock, give back what an earlier runner left, and begin; AlreadyLocked if another one runs."""
        self._lock.acquire()
        recovered = self._queue.recover()
        if recovered:
            log.info("jobs_recovered", jobs=recovered)
        prepare_environment(self._max_pixels)
        self._thread.start()

    @property
    def alive(self) -> bool:
        """Whether jobs are being run."""
        return self._thread.is_alive() and not self._stopping.is_set()

    def begin_stop(self) -> None:
        """Take no more jobs; what dies from now on does not count as an attempt."""
        self._stopping.set()
        self._queue.notify()

    def stop(self) -> None:
        """End: running jobs get `GRACE_S` seconds, then go back to the queue with no attempt counted."""
        self.begin_stop()
        if self._thread.is_alive():
            self._thread.join()
        self._lock.release()

    def _run(self) -> None:
        try:
            self._lanes = [
                Lane(self._compute, max_pixels=self._max_pixels, timeout_s=self._timeout_s)
                for _ in range(self._workers)
            ]
            while not self._stopping.is_set():
                self._work_once()
            self._wind_down()
        finally:
            closers = [threading.Thread(target=lane.close, name="pool-end") for lane in self._lanes]
            for closer in closers:
                closer.start()
            for closer in closers:
                closer.join()

    def _work_once(self) -> None:
        """Save what ended, fetch what is queued, hand out; then wait for either kind of news."""
        try:
            settled = self._settle()
            fetched = self._fetch()
        except ServiceError as error:
            # A full disk or a busy database passes; the jobs keep, and so do the results not yet saved.
            log.warning("runner_waits", code=error.code)
            self._stopping.wait(1.0)
            return
        started = self._start_jobs()
        if not (settled or fetched or started or self._ended):
            self._queue.wait(IDLE_POLL_S)

    def _fetch(self) -> bool:
        if len(self._ready) > self._workers:
            return False
        jobs = self._queue.claim(BATCH * self._workers)
        self._ready.extend(jobs)
        return bool(jobs)

    def _start_jobs(self) -> bool:
        started = False
        for lane in self._lanes:
            with self._hand_out:
                if lane.broken:
                    log.warning("worker_lost_while_idle")
                    lane.replace()
                if lane.idle and self._ready:
                    self._submit(lane, self._ready.popleft())
                    started = True
        return started

    def _submit(self, lane: Lane, job: Job) -> None:
        try:
            future = lane.submit(job, self._blobs.path(job.sha256))
        except RuntimeError:
            # The process was ended while idle: no fault of this job. The runner's thread replaces the lane.
            self._ready.appendleft(job)
            return
        future.add_done_callback(lambda done: self._on_end(_Ended(lane, job, done)))

    def _on_end(self, ended: _Ended) -> None:
        """Note the end and keep the worker busy; runs in the pool's own thread, before anything is saved."""
        with self._hand_out:
            self._ended.append(ended)
            if not ended.future.cancelled() and ended.future.exception() is None:
                ended.lane.succeeded()
                if self._ready and not self._stopping.is_set():
                    self._submit(ended.lane, self._ready.popleft())
        self._queue.notify()

    def _settle(self) -> bool:
        """Save all that ended; on a database error nothing is forgotten."""
        batch = list(self._ended)
        finished = []
        for ended in batch:
            outcome = self._outcome(ended)
            if outcome is not None:
                finished.append(outcome)
        if finished:
            self._queue.finish(finished)
            self.finished += len(finished)
        for ended in batch:
            if isinstance(ended.future.exception(), (ProcessExpired, BrokenProcessPool)):
                self._settle_crash(ended)
        for ended in batch:
            self._ended.popleft()
            if ended.future.exception() is not None:
                self._after_failure(ended)
        return bool(batch)

    def _outcome(self, ended: _Ended) -> Finished | None:
        """Return what to save, or None where the process died."""
        error = ended.future.exception()
        if error is None:
            outcome, duration_ms = ended.future.result()
            return Finished(ended.job, outcome, duration_ms)
        if isinstance(error, (ProcessExpired, BrokenProcessPool)):
            return None
        if isinstance(error, FutureTimeout):
            failure = Failure(
                "processing_timeout",
                f"The computation took longer than {self._timeout_s:g} s and was ended.",
                "Retry when the server is less busy, send a smaller image, or raise GRIDPOSE_JOB_TIMEOUT_S.",
            )
            return Finished(ended.job, Outcome(None, failure), self._timeout_s * 1000.0)
        if isinstance(error, FileNotFoundError):
            failure = Failure(
                "original_missing",
                "The stored image is gone from the server's disk.",
                "Upload the image again, which puts it back, then retry.",
            )
            return Finished(ended.job, Outcome(None, failure), 0.0)
        log.error("job_failed_unexpectedly", measurement_id=ended.job.measurement_id, exc_info=error)
        return Finished(ended.job, Outcome(None, INTERNAL_ERROR), 0.0)

    def _settle_crash(self, ended: _Ended) -> None:
        error = ended.future.exception()
        told_to_end = getattr(error, "exitcode", None) in (signal.SIGTERM, -signal.SIGTERM)
        # Whoever stops the whole service may tell its processes first and us an instant later.
        if self._stopping.wait(0.5 if told_to_end else 0.0):
            self._queue.give_back([ended.job])
            return
        log.warning(
            "worker_crashed",
            measurement_id=ended.job.measurement_id,
            exit_code=getattr(error, "exitcode", None),
        )
        self._queue.crashed(ended.job)
        self.crashes += 1

    def _after_failure(self, ended: _Ended) -> None:
        error = ended.future.exception()
        with self._hand_out:
            if not isinstance(error, (ProcessExpired, BrokenProcessPool, FutureTimeout)):
                ended.lane.succeeded()
            elif self._stopping.is_set():
                ended.lane.job = None
            else:
                self.timeouts += isinstance(error, FutureTimeout)
                ended.lane.replace()

    def _wind_down(self) -> None:
        """Let running jobs end for a while, save them, and give back the rest."""
        with self._hand_out:
            unstarted = list(self._ready)
            self._ready.clear()
        deadline = time.monotonic() + GRACE_S
        try:
            while any(lane.job for lane in self._lanes) and time.monotonic() < deadline:
                if not self._ended:
                    self._queue.wait(0.1)
                self._settle()
            self._settle()
            self._queue.give_back([*unstarted, *(lane.job for lane in self._lanes if lane.job)])
        except ServiceError as error:
            # The rows stay `running`; the next start gives them back.
            log.warning("runner_stopped_without_saving", code=error.code)
