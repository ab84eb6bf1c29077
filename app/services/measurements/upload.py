"""Upload of an image: it is stored permanently, and its measurement is queued."""

from __future__ import annotations

import unicodedata

from app.blobs.local import StagedBlob
from app.errors import InvalidContent
from app.jobs.validation import validate_image
from app.services.installation.context import ServiceContext
from app.services.measurements.acceptance import (
    Metadata,
    NewMeasurement,
    ReceivedImage,
    accept,
    choose_target,
    find_same,
    read_targets,
)
from app.services.measurements.reading import MeasurementDetail, get_measurement
from app.services.measurements.retries import queue_restored
from app.services.originals import cleanup_after_failure, restore_original

FILENAME_LENGTH = 255


def store_image(
    installation: ServiceContext,
    session_id: str,
    pose_id: str,
    staged: StagedBlob,
    metadata: Metadata,
    *,
    expected_sha256: str | None,
) -> NewMeasurement | MeasurementDetail:
    """Keep a received file for good and queue its measurement; on return both are durable.

    The same image for the same pose and target again gives the first measurement, unchanged; and so does the same
    image without a target, however many of them detection found in it. A file that was lost or damaged on the disk is
    replaced, and measurements that failed for that are queued again.
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
    database, blobs = installation.database, installation.blobs
    if blobs.is_there(sha256):
        first = find_upload(installation, session_id, pose_id, sha256, metadata.target_id)
        if first is not None:
            return _repeated(installation, staged, first)
    image = ReceivedImage(
        session_id=session_id,
        pose_id=pose_id,
        sha256=sha256,
        size=staged.size,
        header=validate_image(staged.source, installation.settings.max_image_pixels),
        filename=sanitise_filename(metadata.filename),
    )
    with blobs.lock(sha256):
        try:
            was_whole = blobs.is_there(sha256) and blobs.is_whole(sha256, staged.size)
            blobs.publish(staged)  # where only its last step fails, the file is in place already
            accepted = database.write_together(lambda rows: accept(rows, image, metadata))
        except Exception:
            cleanup_after_failure(database, blobs, sha256)
            raise
    if isinstance(accepted, str):  # its file was lost, or somebody else sent it meanwhile
        queue_restored(installation, sha256, replaced=not was_whole)
        return _detail(installation, accepted)
    installation.queue.notify()
    if accepted.elsewhere:  # the same image, whose file this one replaced
        queue_restored(installation, sha256, replaced=not was_whole, uploaded=accepted.id)
    return accepted


def find_upload(
    installation: ServiceContext, session_id: str, pose_id: str, sha256: str, target_id: str | None
) -> str | None:
    """Return the measurement that an upload like this would be answered with, None where it would be a new one.

    Raises NotFound, InvalidContent.
    """
    with installation.database.read_rows() as rows:
        intended = choose_target(read_targets(rows, session_id), target_id)
        return find_same(rows, session_id, pose_id, sha256, intended)


def sanitise_filename(name: str | None) -> str | None:
    """Return a file's name without path, control or invisible characters, None where nothing is left."""
    if name is None:
        return None
    name = name.replace("\\", "/").rsplit("/", 1)[-1]
    name = "".join(c for c in name if unicodedata.category(c) not in ("Cc", "Cf", "Cs", "Zl", "Zp")).strip()
    return name[:FILENAME_LENGTH] if name not in ("", ".", "..") else None


def _repeated(installation: ServiceContext, staged: StagedBlob, measurement_id: str) -> MeasurementDetail:
    """Return the measurement of an image that is here already, whose file may have to be put back."""
    restored = restore_original(installation.database, installation.blobs, staged)
    queue_restored(installation, staged.sha256, replaced=restored)
    return _detail(installation, measurement_id)


def _detail(installation: ServiceContext, measurement_id: str) -> MeasurementDetail:
    with installation.database.read() as records:
        return get_measurement(records, measurement_id)
