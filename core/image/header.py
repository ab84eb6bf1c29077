"""Which format the bytes are, what their header states, and whether the file is whole."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from core.errors import EmptyImage, ImageTooManyPixels, UndecodableImage, UnsupportedImage
from core.image import bmp, jpeg, png, tiff
from core.image.layout import ImageHeader

DEFAULT_MAX_PIXELS = 100_000_000
"""Largest picture taken unless the caller says otherwise; four times a common 24 Mpx industrial camera."""

HEADER_BYTES = 256 * 1024
"""So much of a file's beginning usually holds its header: a JPEG's frame comes after its metadata segments.
TIFF may keep its directory at the end: `read_header` then needs the whole file."""


@runtime_checkable
class _FormatReader(Protocol):
    """What each format's module offers."""

    def read_header(self, data: memoryview) -> ImageHeader: ...

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


def read_header(data: bytes | bytearray | memoryview) -> ImageHeader:
    """Return what magic bytes and header state, without decoding.

    Parameters
    ----------
    data
        The file, or as much of its beginning as holds the header (see `HEADER_BYTES`).

    Raises
    ------
    EmptyImage
        There are no bytes.
    UnsupportedImage
        Another format than PNG, JPEG, TIFF or BMP, or a variety of these that is not taken (CMYK, float).
    UndecodableImage
        The header is damaged or goes on beyond the bytes given.
    """
    view = memoryview(data)
    return _reader(view).read_header(view)


def check_whole(data: bytes | bytearray | memoryview) -> None:
    """Raise UndecodableImage unless the file's structure says that all of its picture is there.

    Bytes after the end of the picture are allowed. The samples themselves are for the decoder to judge.
    """
    view = memoryview(data)
    _reader(view).check_whole(view)


def check_pixels(header: ImageHeader, max_pixels: int) -> None:
    """Raise ImageTooManyPixels where the header states more than `max_pixels` pixels."""
    if header.pixels > max_pixels:
        raise ImageTooManyPixels(
            f"The image has {header.width_px} x {header.height_px} = {header.pixels} pixels; "
            f"at most {max_pixels} are taken."
        )


def _reader(data: memoryview) -> _FormatReader:
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
