"""The embedded queue: a measurement row whose status is `queued` is a job."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from datetime import UTC, datetime

import sqlalchemy as sa
from sqlalchemy import orm

from app.jobs.queue import Finished, Job
from app.records.codec import Failure
from app.records.database import Database
from app.records.ids import new_id
from app.records.tables import Measurement, Result, Session, Target, target_fields

MAX_ATTEMPTS = 3

WORKER_CRASHED = Failure(
    "worker_crashed",
    f"The process computing this image died {MAX_ATTEMPTS} times.",
    "Check the server's memory and log; the image may be larger than the server can hold. Then retry.",
)


class RowQueue:
    """`jobs.queue.Queue` on the measurement rows, for SQLite and PostgreSQL."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._news = threading.Event()

    def enqueue(self, session: orm.Session, measurement_id: str) -> None:
        """Nothing to add: the row that says `queued`, in the caller's transaction, is the job."""

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
        oldest = (
            sa.select(Measurement.id)
            .where(Measurement.status == "queued")
            .order_by(Measurement.id)
            .limit(limit)
        )
        if not self._database.is_sqlite:
            oldest = oldest.with_for_update(skip_locked=True)
        with self._database.read() as session:
            # Looking costs no write lock; an idle runner does little else.
            if (
                session.scalar(sa.select(Measurement.id).where(Measurement.status == "queued").limit(1))
                is None
            ):
                return ()
        claim = new_id("clm")
        with self._database.write() as session:
            claimed = session.scalars(
                sa.update(Measurement)
                .where(Measurement.id.in_(oldest))
                .values(status="running", claim=claim)
                .returning(Measurement.id)
            ).all()
            rows = session.execute(
                sa.select(Measurement.id, Measurement.sha256, Session.lens, Session.intrinsics, Target)
                .join(Session, Session.id == Measurement.session_id)
                .join(Target, Target.id == Measurement.target_id)
                .where(Measurement.id.in_(claimed))
                .order_by(Measurement.id)
            ).all()
        return tuple(
            Job(
                measurement_id=measurement_id,
                claim=claim,
                sha256=sha256,
                target=target_fields(target),
                lens=lens,
                intrinsics=intrinsics,
            )
            for measurement_id, sha256, lens, intrinsics, target in rows
        )

    def finish(self, finished: Sequence[Finished]) -> int:
        saved = 0
        now = datetime.now(UTC)
        with self._database.write() as session:
            for item in finished:
                failure = item.outcome.failure
                taken = session.execute(
                    _current(item.job)
                    .values(
                        status="succeeded" if failure is None else "failed",
                        attempts=Measurement.attempts + 1,
                        claim=None,
                        finished_at=now,
                        duration_ms=item.duration_ms,
                        **_failure_columns(failure),
                    )
                    .returning(Measurement.id)
                ).all()
                if taken:
                    saved += 1
                    if item.outcome.result is not None:
                        session.add(Result(measurement_id=item.job.measurement_id, **item.outcome.result))
        return saved

    def give_back(self, jobs: Sequence[Job]) -> None:
        if not jobs:
            return
        with self._database.write() as session:
            for job in jobs:
                session.execute(_current(job).values(status="queued", claim=None))

    def crashed(self, job: Job) -> None:
        with self._database.write() as session:
            attempts = session.scalar(
                _current(job)
                .values(status="queued", claim=None, attempts=Measurement.attempts + 1)
                .returning(Measurement.attempts)
            )
            if attempts is not None and attempts >= MAX_ATTEMPTS:
                session.execute(
                    sa.update(Measurement)
                    .where(Measurement.id == job.measurement_id)
                    .values(
                        status="failed", finished_at=datetime.now(UTC), **_failure_columns(WORKER_CRASHED)
                    )
                )


def _current(job: Job) -> sa.Update:
    """Address the job's row as long as this very claim holds it: not retried, not deleted, not given back."""
    return sa.update(Measurement).where(
        Measurement.id == job.measurement_id, Measurement.status == "running", Measurement.claim == job.claim
    )


def _failure_columns(failure: Failure | None) -> dict[str, str | None]:
    return {
        "failure_code": failure.code if failure else None,
        "failure_detail": failure.detail if failure else None,
        "failure_advice": failure.advice if failure else None,
    }
