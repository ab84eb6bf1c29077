"""The queue on the measurement rows: a row whose status is `queued` is a job."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from datetime import UTC, datetime

import sqlalchemy as sa
from sqlalchemy import orm

from app.jobs.queue.claimed_rows import read_jobs, unreadable
from app.jobs.queue.interface import Job, JobResult
from app.jobs.queue.saving import (
    current_claim,
    earlier_results,
    give_up,
    keep_earlier,
    save_detected,
    save_result,
)
from app.jobs.queue.turns import next_in_turn
from app.records.codec import Failure
from app.records.database import Database
from app.records.ids import new_id
from app.records.tables import Measurement, Session


class SqlQueue:
    """`jobs.queue.Queue` on the measurement rows, for SQLite and PostgreSQL."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._news = threading.Event()
        # Where the round of sessions goes on. It is kept in memory alone: a restart, or a second runner, begins at the
        # first session, and every session still has its turn.
        self._last_served = ""

    def notify(self) -> None:
        self._news.set()

    def wait(self, timeout_s: float) -> None:
        self._news.wait(timeout_s)
        self._news.clear()

    def recover(self) -> int:
        with self._database.write() as session:
            result = session.execute(
                sa.update(Measurement)
                .where(Measurement.status == "running")
                .values(status="queued", claim=None)
                .returning(Measurement.id)
            )
            return len(result.all())

    def claim(self, limit: int) -> Sequence[Job]:
        with self._database.read() as session:
            # Looking costs no write lock; an idle runner does little else.
            if not session.scalar(sa.select(sa.exists().where(Measurement.status == "queued"))):
                return ()
        while True:
            jobs, unreadable_rows = self._claim(limit)
            if jobs or not unreadable_rows:
                return jobs

    def _claim(self, limit: int) -> tuple[Sequence[Job], int]:
        """Return jobs of the sessions in turn, and how many rows failed since they cannot be read."""
        claim = new_id("clm")
        with self._database.write() as session:
            turns = next_in_turn(session, self._last_served, limit)
            if not turns:
                return (), 0
            order = [measurement_id for _, measurement_id in turns]
            wanted = Measurement.id.in_(order)
            if not self._database.is_sqlite:
                # Another runner may be claiming the same; on SQLite this is the only writer, and asking for the status
                # again would make it read every queued row.
                wanted = Measurement.id.in_(
                    sa.select(Measurement.id)
                    .where(wanted, Measurement.status == "queued")
                    .with_for_update(skip_locked=True)
                )
            claimed = set(
                session.scalars(
                    sa.update(Measurement)
                    .where(wanted)
                    .values(status="running", claim=claim)
                    .returning(Measurement.id),
                    execution_options={"synchronize_session": False},
                )
            )
            jobs, damaged = read_jobs(session, [i for i in order if i in claimed], claim)
            for measurement_id, columns in damaged.items():
                give_up(session, measurement_id, unreadable(columns))
        self._last_served = turns[-1][0]
        return jobs, len(damaged)

    def finish(self, finished: Sequence[JobResult]) -> int:
        """Save results; one that was computed replaces the row's earlier one, none leaves it as it is."""
        saved = 0
        now = datetime.now(UTC)
        with self._database.write() as session:
            _lock_sessions(session, [item.job.measurement_id for item in finished])
            earlier = earlier_results(session, [item.job.measurement_id for item in finished])
            for item in finished:
                job, outcome = item.job, item.outcome
                if outcome.result is None and outcome.failure is not None and earlier.get(job.measurement_id):
                    saved += keep_earlier(session, job, outcome.failure)
                    continue
                save = save_result if job.has_explicit_target else save_detected
                saved += save(session, item, now, replaces=job.measurement_id in earlier)
        return saved

    def release(self, jobs: Sequence[Job]) -> None:
        if not jobs:
            return
        with self._database.write() as session:
            _lock_sessions(session, [job.measurement_id for job in jobs])
            for job in jobs:
                session.execute(current_claim(job).values(status="queued", claim=None))

    def attempt_failed(self, job: Job, failure: Failure, *, max_attempts: int) -> None:
        with self._database.write() as session:
            attempts = session.scalar(
                current_claim(job)
                .values(status="queued", claim=None, attempts=Measurement.attempts + 1)
                .returning(Measurement.attempts)
            )
            if attempts is not None and attempts >= max_attempts:
                give_up(session, job.measurement_id, failure)


def _lock_sessions(session: orm.Session, measurement_ids: Sequence[str]) -> None:
    """Let uploads to the sessions of these measurements, and deletions of them, wait until this is saved.

    Between asking which targets of an image have rows and adding the others, none may be added; and a deletion locks
    its session before its measurements. All at once, in one order and before any row, or two could wait in a ring.
    """
    if session.get_bind().dialect.name == "sqlite":
        return  # this is the only writer
    session.scalars(
        sa.select(Session.id)
        .where(
            Session.id.in_(
                sa.select(Measurement.session_id).where(Measurement.id.in_(measurement_ids)).distinct()
            )
        )
        .order_by(Session.id)
        .with_for_update(key_share=True)
    ).all()
