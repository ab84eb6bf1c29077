"""Which format the bytes are, what their header states, and whether the file is whole."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from core.errors import EmptyImage, ImageTooManyPixels, UndecodableImage, UnsupportedImage
from core.image import bmp, jpeg, png, tiff
from core.image.layout import ByteSource, ImageHeader

DEFAULT_MAX_PIXELS = 100_000_000
"""Largest image accepted by default: four times a common 24 Mpx industrial camera."""
MAX_SIDE_PX = 32_766
"""Longest side of an image: OpenCV interpolates in no longer one (`remap` needs less than 2¹⁵ - 1)."""


@runtime_checkable
class _FormatReader(Protocol):
    """What each format's module offers."""

    def read_header(self, data: ByteSource) -> ImageHeader: ...

    def check_whole(self, data: memoryview) -> None: ...


_READERS: dict[bytes, _FormatReader] = {
    b"\x89PNG\r\n\x1a\n": png,
    b"\xff\xd8\xff": jpeg,
    b"II*\0": tiff,
    b"MM\0*": tiff,
    b"II+\0": tiff,
    b"MM\0+": tiff,
    b"BM": bmp,
}


def read_header(data: bytes | bytearray | ByteSource) -> ImageHeader:
    """Return what magic bytes and header state, without decoding.

    What is read, in time and in memory, is bounded by constants, whatever the file claims.

    Parameters
    ----------
    data
        The file, or as much of its beginning as holds the header; a TIFF may keep its directory at the end.

    Raises
    ------
    EmptyImage
        There are no bytes.
    UnsupportedImage
        Another format than PNG, JPEG, TIFF or BMP, or a variety of these that is not taken (CMYK, float).
    UndecodableImage
        The header is damaged or goes on beyond the bytes given.
    """
    source = memoryview(data) if isinstance(data, bytes | bytearray) else data
    return _reader(source).read_header(source)


def check_whole(data: bytes | bytearray | memoryview) -> None:
    """Raise UndecodableImage unless the file's structure shows that its image is complete.

    Bytes after the end of the image are allowed. The decoder judges the samples themselves.
    """
    view = memoryview(data)
    _reader(view).check_whole(view)


def check_pixels(header: ImageHeader, max_pixels: int) -> None:
    """Raise ImageTooManyPixels where the header states more than `max_pixels` pixels, or more than MAX_SIDE_PX on a
    side.
    """
    if header.pixels > max_pixels:
        raise ImageTooManyPixels(
            f"The image has {header.width_px} x {header.height_px} = {header.pixels} pixels; "
            f"at most {max_pixels} are taken."
        )
    if max(header.width_px, header.height_px) > MAX_SIDE_PX:
        raise ImageTooManyPixels(
            f"The image has {header.width_px} x {header.height_px} pixels; "
            f"at most {MAX_SIDE_PX} are taken along a side.",
            "Bin the image or scale it down. Do not crop it: the lens's middle would no longer be the image's.",
        )


def _reader(data: ByteSource) -> _FormatReader:
    if len(data) == 0:
        raise EmptyImage("There are no bytes.")
    start = bytes(data[:8])
    for magic, reader in _READERS.items():
        if start.startswith(magic):
            return reader
        if magic.startswith(start) and len(data) < len(magic):
            raise UndecodableImage(
                f"The file ends after {len(data)} bytes, inside the magic bytes of an image."
            )
    raise UnsupportedImage("The bytes do not begin like a PNG, JPEG, TIFF or BMP file.")
