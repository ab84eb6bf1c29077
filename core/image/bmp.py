"""BMP: header and wholeness.

Reference: Microsoft, "Bitmap Storage": BITMAPFILEHEADER, BITMAPCOREHEADER, BITMAPINFOHEADER to V5.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import UInt8

from core.errors import UndecodableImage, UnsupportedImage
from core.image.layout import ByteSource, ImageHeader, check_dimensions, unpack

_FILE_HEADER_BYTES = 14
_CORE_HEADER_BYTES = 12
_HEADER_SIZES = (_CORE_HEADER_BYTES, 40, 52, 56, 64, 108, 124)
_RGB, _RLE8, _RLE4, _BITFIELDS = range(4)
_BITS = {_RGB: (1, 4, 8, 16, 24, 32), _RLE8: (8,), _RLE4: (4,), _BITFIELDS: (16, 32)}
_SAMPLES = {
    1: (1, 1),
    4: (4, 1),
    8: (8, 1),
    16: (5, 3),
    24: (8, 3),
    32: (8, 4),
}  # bits -> (bits of a sample, channels)
_GREY_SCALE = np.arange(256, dtype=np.uint8)[:, None]


def read_header(data: ByteSource) -> ImageHeader:
    """Return what the information header states."""
    width, height, bits, _, _ = _fields(data)
    depth, channels = _SAMPLES[bits]
    return ImageHeader("bmp", width, height, depth, channels)


def check_whole(data: memoryview) -> None:
    """Check that the pixel array lies within the file; a run-length coded one by its stated size."""
    width, height, bits, compression, stated_bytes = _fields(data)
    (start,) = unpack("<I", data, 10, "the BMP header")
    row_bytes = (width * bits + 31) // 32 * 4
    needed = stated_bytes if compression in (_RLE8, _RLE4) else row_bytes * height
    if start < _FILE_HEADER_BYTES + _CORE_HEADER_BYTES or start + needed > len(data):
        raise UndecodableImage(
            f"The BMP file has {len(data)} bytes where its header asks for {start + needed}."
        )
    if compression in (_RLE8, _RLE4):
        end = start + needed if needed else len(data)
        if bytes(data[end - 2 : end]) != b"\0\1":
            raise UndecodableImage("The BMP file's run-length coded pixels have no end mark.")


def read_plain(data: memoryview) -> UInt8[np.ndarray, "h w"] | None:
    """Return the pixels of a file of 8 bits whose palette is the grey scale, or None where OpenCV is to decode."""
    check_whole(data)
    width, height, bits, compression, _ = _fields(data)
    (start,) = unpack("<I", data, 10, "the BMP header")
    (header_bytes,) = unpack("<I", data, _FILE_HEADER_BYTES, "the BMP header")
    if bits != 8 or compression != _RGB or header_bytes == _CORE_HEADER_BYTES:
        return None
    (colours,) = unpack("<I", data, _FILE_HEADER_BYTES + 32, "the BMP header")
    palette_at = _FILE_HEADER_BYTES + header_bytes
    palette = np.frombuffer(data, dtype=np.uint8)[palette_at : palette_at + 4 * 256]
    if (
        colours not in (0, 256)
        or palette.size != 4 * 256
        or np.any(palette.reshape(256, 4)[:, :3] != _GREY_SCALE)
    ):
        return None
    row_bytes = (width + 3) // 4 * 4
    rows = np.frombuffer(data, dtype=np.uint8, count=row_bytes * height, offset=start).reshape(
        height, row_bytes
    )
    (signed_height,) = unpack("<i", data, _FILE_HEADER_BYTES + 8, "the BMP header")
    return rows[:: 1 if signed_height < 0 else -1, :width].copy()


def _fields(data: ByteSource) -> tuple[int, int, int, int, int]:
    """Return width, height (px), bits of a pixel, compression, stated bytes of the pixel array."""
    (size,) = unpack("<I", data, _FILE_HEADER_BYTES, "the BMP header")
    if size not in _HEADER_SIZES:
        raise UnsupportedImage(f"A BMP information header of {size} bytes is not a standard one.")
    compression = stated_bytes = 0
    if size == _CORE_HEADER_BYTES:
        width, height, _, bits = unpack("<HHHH", data, _FILE_HEADER_BYTES + 4, "the BMP header")
    else:
        width, height, _, bits, compression, stated_bytes = unpack(
            "<iiHHII", data, _FILE_HEADER_BYTES + 4, "the BMP header"
        )
        height = abs(height)  # negative: stored from the top
    check_dimensions(width, height, "BMP")
    if bits not in _BITS.get(compression, ()):
        raise UnsupportedImage(f"BMP with {bits} bits and compression {compression} is not taken.")
    return width, height, bits, compression, stated_bytes
