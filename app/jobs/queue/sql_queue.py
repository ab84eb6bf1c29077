"""The queue on the measurement rows: a row whose status is `queued` is a job."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from datetime import UTC, datetime

import sqlalchemy as sa

from app.jobs.job import Job, JobResult
from app.jobs.queue.claimed_rows import read_jobs, unreadable
from app.jobs.queue.saving import (
    current_claim,
    earlier_results,
    give_up,
    keep_earlier,
    save_detected,
    save_result,
)
from app.jobs.queue.turns import next_in_turn
from app.records.database import Database
from app.records.ids import new_id
from app.records.outcome import Failure
from app.records.statements import EngineRows, Statement, rows_of
from app.records.tables import Measurement, Session

_ANY = Statement(sa.select(Measurement.id).where(Measurement.status == "queued").limit(1))
_CLAIM = Statement(
    sa.update(Measurement)
    .where(
        # Another runner may be claiming the same row; on SQLite this is the only writer.
        Measurement.id
        == sa.select(Measurement.id)
        .where(Measurement.id == sa.bindparam("measurement_id"), Measurement.status == "queued")
        .with_for_update(skip_locked=True)
        .scalar_subquery()
    )
    .values(status="running", claim=sa.bindparam("new_claim"))
    .returning(Measurement.id)
)


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

    def start_fetching(self, processes: int) -> None:
        """Do nothing: rows are claimed one at a time."""

    def stop_fetching(self) -> None:
        """Do nothing: what is claimed is released by the runner."""

    def claim(self, limit: int) -> Sequence[Job]:
        with self._database.read_rows() as rows:
            # Looking costs no write lock; an idle runner does little else.
            if rows.first(_ANY) is None:
                return ()
        while True:
            jobs, unreadable_rows = self._claim(limit)
            if jobs or not unreadable_rows:
                return jobs

    def _claim(self, limit: int) -> tuple[Sequence[Job], int]:
        """Return jobs of the sessions in turn, and how many rows failed since they cannot be read."""
        claim = new_id("clm")
        # A power cut may undo the claim; so does the next start, which queues what was running.
        with self._database.write_rows(durable=False) as rows:
            turns = next_in_turn(rows, self._last_served, limit)
            claimed = [
                measurement_id
                for _, measurement_id in turns
                if rows.first(_CLAIM, measurement_id=measurement_id, new_claim=claim) is not None
            ]
            jobs, damaged = read_jobs(rows, claimed, claim)
        if damaged:
            with self._database.write() as session:
                for measurement_id, columns in damaged.items():
                    give_up(session, measurement_id, unreadable(columns))
        if turns:
            self._last_served = turns[-1][0]
        return jobs, len(damaged)

    def finish(self, finished: Sequence[JobResult]) -> int:
        """Save results; one that was computed replaces the row's earlier one, none leaves it as it is."""
        now = datetime.now(UTC)
        named = [item for item in finished if item.job.has_explicit_target]
        searched = [item for item in finished if not item.job.has_explicit_target]
        saved = 0
        if named:
            with self._database.write_rows() as rows:
                if isinstance(rows, EngineRows):
                    _lock_sessions(rows.connection, _rows_of(named))
                saved += sum(save_result(rows, item, now) for item in named)
        if searched:
            with self._database.write() as session:
                _lock_sessions(session.connection(), _rows_of(searched))
                earlier = earlier_results(session, _rows_of(searched))
                for item in searched:
                    job, outcome = item.job, item.outcome
                    if outcome.result is None and outcome.failure and earlier.get(job.measurement_id):
                        saved += keep_earlier(rows_of(session), job, outcome.failure)
                        continue
                    saved += save_detected(session, item, now, replaces=job.measurement_id in earlier)
        return saved

    def release(self, jobs: Sequence[Job]) -> None:
        if not jobs:
            return
        with self._database.write() as session:
            _lock_sessions(session.connection(), [job.measurement_id for job in jobs])
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


def _rows_of(finished: Sequence[JobResult]) -> list[str]:
    return [item.job.measurement_id for item in finished]


def _lock_sessions(connection: sa.Connection, measurement_ids: Sequence[str]) -> None:
    """Let uploads to the sessions of these measurements, and deletions of them, wait until this is saved.

    Between asking which targets of an image have rows and adding the others, none may be added; and a deletion locks
    its session before its measurements. All at once, in one order and before any row, or two could wait in a ring.
    """
    if connection.dialect.name == "sqlite":
        return  # this is the only writer
    connection.execute(
        sa.select(Session.id)
        .where(
            Session.id.in_(
                sa.select(Measurement.session_id).where(Measurement.id.in_(measurement_ids)).distinct()
            )
        )
        .order_by(Session.id)
        .with_for_update(key_share=True)
    ).all()
