"""Decoding, after the header and the file's structure have been found right: plain kinds here, the rest by OpenCV."""

from __future__ import annotations

import os

# OpenCV reads this once. The check of the header below decides; this is the second line of defence, and the
# most that any setting can allow.
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(1 << 30))

import cv2
import numpy as np
from jaxtyping import UInt8, UInt16

from core.errors import UndecodableImage
from core.image import bmp, png, tiff
from core.image.codec_messages import codec_messages_logged
from core.image.header import DEFAULT_MAX_PIXELS, check_pixels, check_whole, read_header
from core.image.layout import ImageHeader

# OpenCV writes its opinion of every damaged file to stderr; ours is the exception.
cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)

GreyImage = UInt8[np.ndarray, "h w"] | UInt16[np.ndarray, "h w"]

_FLAGS = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION


def decode(data: bytes | bytearray | memoryview, *, max_pixels: int = DEFAULT_MAX_PIXELS) -> GreyImage:
    """Return the image's grey values, uint8 or (16-bit files) uint16; of a TIFF the first page.

    Colours become luma (.299 R + .587 G + .114 B), transparency is ignored, and so is orientation, of EXIF
    and of TIFF.

    Raises
    ------
    EmptyImage, UnsupportedImage, ImageTooManyPixels
        By the header, before anything is decoded.
    UndecodableImage
        The file is damaged or not whole.
    """
    header = read_header(data)
    check_pixels(header, max_pixels)
    image = _read_plain(memoryview(data), header)
    return _decode_by_opencv(data, header) if image is None else image


def _read_plain(data: memoryview, header: ImageHeader) -> GreyImage | None:
    """Return the pixels of the plain kinds that cameras send, which need no OpenCV, or None for all others."""
    if header.format == "png":
        from core.image import png_pixels  # only those who decode pay for numba and isal

        return png_pixels.read_plain(data, header)
    if header.format == "bmp":
        return bmp.read_plain(data)
    if header.format == "tiff":
        return tiff.read_plain(data)
    return None


def _decode_by_opencv(data: bytes | bytearray | memoryview, header: ImageHeader) -> GreyImage:
    stored = memoryview(data)
    if header.format == "png":
        stored = png.without_compressed_text(stored)
    else:
        check_whole(stored)
    if header.format == "tiff":
        stored = tiff.unturned(stored)
    try:
        with codec_messages_logged():
            image = cv2.imdecode(np.frombuffer(stored, dtype=np.uint8), _FLAGS)
    except (cv2.error, MemoryError) as error:
        raise UndecodableImage(f"The {header.format.upper()} file's pixels cannot be decoded.") from error
    if image is None:
        raise UndecodableImage(f"The {header.format.upper()} file's pixels cannot be decoded.")
    if image.shape != (header.height_px, header.width_px) or image.dtype not in (np.uint8, np.uint16):
        raise UndecodableImage(
            f"The {header.format.upper()} file decodes to an image other than its header states."
        )
    return image
