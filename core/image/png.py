"""PNG: header and wholeness.

Reference: W3C, "Portable Network Graphics (PNG) Specification (Third Edition)", 2025, sections 5 and 11.
"""

from __future__ import annotations

import zlib

from core.errors import UndecodableImage, UnsupportedImage
from core.image.layout import ImageHeader, check_dimensions, unpack

_SIGNATURE_BYTES = 8
_IHDR, _IDAT, _IEND = (int.from_bytes(name) for name in (b"IHDR", b"IDAT", b"IEND"))
_ANCILLARY = 1 << 29  # bit 5 of the name's first byte: not needed for the pixels (section 5.4)
_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
_DEPTHS = {0: (1, 2, 4, 8, 16), 2: (8, 16), 3: (1, 2, 4, 8), 4: (8, 16), 6: (8, 16)}


def read_header(data: memoryview) -> ImageHeader:
    """Return what the IHDR chunk states (section 11.2.1)."""
    length, name = unpack(">II", data, _SIGNATURE_BYTES, "the PNG header")
    if name != _IHDR or length != 13:
        raise UndecodableImage("The PNG file does not begin with its header chunk.")
    width, height, depth, colour, compression, filtering, interlace, crc = unpack(
        ">IIBBBBBI", data, _SIGNATURE_BYTES + 8, "the PNG header"
    )
    if zlib.crc32(data[12:29]) != crc:
        raise UndecodableImage("The PNG header's checksum is wrong.")
    check_dimensions(width, height, "PNG")
    if depth not in _DEPTHS.get(colour, ()) or compression or filtering or interlace > 1:
        raise UnsupportedImage(f"PNG colour type {colour} with {depth} bits is not a standard one.")
    return ImageHeader("png", width, height, depth, _CHANNELS[colour])


def check_whole(data: memoryview) -> None:
    """Walk the chunks to IEND; the checksums of those that matter for the pixels must be right (section 5.3).

    The compressed stream's own end is watched by the decoder, which fails on a short one.
    """
    offset = _SIGNATURE_BYTES
    has_pixels = False
    while True:
        length, name = unpack(">II", data, offset, "the PNG file's chunks")
        end = offset + 12 + length
        if end > len(data):
            raise UndecodableImage(
                f"The PNG file ends inside a chunk, at {len(data)} of at least {end} bytes."
            )
        if not name & _ANCILLARY:
            (crc,) = unpack(">I", data, end - 4, "a PNG chunk")
            if zlib.crc32(data[offset + 4 : end - 4]) != crc:
                raise UndecodableImage("The checksum of a PNG chunk is wrong.")
        has_pixels |= name == _IDAT
        if name == _IEND:
            break
        offset = end
    if not has_pixels:
        raise UndecodableImage("The PNG file holds no pixels.")
