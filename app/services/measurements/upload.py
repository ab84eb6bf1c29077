"""Upload of an image: it is stored permanently, and its measurement is queued."""

from __future__ import annotations

import unicodedata
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import sqlalchemy as sa
from sqlalchemy import orm
from sqlalchemy.sql.elements import ColumnElement

from app.blobs.local import LocalBlobs, StagedBlob
from app.errors import InvalidContent
from app.jobs.validation import ImageInfo, validate_image
from app.records.ids import new_id
from app.records.tables import Measurement, Session
from app.services.context import ServiceContext
from app.services.measurements.quota import count_upload
from app.services.measurements.reading import MeasurementDetail, get_measurement, with_siblings
from app.services.measurements.retries import lacked_original, queue_restored
from app.services.originals import cleanup_after_failure, restore_original
from app.services.poses import get_or_create_pose
from app.services.queries import get_or_raise

FILENAME_LENGTH = 255
ImageKey = tuple[str, str, str | None]
"""Pose, SHA-256, and the target that the upload names, None where it names none."""


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
class UploadResult:
    """The measurement an upload led to, and whether it is a new one."""

    view: MeasurementDetail
    is_new: bool


@dataclass(frozen=True, slots=True)
class TargetChoice:
    """Which target an upload is of, None where the image is to be searched first, and whether the upload named it."""

    target_id: str | None
    named: bool


def check_target(session: Session, target_id: str | None) -> TargetChoice:
    """Return which target an upload to this session is of."""
    target_ids = [target.target_id for target in session.targets]
    if target_id is None:
        return TargetChoice(target_ids[0] if len(target_ids) == 1 else None, named=False)
    if target_id not in target_ids:
        raise _target_unknown([("target_id", "is not one of the session's targets")])
    return TargetChoice(target_id, named=True)


def _target_unknown(errors: Sequence[tuple[str, str]]) -> InvalidContent:
    return InvalidContent(
        "The session does not look at this target.",
        "Send one of the session's target_ids, or add the target to them (PATCH /v1/sessions/{session_id}, "
        "`gridpose sessions change`).",
        code="referenced_target_not_found",
        errors=errors,
    )


def store_image(
    installation: ServiceContext,
    session_id: str,
    pose_id: str,
    staged: StagedBlob,
    metadata: Metadata,
    *,
    expected_sha256: str | None,
    intended: TargetChoice | None = None,
) -> UploadResult:
    """Keep a received file for good and queue its measurement; on return both are durable.

    The same image for the same pose and target again gives the first measurement, unchanged; and so does the same
    image without a target, however many of them detection found in it. A file that was lost or damaged on the disk is
    replaced, and measurements that failed for that are queued again. `intended` is what `check_target` said before the
    file came, if it was asked; the transaction that writes asks again.
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
            intended = check_target(get_or_raise(records, Session, session_id), metadata.target_id)
        first = _find_same(records, session_id, pose_id, sha256, intended)
        views = with_siblings(records, [first] if first is not None else [])
    database, blobs = installation.database, installation.blobs
    if views:
        restored = restore_original(database, blobs, staged)
        if not queue_restored(installation, sha256, replaced=restored):
            return UploadResult(views[0], is_new=False)
        with database.read() as records:
            return UploadResult(get_measurement(records, views[0].measurement.id), is_new=False)
    admitted = validate_image(staged.path, installation.settings.max_image_pixels)
    with blobs.lock(sha256):
        try:
            was_whole = blobs.is_whole(sha256, staged.size)  # usually there is no file yet
            blobs.publish(staged)  # where only its last step fails, the file is in place already
            with database.write() as records:
                accepted = _add_measurement(
                    installation, records, session_id, pose_id, staged, metadata, admitted
                )
        except Exception:
            cleanup_after_failure(database, blobs, sha256)
            raise
    installation.queue.notify()
    # The same image elsewhere, whose file this one replaced.
    made = accepted.view.measurement.id if accepted.is_new else None
    queue_restored(installation, sha256, replaced=not was_whole, uploaded=made)
    return accepted


def _add_measurement(
    installation: ServiceContext,
    records: orm.Session,
    session_id: str,
    pose_id: str,
    staged: StagedBlob,
    metadata: Metadata,
    admitted: ImageInfo,
) -> UploadResult:
    session = get_or_raise(records, Session, session_id, lock=True)
    intended = check_target(session, metadata.target_id)
    first = _find_same(records, session_id, pose_id, staged.sha256, intended)
    if first is not None:
        return UploadResult(with_siblings(records, [first])[0], is_new=False)
    count_upload(records, staged.size)
    get_or_create_pose(records, session_id, pose_id)
    measurement = _new_measurement(
        session_id, pose_id, intended, staged.sha256, staged.size, metadata, admitted
    )
    records.add(measurement)
    records.flush()
    if len(session.targets) == 1:  # an image of one target has no other rows
        return UploadResult(MeasurementDetail(measurement, []), is_new=True)
    return UploadResult(with_siblings(records, [measurement])[0], is_new=True)


def is_stored(
    records: orm.Session, session_id: str, pose_id: str, sha256: str, target_id: str | None
) -> bool:
    """Return whether an upload like this would be answered with a measurement that is here."""
    intended = check_target(get_or_raise(records, Session, session_id), target_id)
    return _find_same(records, session_id, pose_id, sha256, intended) is not None


def sanitise_filename(name: str | None) -> str | None:
    """Return a file's name without path, control or invisible characters, None where nothing is left."""
    if name is None:
        return None
    name = name.replace("\\", "/").rsplit("/", 1)[-1]
    name = "".join(c for c in name if unicodedata.category(c) not in ("Cc", "Cf", "Cs", "Zl", "Zp")).strip()
    return name[:FILENAME_LENGTH] if name not in ("", ".", "..") else None


def find_missing(
    records: orm.Session, blobs: LocalBlobs, session_id: str, images: Sequence[ImageKey]
) -> list[ImageKey]:
    """Return those (pose_id, sha256, target_id) that an upload would store, in the order asked, each once.

    An image without a target is to be searched for all of the session's targets. One whose original is gone from the
    disk, has another length or was found to be corrupt when it was last to be measured is missing too: sending it again
    puts it back. The files' bytes are not read: that would take 0.5 ms per MB of all images asked about.

    Raises NotFound, InvalidContent.
    """
    session = get_or_raise(records, Session, session_id)
    looked_at = {target.target_id for target in session.targets}
    _require_targets(images, looked_at)
    wanted = list(dict.fromkeys(images))
    present: set[ImageKey] = set()
    lost: set[tuple[str, str]] = set()
    hashes = list({sha256 for _, sha256, _ in wanted})
    for start in range(0, len(hashes), 500):
        rows = records.execute(
            sa.select(
                Measurement.pose_id,
                Measurement.sha256,
                Measurement.target_id,
                Measurement.seeks_target,
                Measurement.bytes,
                Measurement.failure_code,
                Measurement.retry_failure,
            ).where(Measurement.session_id == session_id, Measurement.sha256.in_(hashes[start : start + 500]))
        )
        for pose_id, sha256, target_id, seeks_target, size, code, retry in rows:
            if blobs.exists(sha256, size):
                if target_id is not None:
                    present.add((pose_id, sha256, target_id))
                if seeks_target or looked_at == {target_id}:
                    present.add((pose_id, sha256, None))
            if lacked_original(code, retry):
                lost.add((pose_id, sha256))
    return [image for image in wanted if image not in present or image[:2] in lost]


def _require_targets(images: Sequence[ImageKey], looked_at: Collection[str]) -> None:
    """Raise InvalidContent where an image names a target that the session does not look at."""
    errors = [
        (f"images.{place}.target_id", "is not one of the session's targets")
        for place, (_, _, target_id) in enumerate(images)
        if target_id is not None and target_id not in looked_at
    ]
    if errors:
        raise _target_unknown(errors[:100])


def _find_same(
    records: orm.Session, session_id: str, pose_id: str, sha256: str, intended: TargetChoice
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
    intended: TargetChoice,
    sha256: str,
    size: int,
    metadata: Metadata,
    admitted: ImageInfo,
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
        filename=sanitise_filename(metadata.filename),
        bytes=size,
        image_format=admitted.format,
        image_width_px=admitted.width_px,
        image_height_px=admitted.height_px,
        status="queued",
        attempts=0,
        result=None,
    )
