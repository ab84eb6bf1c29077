"""PNG: header and wholeness.

Reference: W3C, "Portable Network Graphics (PNG) Specification (Third Edition)", 2025, sections 5 and 11.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from typing import NamedTuple

from core.errors import UndecodableImage, UnsupportedImage
from core.image.layout import ByteSource, ImageHeader, check_dimensions, unpack

_SIGNATURE_BYTES = 8
_ANCILLARY = 1 << 5  # in the name's first byte: not needed for the pixels (section 5.4)
_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
_DEPTHS = {0: (1, 2, 4, 8, 16), 2: (8, 16), 3: (1, 2, 4, 8), 4: (8, 16), 6: (8, 16)}
_CHUNK, _CRC = struct.Struct(">I4s"), struct.Struct(">I")
_MAX_CHUNKS = 1 << 17
"""Encoders write 8 kB at a time or more; millions of empty chunks attack the reader's memory."""


_MAX_OTHER_CHUNKS = 1 << 12
"""Chunks that hold no pixels."""
_COMPRESSED_TEXT = (b"zTXt", b"iTXt", b"iCCP")


class Chunk(NamedTuple):
    """A chunk's name and where its body lies in the file."""

    name: bytes
    start: int
    end: int


def read_header(data: ByteSource) -> ImageHeader:
    """Return what the IHDR chunk states (section 11.2.1)."""
    (length,) = unpack(">I4x", data, _SIGNATURE_BYTES, "the PNG header")
    if bytes(data[_SIGNATURE_BYTES + 4 : _SIGNATURE_BYTES + 8]) != b"IHDR" or length != 13:
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
    """Check chunks and checksums up to IEND; the compressed stream's own end is watched by the decoder."""
    read_chunks(data, zlib.crc32)


def read_chunks(data: memoryview, crc32: Callable[[memoryview], int]) -> list[Chunk]:
    """Return the chunks from IHDR to IEND, pixels among them.

    The checksums of those that matter for the pixels must be right (section 5.3); `crc32` computes them.
    """
    chunks: list[Chunk] = []
    others = 0
    start = _SIGNATURE_BYTES + 8
    while not chunks or chunks[-1].name != b"IEND":
        if start > len(data):
            raise UndecodableImage("The file ends inside the PNG file's chunks.")
        length, name = _CHUNK.unpack_from(data, start - 8)
        end = start + length
        if end + 4 > len(data):
            raise UndecodableImage(
                f"The PNG file ends inside a chunk, at {len(data)} of at least {end + 4} bytes."
            )
        if not name[0] & _ANCILLARY and crc32(data[start - 4 : end]) != _CRC.unpack_from(data, end)[0]:
            raise UndecodableImage("The checksum of a PNG chunk is wrong.")
        others += name != b"IDAT"
        if len(chunks) == _MAX_CHUNKS or others > _MAX_OTHER_CHUNKS:
            raise UndecodableImage(
                f"The PNG file has more than {_MAX_CHUNKS} chunks, or more than {_MAX_OTHER_CHUNKS} without pixels."
            )
        chunks.append(Chunk(name, start, end))
        start = end + 12
    pixels = [k for k, chunk in enumerate(chunks) if chunk.name == b"IDAT"]
    if not pixels:
        raise UndecodableImage("The PNG file holds no pixels.")
    if pixels[-1] - pixels[0] >= len(pixels):  # section 5.6
        raise UndecodableImage("The PNG file's pixels are interrupted by another chunk.")
    return chunks


def without_compressed_text(data: memoryview) -> memoryview:
    """Return the file, which is checked to be whole, without texts that libpng would inflate (1,000 of 8 MB)."""
    chunks = read_chunks(data, zlib.crc32)
    if not any(chunk.name in _COMPRESSED_TEXT for chunk in chunks):
        return data
    kept = [data[chunk.start - 8 : chunk.end + 4] for chunk in chunks if chunk.name not in _COMPRESSED_TEXT]
    return memoryview(b"".join([data[:_SIGNATURE_BYTES], *kept]))
