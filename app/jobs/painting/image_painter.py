"""Overlays and thumbnails, drawn in processes of their own; calls wait in bounded queues."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from app.errors import ServiceError, Unavailable
from app.jobs.call_queue import CallQueue, QueueFull
from app.jobs.painting.subject import OverlaySubject
from app.jobs.painting.worker import paint_overlay, paint_thumbnail
from app.jobs.subprocess_executor import Limits, ProcessDied, TimedOut
from app.jobs.worker_init import start_thumbnails

if TYPE_CHECKING:  # the head process does without OpenCV
    from app.reports.overlay import MediaType

TIMEOUT_S = 30.0
MAX_OVERLAYS = 32
"""Overlays that wait or are drawn; each holds a thread of the head process. Of them no key has more than half."""
MAX_THUMBNAILS = 1024
"""Thumbnails that wait or are drawn, each some kB of the head process; half of them are a page of the longest list."""


class ImagePainter:
    """Draws what is stored of images: overlays in one process, thumbnails in another, which a list asks for at once.

    `requester` is the id of the key that asks. Every method raises OriginalMissing, OriginalCorrupt where the file's
    hash is not `sha256`, Conflict (`undecodable_image`), Unavailable.
    """

    def __init__(self, max_pixels: int) -> None:
        self._max_pixels = max_pixels
        limits = Limits(TIMEOUT_S)
        self._overlays = CallQueue(max_pixels, processes=1, places=MAX_OVERLAYS, limits=limits)
        self._thumbnails = CallQueue(
            max_pixels, processes=1, places=MAX_THUMBNAILS, limits=limits, initialise=start_thumbnails
        )

    def overlay(
        self,
        path: str,
        sha256: str,
        subject: OverlaySubject,
        width_px: int,
        media_type: MediaType,
        requester: str | None = None,
    ) -> bytes:
        """Return the image at `path` with what was found in it, `width_px` wide."""
        with _failures():
            return _drawn(
                self._overlays.call(
                    requester,
                    paint_overlay,
                    *(path, sha256, subject, width_px, media_type, self._max_pixels),
                )
            )

    async def thumbnail(self, path: str, sha256: str, requester: str | None = None) -> bytes:
        """Return a small WebP of the image at `path`; no thread waits for it."""
        with _failures():
            call = self._thumbnails.submit(requester, paint_thumbnail, path, sha256, self._max_pixels)
            return _drawn(await asyncio.wrap_future(call.future))

    def close(self) -> None:
        """End the processes."""
        self._overlays.close()
        self._thumbnails.close()


@contextmanager
def _failures() -> Iterator[None]:
    """Raise the failures of a queue as those of the service."""
    try:
        yield
    except QueueFull:
        raise Unavailable(
            "Too many overlays or thumbnails are being drawn.", "Ask again shortly.", code="busy"
        ) from None
    except TimedOut as error:
        raise Unavailable(
            "The image could not be drawn in time.", "Ask again when the server is less busy."
        ) from error
    except ProcessDied as error:
        raise Unavailable(
            "The process that draws images ended unexpectedly.",
            "Ask again; if it happens again, the server may be short of memory.",
        ) from error


def _drawn(answer: bytes | ServiceError) -> bytes:
    if isinstance(answer, ServiceError):
        raise answer
    return answer
