"""Measurements: an image comes in, is kept for good, and is computed by whoever takes the job."""

from __future__ import annotations

import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from sqlalchemy import orm
from sqlalchemy.sql.elements import ColumnElement

from app.blobs.local import LocalBlobs, StagedBlob
from app.errors import Conflict, InvalidContent, NotFound
from app.jobs.admission import AdmittedImage, admit_image
from app.records.codec import points_documents
from app.records.ids import new_id
from app.records.pagination import page
from app.records.tables import Measurement, Result, Session
from app.services.installation import Installation
from app.services.lookup import find
from app.services.originals import restore_original, tidy_after_failure
from app.services.poses import ensure_pose

FILENAME_LENGTH = 255


@dataclass(frozen=True, slots=True, kw_only=True)
class Metadata:
    """What a client says about an image; all of it optional."""

    cycle: int | None = None
    target_id: str | None = None
    focus_group: str = "default"
    joint_angles_deg: list[float] | None = None
    captured_at: datetime | None = None
    filename: str | None = None


@dataclass(frozen=True, slots=True)
class MeasurementView:
    """A measurement with its result, and the ids of the others of the same image at the same pose, oldest first."""

    measurement: Measurement
    siblings: list[str]


@dataclass(frozen=True, slots=True)
class Accepted:
    """The measurement an upload led to, and whether it is a new one."""

    view: MeasurementView
    is_new: bool


@dataclass(frozen=True, slots=True)
class Intended:
    """Which target an upload is of, None where the image is to be searched first, and whether the upload named it."""

    target_id: str | None
    named: bool


def check_target(session: Session, target_id: str | None) -> Intended:
    """Return which target an upload to this session is of."""
    target_ids = [target.target_id for target in session.targets]
    if target_id is None:
        return Intended(target_ids[0] if len(target_ids) == 1 else None, named=False)
    if target_id not in target_ids:
        raise InvalidContent(
            "The session does not look at this target.",
            "Send one of the session's target_ids, or add the target to the session.",
            code="target_unknown",
            errors=[("target_id", "is not one of the session's targets")],
        )
    return Intended(target_id, named=True)


def accept_image(
    installation: Installation,
    session_id: str,
    pose_id: str,
    staged: StagedBlob,
    metadata: Metadata,
    *,
    expected_sha256: str | None,
    intended: Intended | None = None,
) -> Accepted:
    """Keep a received file for good and queue its measurement; on return both are durable.

    The same image for the same pose and target again gives the first measurement, unchanged; and so does the same
    image without a target, however many of them detection found in it. `intended` is what `check_target` said before
    the file came, if it was asked; the transaction that writes asks again.
    """
    if staged.size == 0:
        raise InvalidContent(
            "The upload is empty.", "Send the image file's bytes as the body.", code="empty_upload"
        )
    sha256 = staged.sha256
    if expected_sha256 is not None and sha256 != expected_sha256:
        raise InvalidContent(
            "The bytes received do not have the SHA-256 stated in the address; nothing was kept.",
            "Compute the hash of exactly the bytes sent, and send them again.",
            code="hash_mismatch",
        )
    with installation.database.read() as records:
        if intended is None:
            intended = check_target(find(records, Session, session_id), metadata.target_id)
        first = _find_same(records, session_id, pose_id, sha256, intended)
        views = _with_siblings(records, [first] if first is not None else [])
    database, blobs = installation.database, installation.blobs
    if views:
        restore_original(database, blobs, staged)
        return Accepted(views[0], is_new=False)
    admitted = admit_image(staged.path, installation.settings.max_image_pixels)
    with blobs.guard(sha256):
        blobs.publish(staged)
        try:
            with database.write() as records:
                accepted = _add_measurement(
                    installation, records, session_id, pose_id, staged, metadata, admitted
                )
        except Exception:
            tidy_after_failure(database, blobs, sha256)
            raise
    installation.queue.notify()
    return accepted


def _add_measurement(
    installation: Installation,
    records: orm.Session,
    session_id: str,
    pose_id: str,
    staged: StagedBlob,
    metadata: Metadata,
    admitted: AdmittedImage,
) -> Accepted:
    session = find(records, Session, session_id, lock=True)
    intended = check_target(session, metadata.target_id)
    first = _find_same(records, session_id, pose_id, staged.sha256, intended)
    if first is not None:
        return Accepted(_with_siblings(records, [first])[0], is_new=False)
    ensure_pose(records, session_id, pose_id)
    measurement = _new_measurement(
        session_id, pose_id, intended, staged.sha256, staged.size, metadata, admitted
    )
    records.add(measurement)
    records.flush()
    installation.queue.enqueue(records, measurement.id)
    if len(session.targets) == 1:  # an image of one target has no other rows
        return Accepted(MeasurementView(measurement, []), is_new=True)
    return Accepted(_with_siblings(records, [measurement])[0], is_new=True)


def find_missing(
    records: orm.Session, blobs: LocalBlobs, session_id: str, images: Sequence[tuple[str, str]]
) -> list[tuple[str, str]]:
    """Return those (pose_id, sha256) of which the session has no measurement, in the order asked, each once.

    One whose original is gone from the disk is missing too: sending it again puts it back.
    """
    find(records, Session, session_id)
    wanted = list(dict.fromkeys(images))
    present: set[tuple[str, str]] = set()
    hashes = list({sha256 for _, sha256 in wanted})
    for start in range(0, len(hashes), 500):
        rows = records.execute(
            sa.select(Measurement.pose_id, Measurement.sha256, Measurement.bytes).where(
                Measurement.session_id == session_id, Measurement.sha256.in_(hashes[start : start + 500])
            )
        )
        present.update((pose_id, sha256) for pose_id, sha256, size in rows if blobs.holds(sha256, size))
    return [image for image in wanted if image not in present]


def get_measurement(records: orm.Session, measurement_id: str) -> MeasurementView:
    """Return one measurement."""
    find(records, Measurement, measurement_id)
    measurement = records.scalars(
        sa.select(Measurement)
        .where(Measurement.id == measurement_id)
        .options(orm.joinedload(Measurement.result))
        .execution_options(populate_existing=True)
    ).one()
    return _with_siblings(records, [measurement])[0]


def get_points(records: orm.Session, measurement_id: str) -> list[dict[str, Any]] | None:
    """Return every grid point found, or None where none is known (yet)."""
    points = records.scalar(sa.select(Result.points).where(Result.measurement_id == measurement_id))
    return points_documents(points) if points is not None else None


def list_measurements(
    records: orm.Session,
    session_id: str,
    *,
    status: str | None,
    pose_id: str | None,
    limit: int,
    cursor: str | None,
) -> tuple[list[MeasurementView], str | None]:
    """Return one page of a session's measurements."""
    find(records, Session, session_id)
    statement = (
        sa.select(Measurement)
        .where(Measurement.session_id == session_id)
        .options(orm.joinedload(Measurement.result))
    )
    if status is not None:
        statement = statement.where(Measurement.status == status)
    if pose_id is not None:
        statement = statement.where(Measurement.pose_id == pose_id)
    rows, next_cursor = page(records, statement, Measurement.id, limit=limit, cursor=cursor)
    return _with_siblings(records, rows), next_cursor


def get_original(installation: Installation, measurement_id: str) -> tuple[Measurement, Path]:
    """Return a measurement and where its original lies."""
    with installation.database.read() as records:
        measurement = find(records, Measurement, measurement_id)
    path = installation.blobs.path(measurement.sha256)
    if not path.is_file():
        raise NotFound(
            "The stored image is gone from the server's disk.",
            "Upload the image again, which puts it back.",
            code="original_missing",
        )
    return measurement, path


def retry_measurement(installation: Installation, measurement_id: str) -> MeasurementView:
    """Queue a measurement again, whatever came of it; its last result is forgotten.

    Where its upload named no target, the image is searched for all of the session's targets again; those that other
    measurements of it have keep theirs.
    """
    with installation.database.write() as records:
        measurement = find(records, Measurement, measurement_id, lock=True)
        if measurement.status == "running":
            raise Conflict(
                "The measurement is being computed right now.",
                "Wait until it has finished, then retry.",
                code="measurement_running",
            )
        records.execute(sa.delete(Result).where(Result.measurement_id == measurement_id))
        measurement.status = "queued"
        measurement.attempts = 0
        measurement.claim = None
        measurement.finished_at = measurement.duration_ms = None
        measurement.failure_code = measurement.failure_detail = measurement.failure_advice = None
        records.flush()
        installation.queue.enqueue(records, measurement_id)
    installation.queue.notify()
    with installation.database.read() as records:
        return get_measurement(records, measurement_id)


def bare_filename(name: str | None) -> str | None:
    """Return a file's name without path, control or invisible characters, None where nothing is left."""
    if name is None:
        return None
    name = name.replace("\\", "/").rsplit("/", 1)[-1]
    name = "".join(c for c in name if unicodedata.category(c) not in ("Cc", "Cf", "Cs", "Zl", "Zp")).strip()
    return name[:FILENAME_LENGTH] if name not in ("", ".", "..") else None


def _with_siblings(records: orm.Session, measurements: Sequence[Measurement]) -> list[MeasurementView]:
    """Return these measurements of one session with the others of their images; one question for all of them."""
    if not measurements:
        return []
    of_image: dict[tuple[str, str], list[str]] = {}
    # Not in the order of ids, for which SQLite would read the whole session.
    for measurement_id, pose_id, sha256 in records.execute(
        sa.select(Measurement.id, Measurement.pose_id, Measurement.sha256).where(
            Measurement.session_id == measurements[0].session_id,
            Measurement.pose_id.in_({m.pose_id for m in measurements}),
            Measurement.sha256.in_({m.sha256 for m in measurements}),
        )
    ):
        of_image.setdefault((pose_id, sha256), []).append(measurement_id)
    return [
        MeasurementView(m, sorted(set(of_image.get((m.pose_id, m.sha256), ())) - {m.id}))
        for m in measurements
    ]


def _find_same(
    records: orm.Session, session_id: str, pose_id: str, sha256: str, intended: Intended
) -> Measurement | None:
    """Return the measurement that the same upload led to: of this target; or of none named, then as now."""
    same: list[ColumnElement[bool]] = []
    if not intended.named:
        same.append(Measurement.seeks_target.is_(True))
    if intended.target_id is not None:
        same.append(Measurement.target_id == intended.target_id)
    return records.scalar(
        sa.select(Measurement)
        .where(
            Measurement.session_id == session_id,
            Measurement.pose_id == pose_id,
            Measurement.sha256 == sha256,
            sa.or_(*same),
        )
        .order_by(Measurement.id)
        .limit(1)
        .options(orm.joinedload(Measurement.result))
    )


def _new_measurement(
    session_id: str,
    pose_id: str,
    intended: Intended,
    sha256: str,
    size: int,
    metadata: Metadata,
    admitted: AdmittedImage,
) -> Measurement:
    return Measurement(
        id=new_id("mea"),
        session_id=session_id,
        pose_id=pose_id,
        target_id=intended.target_id,
        seeks_target=not intended.named,
        cycle=metadata.cycle,
        focus_group=metadata.focus_group,
        joint_angles_deg=metadata.joint_angles_deg,
        captured_at=metadata.captured_at,
        received_at=datetime.now(UTC),
        sha256=sha256,
        filename=bare_filename(metadata.filename),
        bytes=size,
        image_format=admitted.format,
        image_width_px=admitted.width_px,
        image_height_px=admitted.height_px,
        status="queued",
        attempts=0,
        result=None,
    )
