"""Overlays and thumbnails: calls from the head process, and what the process that draws does with them."""

from app.jobs.painting.image_painter import ImagePainter
from app.jobs.painting.subject import OverlaySubject

__all__ = ["ImagePainter", "OverlaySubject"]
