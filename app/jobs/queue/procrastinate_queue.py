"""The queue on PostgreSQL, for any number of workers on any number of machines: Procrastinate hands the jobs out.

A trigger of the database adds a job in the transaction in which a row becomes `queued` (migration 0017), with a
priority that gives sessions their turns. Procrastinate's worker runs here in an event loop of its own: the server
announces new jobs to it at once, it reports that it is alive, and it gives back the jobs of workers that do not. A job
of Procrastinate is a measurement's id and nothing else; the row holds everything else. It ends here when the row's job
was saved or given back, so that whatever is lost on the way is handed out again and, where the row needs nothing any
more, dropped.
"""

from __future__ import annotations

import asyncio
import logging
import threading
from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future, InvalidStateError
from contextlib import suppress
from dataclasses import dataclass

import procrastinate
import sqlalchemy as sa
from sqlalchemy import orm

from app.jobs.job import Job, JobResult
from app.jobs.queue.claimed_rows import read_jobs, unreadable
from app.jobs.queue.lost_jobs import SILENT_S, give_back_stalled, recover_rows
from app.jobs.queue.saving import give_up
from app.jobs.queue.sql_queue import SqlQueue
from app.logs import Logger
from app.records.database import Database
from app.records.ids import new_id
from app.records.outcome import Failure
from app.records.statements import rows_of
from app.records.tables import Measurement

log = Logger(__name__)

HEARTBEAT_S = 2.0
"""How often a worker reports that it is alive."""
_RESCUE_CRON = "* * * * * */5"  # every five seconds, which are the sixth field
_POLL_S = 2.0
"""How often a worker looks by itself: jobs that are given back announce themselves to nobody."""
MAX_RESCUES = 20
"""Workers that vanished with an image, each one a machine or a whole service, until it fails."""
_AHEAD = 2
"""Jobs a worker takes for each of its processes: the one that is computed, and the next."""
CONNECTIONS = 6
"""Connections of one process that fetches jobs: four for questions, two that listen."""
_STOP_S = 3.0
_RESTART_S = 1.0
_LOST = Failure(
    "worker_crashed",
    f"{MAX_RESCUES} workers vanished while they computed this image.",
    "Check the memory and the logs of the workers' machines. Then retry.",
)


class _GivenBack(Exception):
    """The worker ends: the job is to be handed to another."""


@dataclass(slots=True, eq=False)
class _Arrival:
    """A job that Procrastinate handed to this process; `ended` lets it go.

    `rescues`: how often a worker had it before and did not end it.
    """

    measurement_id: str
    rescues: int
    ended: Future[None]


class ProcrastinateQueue(SqlQueue):
    """`jobs.queue.Queue` on Procrastinate's tables and the measurement rows, for PostgreSQL.

    Without `start_fetching` a claim takes queued rows as they stand: for programs that run no worker.
    """

    def __init__(self, database: Database) -> None:
        super().__init__(database)
        self._arrived: deque[_Arrival] = deque()
        self._held: dict[str, list[_Arrival]] = {}
        """Arrivals by the claim's job, until that is saved or given back."""
        self._guard = threading.Lock()
        self._thread: threading.Thread | None = None
        self._ending = threading.Event()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._running: asyncio.Task[None] | None = None

    def recover(self) -> int:
        """Queue rows that no job is left for, as a program that used another queue leaves them; return how many."""
        return recover_rows(self._database)

    def start_fetching(self, processes: int) -> None:
        # Its loggers report every job; what matters is logged here.
        logging.getLogger("procrastinate").setLevel(logging.WARNING)
        self._ending.clear()
        self._thread = threading.Thread(
            target=self._run, args=(processes,), name="procrastinate", daemon=True
        )
        self._thread.start()

    def stop_fetching(self) -> None:
        thread, self._thread = self._thread, None
        if thread is None:
            return
        self._ending.set()
        for arrival in self._take_all():
            with suppress(InvalidStateError):
                arrival.ended.set_exception(_GivenBack())
        loop, running = self._loop, self._running
        if loop is not None and running is not None:
            with suppress(RuntimeError):  # the loop has ended by itself
                loop.call_soon_threadsafe(running.cancel)
        thread.join(4 * _STOP_S)

    def claim(self, limit: int) -> Sequence[Job]:
        if self._thread is None:
            return super().claim(limit)
        if not self._thread.is_alive():
            raise RuntimeError("the thread that fetches jobs has ended")
        with self._guard:
            arrivals = [self._arrived.popleft() for _ in range(min(limit, len(self._arrived)))]
        if not arrivals:
            return ()
        try:
            jobs = self._claim_arrived(arrivals)
        except BaseException:
            with self._guard:
                self._arrived.extendleft(reversed(arrivals))
            raise
        return jobs

    def finish(self, finished: Sequence[JobResult]) -> int:
        saved = super().finish(finished)
        self._end([item.job for item in finished])
        return saved

    def release(self, jobs: Sequence[Job]) -> None:
        super().release(jobs)
        self._end(jobs)

    def attempt_failed(self, job: Job, failure: Failure, *, max_attempts: int) -> None:
        super().attempt_failed(job, failure, max_attempts=max_attempts)
        self._end([job])

    def _claim_arrived(self, arrivals: Sequence[_Arrival]) -> Sequence[Job]:
        """Claim the rows of arrivals that are queued, or that a worker that is gone had claimed; end the others."""
        claim = new_id("clm")
        of_row: dict[str, list[_Arrival]] = {}
        for arrival in arrivals:
            of_row.setdefault(arrival.measurement_id, []).append(arrival)
        rescues = {i: max(a.rescues for a in same) for i, same in of_row.items()}
        with self._database.write() as session:
            claimed = _claim_rows(session, rescues, claim)
            hopeless = [i for i in claimed if rescues[i] > MAX_RESCUES]
            jobs, damaged = read_jobs(rows_of(session), [i for i in claimed if i not in hopeless], claim)
            for measurement_id, columns in damaged.items():
                give_up(session, measurement_id, unreadable(columns))
            for measurement_id in hopeless:
                give_up(session, measurement_id, _LOST)
        with self._guard:
            for job in jobs:
                self._held[job.claim + job.measurement_id] = of_row.pop(job.measurement_id)
        self._let_go([arrival for same in of_row.values() for arrival in same])
        return jobs

    def _end(self, jobs: Sequence[Job]) -> None:
        with self._guard:
            ended = [a for job in jobs for a in self._held.pop(job.claim + job.measurement_id, ())]
        self._let_go(ended)

    def _let_go(self, arrivals: Sequence[_Arrival]) -> None:
        for arrival in arrivals:
            with suppress(InvalidStateError):  # its worker was stopped meanwhile
                arrival.ended.set_result(None)

    def _take_all(self) -> list[_Arrival]:
        with self._guard:
            arrivals = [*self._arrived, *(a for same in self._held.values() for a in same)]
            self._arrived.clear()
            self._held.clear()
        return arrivals

    def _run(self, processes: int) -> None:
        """Run Procrastinate's worker until asked to end; it ends by itself whenever its database does."""
        while not self._ending.is_set():
            try:
                asyncio.run(self._work(processes))
            except Exception as error:  # noqa: BLE001 - no server, no connection: it passes
                log.warning("queue_lost", error=repr(error))
            self._loop = self._running = None
            self._ending.wait(_RESTART_S)

    async def _work(self, processes: int) -> None:
        self._loop = asyncio.get_running_loop()
        connector = procrastinate.PsycopgConnector(
            kwargs=self._database.driver_options(), min_size=1, max_size=CONNECTIONS - 2, timeout=10.0
        )
        app = procrastinate.App(connector=connector)
        self._add_tasks(app)
        async with app.open_async():
            self._running = asyncio.create_task(self._run_workers(app, processes))
            if self._ending.is_set():
                self._running.cancel()
            with suppress(asyncio.CancelledError):
                await self._running

    async def _run_workers(self, app: procrastinate.App, processes: int) -> None:
        """Run two workers, one of them for the upkeep alone: images that take long must not keep it waiting."""

        async def run(queue: str, concurrency: int) -> None:
            await app.run_worker_async(
                queues=[queue],
                concurrency=concurrency,
                install_signal_handlers=False,
                delete_jobs="always",
                fetch_job_polling_interval=_POLL_S,
                update_heartbeat_interval=HEARTBEAT_S,
                stalled_worker_timeout=4 * SILENT_S,
                shutdown_graceful_timeout=_STOP_S,
            )

        workers = [
            asyncio.create_task(run("images", _AHEAD * processes)),
            asyncio.create_task(run("upkeep", 1)),
        ]
        try:
            await asyncio.wait(workers, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for worker in workers:
                worker.cancel()
            for outcome in await asyncio.gather(*workers, return_exceptions=True):
                if isinstance(outcome, Exception):
                    log.warning("queue_worker_ended", error=repr(outcome))

    def _add_tasks(self, app: procrastinate.App) -> None:
        @app.task(
            name="measure",
            queue="images",
            pass_context=True,
            retry=procrastinate.RetryStrategy(max_attempts=None),
        )
        async def measure(context: procrastinate.JobContext, measurement_id: str) -> None:
            arrival = _Arrival(measurement_id, context.job.attempts, Future())
            with self._guard:
                self._arrived.append(arrival)
            self.notify()
            try:
                await asyncio.wrap_future(arrival.ended)
            except asyncio.CancelledError:
                with self._guard, suppress(ValueError):
                    self._arrived.remove(arrival)
                raise

        @app.periodic(cron=_RESCUE_CRON)
        @app.task(name="rescue", queue="upkeep", queueing_lock="rescue", pass_context=True)
        async def rescue(context: procrastinate.JobContext, timestamp: int) -> None:
            await give_back_stalled(app)
            if timestamp % 30 == 0:
                await asyncio.to_thread(self.recover)


def _claim_rows(session: orm.Session, rescues: dict[str, int], claim: str) -> list[str]:
    """Claim those rows that are queued, or that were handed to a worker that is gone; in their order."""
    again = [i for i, count in rescues.items() if count > 0]
    wanted = (
        sa.select(Measurement.id)
        .where(
            Measurement.id.in_(list(rescues)),
            sa.or_(
                Measurement.status == "queued",
                sa.and_(Measurement.status == "running", Measurement.id.in_(again)),
            ),
        )
        .order_by(Measurement.id)
        .with_for_update()
    )
    ids = session.scalars(wanted).all()
    session.execute(
        sa.update(Measurement).where(Measurement.id.in_(ids)).values(status="running", claim=claim),
        execution_options={"synchronize_session": False},
    )
    found = set(ids)
    return [i for i in rescues if i in found]
