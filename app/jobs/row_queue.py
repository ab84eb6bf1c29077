"""The embedded queue: a measurement row whose status is `queued` is a job."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from datetime import UTC, datetime

import sqlalchemy as sa
from sqlalchemy import orm

from app.jobs.queue import Finished, Job, Sought
from app.records.codec import Failure
from app.records.database import Database
from app.records.ids import new_id
from app.records.tables import Measurement, Result, Session, SessionTarget, Target, target_fields

MAX_ATTEMPTS = 3

WORKER_CRASHED = Failure(
    "worker_crashed",
    f"The process computing this image died {MAX_ATTEMPTS} times.",
    "Check the server's memory and log; the image may be larger than the server can hold. Then retry.",
)

ALREADY_MEASURED = Failure(
    "target_already_measured",
    "Every target that this image shows has a measurement of this image at this pose already: see siblings.",
    "Nothing is to be done: analyses take those measurements, and leave this row out.",
)
"""Of a row that only says where its image was measured; it is no input of any analysis."""

_OF_THE_IMAGE = (
    "session_id",
    "pose_id",
    "cycle",
    "focus_group",
    "joint_angles_deg",
    "captured_at",
    "received_at",
    "sha256",
    "filename",
    "bytes",
    "image_format",
    "image_width_px",
    "image_height_px",
)
"""Columns that all measurements of one upload have in common."""


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
                sa.select(Measurement, Session.lens, Session.intrinsics)
                .join(Session, Session.id == Measurement.session_id)
                .where(Measurement.id.in_(claimed))
                .order_by(Measurement.id)
            ).all()
            sought = _sought(session, [row for row, _, _ in rows])
            return tuple(
                Job(
                    measurement_id=row.id,
                    claim=claim,
                    sha256=row.sha256,
                    target_id=row.target_id,
                    targets=sought[row.id],
                    lens=lens,
                    intrinsics=intrinsics,
                )
                for row, lens, intrinsics in rows
            )

    def finish(self, finished: Sequence[Finished]) -> int:
        saved = 0
        now = datetime.now(UTC)
        searched = [item.job.measurement_id for item in finished if not item.job.names_its_target]
        with self._database.write() as session:
            if searched:
                # Uploads and deletions of these sessions wait: between asking which targets of an image have rows
                # and adding the others, none may be added. All at once and before any row, or two could wait in a ring.
                session.scalars(
                    sa.select(Session.id)
                    .where(
                        Session.id.in_(
                            sa.select(Measurement.session_id).where(Measurement.id.in_(searched)).distinct()
                        )
                    )
                    .order_by(Session.id)
                    .with_for_update(key_share=True)
                ).all()
            for item in finished:
                save = _save if item.job.names_its_target else _save_shown
                saved += save(session, item, now)
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


def _sought(session: orm.Session, rows: Sequence[Measurement]) -> dict[str, tuple[Sought, ...]]:
    """Return what each measurement's image is to be searched for: its own target, or all of its session's."""
    seeking = {row.session_id for row in rows if row.seeks_target}
    of_session: dict[str, list[str]] = {}
    for session_id, target_id in session.execute(
        sa.select(SessionTarget.session_id, SessionTarget.target_id)
        .where(SessionTarget.session_id.in_(seeking))
        .order_by(SessionTarget.session_id, SessionTarget.position)
    ):
        of_session.setdefault(session_id, []).append(target_id)
    wanted = {row.id: of_session[row.session_id] if row.seeks_target else [row.target_id] for row in rows}
    named = {target_id for ids in wanted.values() for target_id in ids}
    fields = {
        target.id: target_fields(target)
        for target in session.scalars(sa.select(Target).where(Target.id.in_(named)))
    }
    return {
        row_id: tuple(Sought(target_id, fields[target_id]) for target_id in ids if target_id is not None)
        for row_id, ids in wanted.items()
    }


def _save(session: orm.Session, item: Finished, now: datetime) -> bool:
    """Write what came of a job to its row; False where its claim is no longer current."""
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
    if taken and item.outcome.result is not None:
        session.add(Result(measurement_id=item.job.measurement_id, **item.outcome.result))
    return bool(taken)


def _save_shown(session: orm.Session, item: Finished, now: datetime) -> bool:
    """Write what came of a search: the first target shown to the job's row, the others to rows of their own."""
    row = session.scalar(
        _current(item.job).values(attempts=Measurement.attempts + 1, claim=None).returning(Measurement)
    )
    if row is None:
        return False
    outcome, of_the_image = item.outcome, {name: getattr(row, name) for name in _OF_THE_IMAGE}
    held = session.scalars(
        sa.select(Measurement.target_id).where(
            Measurement.session_id == row.session_id,
            Measurement.pose_id == row.pose_id,
            Measurement.sha256 == row.sha256,
            Measurement.id != row.id,
        )
    ).all()
    # The session's lock is held: what is read here stays so until this is saved.
    looked_at = session.scalars(
        sa.select(SessionTarget.target_id).where(SessionTarget.session_id == row.session_id)
    ).all()
    found = [shown for shown in outcome.shown if shown.target_id in looked_at]
    others = [shown for shown in found if shown.target_id not in held]
    own = next((shown for shown in others if row.target_id in (None, shown.target_id)), None)
    result, failure = outcome.result, outcome.failure
    if own is not None:
        others.remove(own)
        row.target_id = own.target_id
        result, failure = own.result, own.failure
    elif row.target_id is None and found:
        failure = ALREADY_MEASURED
    elif row.target_id is None and outcome.shown:
        failure = _taken_away(item.job, [shown.target_id for shown in outcome.shown])
    measured = [(row, result, failure, item.duration_ms - sum(shown.duration_ms for shown in others))]
    for shown in others:
        sibling = Measurement(**of_the_image, id=new_id("mea"), target_id=shown.target_id, attempts=1)
        session.add(sibling)
        measured.append((sibling, shown.result, shown.failure, shown.duration_ms))
    for each, columns, reason, duration_ms in measured:
        each.status = "succeeded" if reason is None else "failed"
        each.finished_at, each.duration_ms = now, duration_ms
        for name, value in _failure_columns(reason).items():
            setattr(each, name, value)
        if columns is not None:
            session.add(Result(measurement_id=each.id, **columns))
    session.flush()
    return True


def _taken_away(job: Job, shown: Sequence[str]) -> Failure:
    """Return what is said of an image that shows nothing but targets its session has no more."""
    return Failure(
        "target_not_found",
        "None of the session's targets was found. Looked for: "
        f"{'; '.join(sought.target_id for sought in job.targets)}. The image shows {', '.join(shown)}, taken from the "
        "session while it was computed.",
        "Add the target to the session's target_ids again if it is to be measured, then retry.",
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
