"""A drawing as a file."""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np
from jaxtyping import UInt8

MediaType = Literal["image/png", "image/webp"]

_SETTINGS: dict[MediaType, tuple[str, list[int]]] = {
    "image/png": (".png", [cv2.IMWRITE_PNG_COMPRESSION, 4]),
    "image/webp": (".webp", [cv2.IMWRITE_WEBP_QUALITY, 88]),
}


def encode_drawing(
    drawn: UInt8[np.ndarray, "h w 3"] | UInt8[np.ndarray, "h w"], media_type: MediaType
) -> bytes:
    """Return a drawing as PNG, without loss, or as WebP."""
    ending, settings = _SETTINGS[media_type]
    encoded, buffer = cv2.imencode(ending, drawn, settings)
    if not encoded:
        raise RuntimeError(f"OpenCV has no writer for {media_type}.")
    return bytes(buffer)
