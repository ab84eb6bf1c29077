"""A reduced image for looking at: 8-bit grey, in bounded memory, of damaged files as much as can be decoded.

Nothing is measured on a preview. A JPEG file is decoded at the reduced size; other formats are decoded whole.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Shaped, UInt8

from core.errors import UndecodableImage
from core.image.codec_messages import codec_messages_logged
from core.image.decoding import decode
from core.image.header import DEFAULT_MAX_PIXELS, check_pixels, check_whole, read_header
from core.image.layout import ImageHeader
from core.image.salvage import salvage

_GREY = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION
_REDUCED = (
    (8, cv2.IMREAD_REDUCED_GRAYSCALE_8),
    (4, cv2.IMREAD_REDUCED_GRAYSCALE_4),
    (2, cv2.IMREAD_REDUCED_GRAYSCALE_2),
)
_BRIGHT_QUANTILE = 99.5  # per cent of the pixels are no brighter than what counts as white
_DARK_LEVEL, _WHITE_LEVEL = 80.0, 230.0
"""An image whose white is below the first is shown with its white at the second."""
_MAX_BRIGHTENING = 32.0
_SAMPLES = 100_000


@dataclass(frozen=True, slots=True)
class Preview:
    """A reduced image.

    `grey` holds the pixels, `image_width_px` and `image_height_px` the size of the image itself, `brightening` what its
    grey values were multiplied by to be seen, beyond full scale to full scale. `is_whole` is False where the file is
    damaged and the rest of the image is missing.
    """

    grey: UInt8[np.ndarray, "h w"]
    image_width_px: int
    image_height_px: int
    brightening: float
    is_whole: bool


def decode_preview(
    data: bytes | bytearray | memoryview,
    *,
    longest_side_px: int,
    max_pixels: int = DEFAULT_MAX_PIXELS,
) -> Preview:
    """Return the image reduced to `longest_side_px`, or as it is where it is smaller.

    Raises as `core.image.decode` does; UndecodableImage only where no pixel of a damaged file can be decoded.
    """
    header = read_header(data)
    check_pixels(header, max_pixels)
    is_whole = True
    if header.format == "jpeg":
        try:
            check_whole(data)
        except UndecodableImage:
            is_whole = False
        grey = _decode_reduced(data if is_whole else salvage(data, header), header, longest_side_px)
    else:
        try:
            grey = decode(data, max_pixels=max_pixels)
        except UndecodableImage:
            grey = _decode_reduced(salvage(data, header), header, longest_side_px)
            is_whole = False
    scale = longest_side_px / max(header.width_px, header.height_px)
    if max(grey.shape) > longest_side_px:
        size = (max(1, round(header.width_px * scale)), max(1, round(header.height_px * scale)))
        grey = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
    shown, brightening = _eight_bit(grey)
    return Preview(shown, header.width_px, header.height_px, brightening, is_whole)


def _decode_reduced(
    data: bytes | bytearray | memoryview, header: ImageHeader, longest_side_px: int
) -> Shaped[np.ndarray, "h w"]:
    """Return what OpenCV decodes; of a JPEG file reduced by a power of two."""
    flags, reduction = _GREY, 1
    if header.format == "jpeg":
        longest = max(header.width_px, header.height_px)
        reduction, flags = next(
            (
                (by, flag | cv2.IMREAD_IGNORE_ORIENTATION)
                for by, flag in _REDUCED
                if longest >= by * longest_side_px
            ),
            (1, _GREY),
        )
    try:
        with codec_messages_logged():
            grey = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), flags)
    except (cv2.error, MemoryError) as error:
        raise UndecodableImage(f"The {header.format.upper()} file's pixels cannot be decoded.") from error
    expected = (-(-header.height_px // reduction), -(-header.width_px // reduction))
    if grey is None or grey.shape != expected:
        raise UndecodableImage(f"The {header.format.upper()} file's pixels cannot be decoded.")
    return np.asarray(grey)


def _eight_bit(grey: Shaped[np.ndarray, "h w"]) -> tuple[UInt8[np.ndarray, "h w"], float]:
    """Return grey values of 8 bits, a dark image brightened, and by how much."""
    full_scale = 65535.0 if grey.dtype == np.uint16 else 255.0
    sample = grey.ravel()[:: max(1, grey.size // _SAMPLES)]
    white = 255.0 / full_scale * float(np.percentile(sample, _BRIGHT_QUANTILE))
    brightening = 1.0
    if white < _DARK_LEVEL:
        brightening = min(_WHITE_LEVEL / max(white, 1.0), _MAX_BRIGHTENING)
    if full_scale == 255.0 and brightening == 1.0:
        return grey, 1.0
    return cv2.convertScaleAbs(grey, alpha=brightening * 255.0 / full_scale), brightening
