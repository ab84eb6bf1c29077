"""Keeping originals and rows in step."""

from __future__ import annotations

import sqlalchemy as sa
import structlog

from app.blobs.local import LocalBlobs, StagedBlob
from app.errors import ServiceError
from app.records.database import Database
from app.records.tables import Measurement

log = structlog.get_logger(__name__)


def remove_unreferenced(database: Database, blobs: LocalBlobs, sha256: str) -> None:
    """Delete an original unless a measurement of any session still names it."""
    with blobs.guard(sha256), database.read() as records:
        if records.scalar(sa.select(Measurement.id).where(Measurement.sha256 == sha256).limit(1)) is None:
            blobs.remove(sha256)


def restore_original(database: Database, blobs: LocalBlobs, staged: StagedBlob) -> None:
    """Put an original back that was lost from the disk, now that somebody sent it again."""
    sha256, size = staged.sha256, staged.size
    with blobs.guard(sha256):
        if blobs.holds(sha256, size):
            return
        blobs.publish(staged)
        log.warning("original_restored", sha256=sha256)
        # Its rows may have been deleted since they were looked at.
        remove_unreferenced(database, blobs, sha256)


def tidy_after_failure(database: Database, blobs: LocalBlobs, sha256: str) -> None:
    """Delete an original whose row could not be written; where even that fails it lies there harmlessly.

    The next upload of the same bytes takes its place.
    """
    try:
        remove_unreferenced(database, blobs, sha256)
    except ServiceError as error:
        log.warning("original_without_row", sha256=sha256, code=error.code)
