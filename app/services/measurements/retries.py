"""Measurements that become jobs again: by request, or because their originals came back."""

from __future__ import annotations

from typing import Any, Literal

import sqlalchemy as sa
from sqlalchemy import orm

from app.errors import Conflict, OriginalCorrupt, OriginalMissing
from app.jobs.queue import ALREADY_MEASURED, TOGETHER, queue_rows
from app.records.codec import are_markers, are_points
from app.records.readable import unreadable_columns
from app.records.tables import Measurement, Result, Session
from app.services.installation.context import ServiceContext
from app.services.measurements.reading import MeasurementDetail, get_measurement
from app.services.queries import get_or_raise

_LACKING = (OriginalMissing.code, OriginalCorrupt.code)
_OF_IMAGE_THAT_LACKED = Measurement.status.in_(("succeeded", "failed")) & (
    Measurement.failure_code.in_(_LACKING) | Measurement.retry_failure.is_not(None)
)
"""Measurements that may have failed for want of their original: why a retry failed, `lacked_original` reads."""


def queue_again(records: orm.Session, measurement: Measurement) -> None:
    """Make a measurement a job again. What came of it stays where there is a result, of which it is part.

    A result that cannot be read is deleted: nothing can be made of it.
    """
    measurement.status = "queued"
    measurement.attempts = 0
    measurement.claim = measurement.retry_failure = None
    result = records.scalar(
        sa.select(Result).where(Result.measurement_id == measurement.id).options(orm.undefer("*"))
    )
    if result is not None and not _is_readable(result):
        records.execute(sa.delete(Result).where(Result.measurement_id == measurement.id))
        result = None
    if result is None:
        measurement.finished_at = measurement.duration_ms = None
        measurement.failure_code = measurement.failure_detail = measurement.failure_advice = None
    records.flush()


def _is_readable(result: Result) -> bool:
    arrays_are_whole = (result.points is None or are_points(result.points)) and (
        result.markers is None or are_markers(result.markers)
    )
    return arrays_are_whole and not unreadable_columns(result)


def queue_restored(
    installation: ServiceContext, sha256: str, *, replaced: bool, uploaded: str | None = None
) -> int:
    """Queue the measurements of any session that lacked this original when it was to be measured; return how many.

    Its file is whole now. Where it was `replaced` just now, jobs that run may have found it missing or damaged: they
    are handed out anew, and what comes of this attempt is dropped. The measurement `uploaded`, which the upload made,
    came after the file.
    """
    which = _OF_IMAGE_THAT_LACKED
    if replaced:
        which = which | ((Measurement.status == "running") & (Measurement.id != (uploaded or "")))
    of_image = sa.and_(Measurement.sha256 == sha256, which)
    with installation.database.read() as records:  # an upload hardly ever finds any: no write lock for that
        if records.scalar(sa.select(Measurement.id).where(of_image).limit(1)) is None:
            return 0
    with installation.database.write() as records:
        found = [
            measurement
            for measurement in records.scalars(
                sa.select(Measurement)
                .where(of_image)
                .order_by(Measurement.id)
                .with_for_update(key_share=True)
            )
            if measurement.status == "running"
            or lacked_original(measurement.failure_code, measurement.retry_failure)
        ]
        for measurement in found:
            queue_again(records, measurement)
    if found:
        installation.queue.notify()
    return len(found)


def lacked_original(failure_code: str | None, retry_failure: dict[str, Any] | None) -> bool:
    """Return whether a measurement, or its last retry, failed for want of its original."""
    codes = {failure_code, retry_failure["code"] if retry_failure is not None else None}
    return not codes.isdisjoint(_LACKING)


def retry_measurement(installation: ServiceContext, measurement_id: str) -> MeasurementDetail:
    """Queue a measurement again, whatever came of it; its result stands until another one replaces it.

    Where its upload named no target, the image is searched for all of the session's targets again; those that other
    measurements of it have keep theirs. A retry that computes nothing (the worker died or took too long, the original
    is lost) leaves a result that has grid points as it is and says so in `retry_failure`.
    """
    with installation.database.write() as records:
        measurement = get_or_raise(records, Measurement, measurement_id, lock=True)
        if measurement.status == "running":
            raise Conflict(
                "The measurement is being computed right now.",
                "Wait until it has finished, then retry.",
                code="measurement_in_progress",
            )
        queue_again(records, measurement)
    installation.queue.notify()
    with installation.database.read() as records:
        return get_measurement(records, measurement_id)


def reprocess_session(
    installation: ServiceContext, session_id: str, *, only: Literal["failed", "all"]
) -> int:
    """Queue a session's measurements again and return how many; their results stand until others replace them.

    `failed` are those without a calibration, and those whose last retry computed nothing. With `all`, those that are
    computed just now are handed out anew, so that a change of lens or intrinsics counts for them too. TOGETHER rows are
    queued in each transaction, so that uploads go on meanwhile; where this is interrupted, ask again.
    """
    which = Measurement.status != "queued"
    if only == "failed":
        is_duplicate = sa.func.coalesce(Measurement.failure_code, "") == ALREADY_MEASURED.code
        which = ((Measurement.status == "failed") & ~is_duplicate) | (
            (Measurement.status == "succeeded") & Measurement.retry_failure.is_not(None)
        )
    of_session = Measurement.session_id == session_id
    with installation.database.read() as records:
        get_or_raise(records, Session, session_id)
        end = records.scalar(sa.select(sa.func.max(Measurement.id)).where(of_session)) or ""
    last, count = "", 0
    while True:
        with installation.database.write() as records:
            get_or_raise(records, Session, session_id, lock=True)
            ids = records.scalars(
                sa.select(Measurement.id)
                .where(of_session, which, Measurement.id > last, Measurement.id <= end)
                .order_by(Measurement.id)
                .limit(TOGETHER)
            ).all()
            if ids:
                queue_rows(records, ids)
        count += len(ids)
        installation.queue.notify()
        if len(ids) < TOGETHER:
            return count
        last = ids[-1]
