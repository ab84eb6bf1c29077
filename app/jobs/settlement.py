"""What came of jobs, until it is saved: nothing is forgotten on an error, and no job keeps another from being saved.

A job that failed by no fault of its image, as far as anyone can know, is repeated, and each attempt counts: three for
a worker that died or for a result that cannot be saved, two for a time limit, which may have passed while the machine
was suspended or overloaded.
"""

from __future__ import annotations

import signal
import threading
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

from app.errors import ServiceError, Unavailable
from app.jobs.pace import BackOff
from app.jobs.queue import Job, JobResult, Queue
from app.jobs.worker_pool import OverTime
from app.jobs.worker_process import ProcessExpired
from app.logs import Logger
from app.records.outcome import Failure, Outcome

log = Logger(__name__)

MAX_ATTEMPTS = 3
MAX_OVERTIMES = 2
MAX_SAVES = 10
"""Attempts at saving a result, over half a minute, until its job is repeated."""
STORAGE_PAUSE_S = 3.0
"""After it was found that originals cannot be read just now; the image then waits for its turn again."""
MAX_SAVES_AMONG_OTHERS = 3
"""The same where other results can be saved meanwhile."""

WORKER_CRASHED = Failure(
    "worker_crashed",
    f"The process computing this image died {MAX_ATTEMPTS} times.",
    "Check the server's memory and log; the image may be larger than the server can hold. Then retry.",
)
INTERNAL_ERROR = Failure(
    "internal_error",
    "The computation ended in an unexpected way.",
    "This is a defect of the service, noted in its log. Retry after an update.",
)
ORIGINAL_MISSING = Failure(
    "original_missing",
    "The stored image is gone from the server's disk.",
    "Upload the image again, which puts it back, then retry.",
)


def is_death(error: BaseException | None) -> bool:
    """Return whether the worker process did not survive this end of a job, or should not."""
    return isinstance(error, (ProcessExpired, OverTime, MemoryError))


@dataclass(slots=True, eq=False)
class _Ended:
    """A job that is over: what to save, or, where it is to be repeated, what it fails with after the last attempt."""

    job: Job
    finished: JobResult | None
    failure: Failure
    attempts: int
    exit_code: int | None = None
    saves: BackOff = field(default_factory=BackOff)
    is_released: bool = False
    """Whether the job goes back to the queue as it was: what failed had nothing to do with it."""
    since_s: float = field(default_factory=time.monotonic)
    saved_before: int | None = None
    """How many results had been saved at all when this one could not be for the first time."""


class Settlement:
    """Saves what came of jobs."""

    def __init__(self, queue: Queue, *, timeout_s: float, stopping: threading.Event) -> None:
        self._queue = queue
        self._timeout_s = timeout_s
        self._stopping = stopping
        self._ended: deque[_Ended] = deque()
        self.failing = False
        """Whether nothing can be saved, for an unexpected reason."""
        self.finished = 0
        self.crashes = 0
        self.timeouts = 0

    def __len__(self) -> int:
        return len(self._ended)

    def add(
        self, job: Job, returned: tuple[Outcome, float] | None, error: BaseException | None = None
    ) -> None:
        """Note what a job returned or raised; from any thread."""
        self._ended.append(self._judged(job, returned, error))

    def settle(self, *, gather_s: float = 0.0) -> bool:
        """Save what is due and return whether anything was; raise ServiceError where the database cannot now.

        With `gather_s`, nothing is saved until the oldest result has waited so long, that one transaction may save
        several. Any other error counts against the result that it concerns, which is saved again after a pause.
        """
        due = [ended for ended in tuple(self._ended) if ended.saves.due]
        if not due or time.monotonic() - min(ended.since_s for ended in due) < gather_s:
            return False
        together = [ended for ended in due if ended.finished is not None and not ended.saves.failures]
        if len(together) > 1 and self._try_saving(together):
            due = [ended for ended in due if ended not in together]
            saved = len(together)
        else:
            saved = 0
        for ended in due:
            saved += self._try_saving([ended])
        self.failing = saved == 0
        return saved > 0

    def _try_saving(self, batch: Sequence[_Ended]) -> bool:
        try:
            if batch[0].finished is None or self._hopeless(batch[0]):
                self._repeat(batch[0])
            else:
                self._queue.finish([ended.finished for ended in batch if ended.finished is not None])
                self.finished += len(batch)
        except ServiceError:
            raise
        except Exception:
            log.exception("results_not_saved", measurement_ids=[ended.job.measurement_id for ended in batch])
            if len(batch) == 1:
                if batch[0].saved_before is None:
                    batch[0].saved_before = self.finished
                batch[0].saves.failed()
            return False
        for ended in batch:
            self._ended.remove(ended)
        return True

    def _hopeless(self, ended: _Ended) -> bool:
        others_were_saved = ended.saved_before is not None and self.finished > ended.saved_before
        return ended.saves.failures >= (MAX_SAVES_AMONG_OTHERS if others_were_saved else MAX_SAVES)

    def _repeat(self, ended: _Ended) -> None:
        was_terminated = ended.exit_code in (signal.SIGTERM, -signal.SIGTERM)
        # Whoever stops the whole service may signal its worker processes an instant before this one.
        if self._stopping.wait(0.5 if was_terminated else 0.0) or ended.is_released:
            self._queue.release([ended.job])
            return
        self._queue.attempt_failed(ended.job, ended.failure, max_attempts=ended.attempts)
        log.warning(
            "attempt_failed",
            measurement_id=ended.job.measurement_id,
            code=ended.failure.code,
            exit_code=ended.exit_code,
        )
        self.crashes += ended.failure is WORKER_CRASHED
        self.timeouts += ended.failure.code == "processing_timeout"

    def _judged(
        self, job: Job, returned: tuple[Outcome, float] | None, error: BaseException | None
    ) -> _Ended:
        if returned is not None:
            return _Ended(job, JobResult(job, *returned), INTERNAL_ERROR, MAX_ATTEMPTS)
        if isinstance(error, OverTime):
            return _Ended(job, None, self._timed_out(), MAX_OVERTIMES)
        if isinstance(error, Unavailable):  # of the store of originals: worker processes use no database
            log.warning("original_not_read", measurement_id=job.measurement_id, code=error.code)
            ended = _Ended(job, None, INTERNAL_ERROR, MAX_ATTEMPTS, is_released=True)
            ended.saves.pause(STORAGE_PAUSE_S)
            return ended
        if is_death(error):
            exit_code = getattr(error, "exitcode", None)
            return _Ended(job, None, WORKER_CRASHED, MAX_ATTEMPTS, exit_code)
        if isinstance(error, FileNotFoundError):
            return _Ended(
                job, JobResult(job, Outcome(None, ORIGINAL_MISSING), 0.0), INTERNAL_ERROR, MAX_ATTEMPTS
            )
        log.error("job_failed_unexpectedly", measurement_id=job.measurement_id, exc_info=error)
        if isinstance(error, OSError):  # no descriptors, a disk that does not answer: it may pass
            return _Ended(job, None, INTERNAL_ERROR, MAX_ATTEMPTS)
        return _Ended(job, JobResult(job, Outcome(None, INTERNAL_ERROR), 0.0), INTERNAL_ERROR, MAX_ATTEMPTS)

    def _timed_out(self) -> Failure:
        return Failure(
            "processing_timeout",
            f"The computation took longer than {self._timeout_s:g} s and was ended, {MAX_OVERTIMES} times.",
            "Retry when the server is less busy, send a smaller image, or raise GRIDPOSE_JOB_TIMEOUT_S.",
        )
