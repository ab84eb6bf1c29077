"""The runner: one thread that hands queued rows to worker processes and saves their results.

One runner works on a data folder at a time (`runner.lock`). With SQLite, `running` rows can then only be what a runner
that is gone left behind, so they go back to `queued` at start; on PostgreSQL any number of runners share a database,
and the queue gives back what one that is gone was handed.

The thread goes through rounds, none soon after another (`pace`): look after the processes, save, fetch, hand out. An
error of one step is logged and the step tried again after a pause; it ends neither the round nor the runner. A full
disk or an unreachable database passes without anybody's help. Where nothing can be computed for another reason, no
process can be started or the database gives errors that nobody foresaw, the runner gives up after `MAX_UNABLE_S`: its
process should end, and be started anew.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from app.blobs.interface import Blobs
from app.errors import ServiceError
from app.jobs.pace import GATHER_S, IDLE_POLL_S, BackOff, Pace
from app.jobs.process_image import process_for_storage
from app.jobs.queue import Job, Queue
from app.jobs.settlement import Settlement, is_death
from app.jobs.worker_init import keep_compiled_code, prepare_environment, start_worker
from app.jobs.worker_pool import Compute, Initialise, Task, WorkerLost, WorkerSlot, close_all
from app.logs import Logger, Sparingly
from app.records.database import Database
from app.records.presence import RunnerLock
from app.settings import Settings

log = Logger(__name__)

BATCH = 4
"""Jobs taken at a time for each worker, so that the next one is at hand while results are being saved."""
MAX_UNSAVED = 16
"""Results for each worker that may wait to be saved until no more jobs are taken."""
GRACE_S = 5.0
"""How long running jobs may take to end by themselves when the runner stops."""
MAX_UNABLE_S = 40.0
"""How long nothing can be computed until the runner gives up; its process then has ended within 60 s."""
MAX_ROUND_S = 60.0
"""How long a round may take until the runner counts as unable: the database has not answered for so long."""


@dataclass(frozen=True, slots=True)
class RunnerState:
    """What a runner can do at present. `ready`: workers that would compute a job at once."""

    running: bool
    able: bool
    workers: int
    ready: int


class JobRunner:
    """Runs jobs in `workers` processes until stopped."""

    def __init__(
        self,
        queue: Queue,
        blobs: Blobs,
        lock: RunnerLock,
        *,
        workers: int,
        timeout_s: float,
        max_pixels: int,
        compute: Compute = process_for_storage,
        initialise: Initialise = start_worker,
        max_unable_s: float = MAX_UNABLE_S,
        max_round_s: float = MAX_ROUND_S,
    ) -> None:
        self._queue = queue
        self._blobs = blobs
        self._lock = lock
        self._max_pixels = max_pixels
        self._max_unable_s = max_unable_s
        self._max_round_s = max_round_s
        self._ready: deque[Job] = deque()
        self._slots = [
            WorkerSlot(compute, max_pixels=max_pixels, timeout_s=timeout_s, initialise=initialise)
            for _ in range(workers)
        ]
        self._hand_out = threading.RLock()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="runner", daemon=True)
        self._fetching = BackOff()
        self._pace = Pace()
        self._has_more = False
        self._may_repeat = Sparingly()
        self._unable_since_s: float | None = None
        self._round_since_s = time.monotonic()
        self.settlement = Settlement(queue, timeout_s=timeout_s, stopping=self._stopping)

    @classmethod
    def for_data_dir(cls, settings: Settings, database: Database, queue: Queue, blobs: Blobs) -> JobRunner:
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
        self._queue.start_fetching(len(self._slots))
        self._round_since_s = time.monotonic()
        self._thread.start()

    @property
    def alive(self) -> bool:
        """Whether the runner goes through its rounds."""
        return self._thread.is_alive() and not self._stopping.is_set()

    @property
    def state(self) -> RunnerState:
        """What the runner can do at present."""
        ready = sum(slot.ready for slot in self._slots) if self.alive else 0
        in_time = time.monotonic() - self._round_since_s <= self._max_round_s
        able = self.alive and in_time and self._unable_since_s is None
        return RunnerState(running=self.alive, able=able, workers=len(self._slots), ready=ready)

    @property
    def given_up(self) -> bool:
        """Whether nothing could be computed for so long that only a new process may help."""
        if self._stopping.is_set() or self._thread.ident is None:
            return False
        since_s = self._unable_since_s
        return not self._thread.is_alive() or (
            since_s is not None and time.monotonic() - since_s > self._max_unable_s
        )

    def begin_stop(self) -> None:
        """Take no more jobs; what dies from now on does not count as an attempt."""
        self._stopping.set()
        self._pace.hurry()
        self._queue.notify()

    def stop(self) -> None:
        """End: running jobs get `GRACE_S` seconds, then go back to the queue with no attempt counted."""
        self.begin_stop()
        if self._thread.is_alive():
            self._thread.join()
        self._queue.stop_fetching()
        self._lock.release()

    def _run(self) -> None:
        try:
            while not self._stopping.is_set():
                self._work_once()
                if not self._is_hungry():
                    self._pace.rest()
            self._wind_down()
        finally:
            close_all(self._slots)

    def _work_once(self) -> None:
        """Go through one round; wait where it brought nothing."""
        self._round_since_s = time.monotonic()
        self._attempt(self._keep_lock)
        tended = self._attempt(self._tend)
        settled = self._attempt(self._settle)
        fetched = self._attempt(self._fetch)
        started = self._attempt(self._start_jobs)
        self._note_ability(failed=None in (tended, fetched, started))
        if not (settled or fetched or started):
            unsaved = len(self.settlement) > 0
            self._queue.wait(1.0 if tended is None else GATHER_S if unsaved else IDLE_POLL_S)

    def _attempt(self, step: Callable[[], bool]) -> bool | None:
        """Return whether a step brought anything; None where it failed for a reason that nobody foresaw."""
        try:
            return step()
        except ServiceError as error:
            # A full disk or a busy database passes; the jobs keep, and so do the results not yet saved.
            if self._may_repeat.due(error.code):
                log.warning("runner_waits", code=error.code)
            self._stopping.wait(1.0)
            return False
        except Exception:
            log.exception("runner_step_failed", step=step.__name__)
            return None

    def _tend(self) -> bool:
        """Look after the processes; give up jobs that are over their time."""
        for slot in self._slots:
            with self._hand_out:
                verdict = slot.verdict()
                if slot.task is not None and verdict is not None:
                    self._end(slot, slot.task, verdict)
                slot.tend()
        return False

    def _settle(self) -> bool:
        """Save results: of busy workers together, the last ones at once."""
        busy = any(slot.task for slot in self._slots)
        settled = self.settlement.settle(gather_s=self._pace.gather_s(busy=busy))
        if settled:
            self._pace.saved()
        return settled

    def _keep_lock(self) -> bool:
        self._lock.keep()
        return False

    def _fetch(self) -> bool:
        limit = BATCH * len(self._slots)
        crowded = len(self.settlement) > MAX_UNSAVED * len(self._slots)
        if crowded or len(self._ready) > len(self._slots) or not self._fetching.due:
            return False
        try:
            jobs = self._queue.claim(limit)
        except ServiceError:
            raise
        except Exception:
            self._fetching.failed()
            raise
        self._fetching.succeeded()
        self._ready.extend(jobs)
        self._has_more = len(jobs) == limit
        return bool(jobs)

    def _is_hungry(self) -> bool:
        """Whether the workers run out of jobs while more are queued."""
        return self._has_more and len(self._ready) <= len(self._slots)

    def _start_jobs(self) -> bool:
        started = False
        for slot in self._slots:
            with self._hand_out:
                started |= self._hand_next(slot)
        return started

    def _hand_next(self, slot: WorkerSlot) -> bool:
        """Hand the next job to a slot that is idle; needs `_hand_out`."""
        if not self._ready or not slot.idle or self._stopping.is_set():
            return False
        job = self._ready.popleft()
        try:
            task = slot.submit(job, self._blobs.address(job.sha256))
        except WorkerLost:  # no fault of this job; the slot's process is replaced
            self._ready.appendleft(job)
            return False
        except Exception as error:  # noqa: BLE001 - it is logged and saved as this job's end
            self.settlement.add(job, None, error)
            return False
        task.future.add_done_callback(lambda _: self._on_end(slot, task))
        return True

    def _on_end(self, slot: WorkerSlot, task: Task) -> None:
        """Note the end and keep the worker busy; runs in the thread that had the answer, before anything is saved."""
        with self._hand_out:
            self._end(slot, task, task.future.exception())
            self._hand_next(slot)
        if self._is_hungry():
            self._pace.hurry()
        self._queue.notify()

    def _end(self, slot: WorkerSlot, task: Task, error: BaseException | None) -> None:
        if slot.task is task:  # else it was given up before
            slot.finish(alive=not is_death(error))
            self.settlement.add(task.job, None if error else task.future.result(), error)

    def _note_ability(self, *, failed: bool) -> None:
        able = not (failed or self._fetching.failures or self.settlement.failing)
        if able and any(slot.hopeful for slot in self._slots):
            self._unable_since_s = None
        elif self._unable_since_s is None:
            self._unable_since_s = time.monotonic()

    def _wind_down(self) -> None:
        """Let running jobs end for a while, save them, and give back the rest."""
        with self._hand_out:
            unstarted = list(self._ready)
            self._ready.clear()
        deadline = time.monotonic() + GRACE_S
        try:
            while any(slot.task for slot in self._slots) and time.monotonic() < deadline:
                if not self.settlement.settle():
                    self._queue.wait(0.1)
            self.settlement.settle()
            running = [slot.task.job for slot in self._slots if slot.task]
            self._queue.release([*unstarted, *running])
        except Exception as error:  # noqa: BLE001 - the end must come
            # The rows stay `running`; the next start gives them back.
            log.warning("runner_stopped_without_saving", error=repr(error))
