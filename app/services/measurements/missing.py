"""Which images of a client's list an upload would store."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import sqlalchemy as sa
from sqlalchemy import orm

from app.blobs import Blobs
from app.records.tables import Measurement, Session
from app.services.measurements.acceptance import unknown_target
from app.services.measurements.retries import lacked_original
from app.services.queries import get_or_raise

ImageKey = tuple[str, str, str | None]
"""Pose, SHA-256, and the target that the upload names, None where it names none."""


def find_missing(
    records: orm.Session, blobs: Blobs, session_id: str, images: Sequence[ImageKey]
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
        found = rows.all()
        there = blobs.existing({(row.sha256, row.bytes) for row in found})
        for pose_id, sha256, target_id, seeks_target, size, code, retry in found:
            if (sha256, size) in there:
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
        raise unknown_target(errors[:100])
