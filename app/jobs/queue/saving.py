"""Results and failures of jobs, written to their measurement rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from typing import Any

import sqlalchemy as sa
from sqlalchemy import orm

from app.jobs.job import Job, JobResult
from app.jobs.queue.claimed_rows import unreadable
from app.jobs.queue.stated_targets import with_warning
from app.records.ids import new_id
from app.records.outcome import DetectedTarget, Failure
from app.records.readable import unreadable_columns
from app.records.statements import Rows, Statement
from app.records.tables import Measurement, Result, SessionTarget

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
    "burst",
    "focus_group",
    "joint_angles_deg",
    "captured_at",
    "received_at",
    "sha256",
    "filename",
    "pose_label",
    "bytes",
    "image_format",
    "image_width_px",
    "image_height_px",
    "made_by",
    "stated_target_id",
)
"""Columns that all measurements of one upload have in common."""


_OF_RESULT = tuple(Result.__table__.c.keys())
_FAILURE = ("failure_code", "failure_detail", "failure_advice")
_OF_CLAIM = sa.update(Measurement).where(
    Measurement.id == sa.bindparam("of_id"),
    Measurement.status == "running",
    Measurement.claim == sa.bindparam("of_claim"),
)
_SAVE = Statement(
    _OF_CLAIM.values(
        status=sa.bindparam("new_status"),
        attempts=Measurement.attempts + 1,
        claim=sa.null(),
        finished_at=sa.bindparam("now"),
        duration_ms=sa.bindparam("took_ms"),
        retry_failure=sa.null(),
        **{name: sa.bindparam(f"new_{name}") for name in _FAILURE},
    ).returning(Measurement.stated_target_id, Measurement.target_id)
)
_STATUS_OF_EARLIER = sa.case((Measurement.failure_code.is_(None), "succeeded"), else_="failed")
_KEEP = Statement(
    _OF_CLAIM.values(
        status=_STATUS_OF_EARLIER,
        attempts=Measurement.attempts + 1,
        claim=sa.null(),
        retry_failure=sa.bindparam("new_retry_failure"),
    ).returning(Measurement.id)
)
_EARLIER = Statement(
    sa.select(Result.points.is_not(None)).where(Result.measurement_id == sa.bindparam("of_id"))
)
_DROP_RESULT = Statement(sa.delete(Result).where(Result.measurement_id == sa.bindparam("of_id")))
_ADD_RESULT = Statement(sa.insert(Result), _OF_RESULT)


def earlier_results(session: orm.Session, measurement_ids: Sequence[str]) -> dict[str, bool]:
    """Return which measurements have a result, which a retry left in place, and whether it has grid points.

    Without any there is nothing to keep it for where a retry computes nothing.
    """
    rows = session.execute(
        sa.select(Result.measurement_id, Result.points.is_not(None)).where(
            Result.measurement_id.in_(measurement_ids)
        )
    )
    return {measurement_id: bool(has_points) for measurement_id, has_points in rows}


def keep_earlier(rows: Rows, job: Job, failure: Failure) -> bool:
    """End a retry that computed nothing: the earlier result stands, and the row says why it was not replaced."""
    kept = rows.first(_KEEP, of_id=job.measurement_id, of_claim=job.claim, new_retry_failure=asdict(failure))
    return kept is not None


def give_up(session: orm.Session, measurement_id: str, failure: Failure) -> None:
    """End a job that gives no result: it fails, unless there is an earlier result, which stands."""
    values: dict[str, Any] = {"claim": None}
    if earlier_results(session, [measurement_id]).get(measurement_id):
        values |= _kept_columns(failure)
    else:
        session.execute(sa.delete(Result).where(Result.measurement_id == measurement_id))
        values |= {"status": "failed", "finished_at": datetime.now(UTC), **_failure_columns(failure)}
    session.execute(
        sa.update(Measurement).where(Measurement.id == measurement_id).values(**values),
        execution_options={"synchronize_session": False},
    )


def _kept_columns(failure: Failure) -> dict[str, Any]:
    """Return the columns of a row whose result is an earlier one; its `failure_code` is that result's."""
    return {
        "status": _STATUS_OF_EARLIER,
        "retry_failure": asdict(failure),
    }


def save_result(rows: Rows, item: JobResult, now: datetime) -> bool:
    """Write what came of a job to its row, in place of any earlier result; False where its claim is no longer current.

    A failure that computed nothing leaves an earlier result with grid points as it is.
    """
    job, outcome = item.job, item.outcome
    if outcome.result is None and outcome.failure is not None:
        earlier = rows.first(_EARLIER, of_id=job.measurement_id)
        if earlier is not None and earlier[0]:
            return keep_earlier(rows, job, outcome.failure)
    taken = rows.first(
        _SAVE,
        of_id=job.measurement_id,
        of_claim=job.claim,
        new_status="succeeded" if outcome.failure is None else "failed",
        now=now,
        took_ms=item.duration_ms,
        **{f"new_{name}": value for name, value in _failure_columns(outcome.failure).items()},
    )
    if taken is None:
        return False
    rows.all(_DROP_RESULT, of_id=job.measurement_id)
    if outcome.result is not None:
        columns = dict.fromkeys(_OF_RESULT)
        result = with_warning(outcome.result, *taken)
        rows.all(_ADD_RESULT, **{**columns, "measurement_id": job.measurement_id, **(result or {})})
    return True


def save_detected(session: orm.Session, item: JobResult, now: datetime, *, replaces: bool) -> bool:
    """Write what came of a search: the first target shown to the job's row, the others to rows of their own.

    Rows of the image whose target the session no longer looks at are used before new ones are added.
    """
    row = session.scalar(
        current_claim(item.job)
        .values(attempts=Measurement.attempts + 1, claim=None, retry_failure=None)
        .returning(Measurement)
    )
    if row is None:
        return False
    was_measured = _was_measured(session, row)
    if replaces:
        session.execute(sa.delete(Result).where(Result.measurement_id == row.id))
    damaged = unreadable_columns(row)
    if damaged:
        give_up(session, row.id, unreadable(damaged))
        return True
    outcome, of_the_image = item.outcome, {name: getattr(row, name) for name in _OF_THE_IMAGE}
    siblings = [other for other in measurements_of_image(session, row) if other.id != row.id]
    held = [sibling.target_id for sibling in siblings]
    # The session's lock is held: what is read here stays so until this is saved.
    looked_at = session.scalars(
        sa.select(SessionTarget.target_id).where(SessionTarget.session_id == row.session_id)
    ).all()
    found = [shown for shown in outcome.shown if shown.target_id in looked_at]
    if not row.seeks_target:  # a sibling was deleted meanwhile, which this search must not bring back
        found = [shown for shown in found if shown.target_id == row.target_id]
    elif row.target_id not in looked_at or (found and not was_measured and not _is_shown(row, found)):
        row.target_id = None  # what is found takes the place of a target that was never found in the image
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
    vacant = [s for s in siblings if _is_vacant(s, looked_at)]
    for shown in others:
        if vacant:
            sibling = vacant.pop(0)
            session.execute(sa.delete(Result).where(Result.measurement_id == sibling.id))
            sibling.target_id, sibling.retry_failure = shown.target_id, None
            sibling.attempts += 1
        else:
            sibling = Measurement(**of_the_image, id=new_id("mea"), target_id=shown.target_id, attempts=1)
            session.add(sibling)
        measured.append((sibling, shown.result, shown.failure, shown.duration_ms))
    for each, columns, reason, duration_ms in measured:
        each.status = "succeeded" if reason is None else "failed"
        each.finished_at, each.duration_ms = now, duration_ms
        for name, value in _failure_columns(reason).items():
            setattr(each, name, value)
        columns = with_warning(columns, each.stated_target_id, each.target_id)
        if columns is not None:
            session.add(Result(measurement_id=each.id, **columns))
    session.flush()
    return True


def _was_measured(session: orm.Session, row: Measurement) -> bool:
    """Return whether the row has a result in which its target was found."""
    earlier = earlier_results(session, [row.id])
    return row.id in earlier and (earlier[row.id] or row.failure_code is None)


def _is_shown(row: Measurement, found: Sequence[DetectedTarget]) -> bool:
    return any(shown.target_id == row.target_id for shown in found)


def measurements_of_image(records: orm.Session, measurement: Measurement) -> Sequence[Measurement]:
    """Return the measurements of the same image at the same pose, this one included, oldest first."""
    return records.scalars(
        sa.select(Measurement)
        .where(
            Measurement.session_id == measurement.session_id,
            Measurement.pose_id == measurement.pose_id,
            Measurement.sha256 == measurement.sha256,
        )
        .order_by(Measurement.id)
    ).all()


def _is_vacant(row: Measurement, looked_at: Sequence[str]) -> bool:
    """Return whether the session no longer looks at a row's target and nobody computes it."""
    return (
        row.target_id is not None
        and row.target_id not in looked_at
        and row.status in ("succeeded", "failed")
        and not unreadable_columns(row)
    )


def _taken_away(job: Job, shown: Sequence[str]) -> Failure:
    """Return what is said of an image that shows nothing but targets its session has no more."""
    return Failure(
        "target_not_found",
        "None of the session's targets was found. Looked for: "
        f"{'; '.join(sought.target_id for sought in job.targets)}. The image shows {', '.join(shown)}, taken from the "
        "session while it was computed.",
        "Add the target to the session's target_ids again if it is to be measured, then retry.",
    )


def current_claim(job: Job) -> sa.Update:
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
