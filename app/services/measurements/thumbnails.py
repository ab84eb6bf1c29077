"""Thumbnails of images: made once, kept with the original, and removed with it."""

from __future__ import annotations

from starlette.concurrency import run_in_threadpool

from app.blobs.interface import Blobs
from app.jobs.painting import ImagePainter
from app.records.tables import Measurement
from app.services.installation.context import ServiceContext
from app.services.measurements.reading import find_original


async def get_thumbnail(
    installation: ServiceContext, painter: ImagePainter, measurement_id: str, requester: str | None
) -> bytes:
    """Return a small WebP of a measurement's image, made now where none is kept.

    Raises as `ImagePainter.thumbnail` does.
    """
    measurement, path, kept = await run_in_threadpool(_read, installation, measurement_id)
    if kept is not None:
        return kept
    drawn = await painter.thumbnail(path, measurement.sha256, requester)
    await run_in_threadpool(_keep, installation.blobs, measurement, drawn)
    return drawn


def _read(installation: ServiceContext, measurement_id: str) -> tuple[Measurement, str, bytes | None]:
    """Return the measurement, the place of its original, and the thumbnail if one is kept."""
    measurement, path = find_original(installation, measurement_id)
    return measurement, path, installation.blobs.thumbnails.read(measurement.sha256)


def _keep(blobs: Blobs, measurement: Measurement, drawn: bytes) -> None:
    with blobs.lock(measurement.sha256):
        if blobs.exists(measurement.sha256, measurement.bytes):  # one deleted meanwhile leaves no thumbnail
            blobs.thumbnails.write(measurement.sha256, drawn)
