"""The thumbnail of an image: its grey values, small."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import UInt8

from app.reports.overlay.encoding import encode_drawing

THUMBNAIL_PX = 320
"""Longest side of a thumbnail; a smaller image keeps its size."""


def draw_thumbnail(grey: UInt8[np.ndarray, "h w"]) -> bytes:
    """Return a WebP of the image, its longest side at most `THUMBNAIL_PX`."""
    height, width = grey.shape
    scale = THUMBNAIL_PX / max(height, width)
    if scale < 1.0:
        size = (max(1, round(width * scale)), max(1, round(height * scale)))
        grey = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
    return encode_drawing(grey, "image/webp")
