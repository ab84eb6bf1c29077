"""Drawing in a worker process: the original is read, verified and decoded there, never in the head process."""

from __future__ import annotations

from typing import TYPE_CHECKING

from app.blobs.integrity import read_original
from app.errors import Conflict, OriginalCorrupt, OriginalMissing, ServiceError, Unavailable
from app.jobs.painting.subject import OverlaySubject

if TYPE_CHECKING:  # the head process names these functions and does without OpenCV
    from app.reports.overlay import MediaType

_CANDIDATES_SIDE_PX = 1600
"""Longest side of the image in which candidates for grid points are looked for."""


def paint_overlay(
    path: str, sha256: str, subject: OverlaySubject, width_px: int, media_type: MediaType, max_pixels: int
) -> bytes | ServiceError:
    """Return the overlay of what is stored at `path`, or why there is nothing to draw on."""
    from app.jobs.painting.overlay_content import overlay_content
    from app.reports.overlay import draw_overlay, encode_drawing
    from core.errors import ImageError
    from core.image import decode_preview

    try:
        data = read_original(path, sha256)
        preview = decode_preview(
            data, longest_side_px=max(_CANDIDATES_SIDE_PX, 3 * width_px // 2), max_pixels=max_pixels
        )
    except (OriginalMissing, OriginalCorrupt, Unavailable) as error:
        return error
    except ImageError:
        return _undecodable()
    return encode_drawing(draw_overlay(overlay_content(subject, preview), width_px), media_type)


def paint_thumbnail(path: str, sha256: str, max_pixels: int) -> bytes | ServiceError:
    """Return the thumbnail of what is stored at `path`, or why it cannot be drawn."""
    from app.reports.overlay import THUMBNAIL_PX, draw_thumbnail
    from core.errors import ImageError
    from core.image import decode_preview

    try:
        data = read_original(path, sha256)
        preview = decode_preview(data, longest_side_px=THUMBNAIL_PX, max_pixels=max_pixels)
    except (OriginalMissing, OriginalCorrupt, Unavailable) as error:
        return error
    except ImageError:
        return _undecodable()
    return draw_thumbnail(preview.grey)


def _undecodable() -> ServiceError:
    return Conflict(
        "The stored image cannot be decoded, so there is nothing to draw on.",
        "Upload an undamaged image.",
        code="undecodable_image",
    )
