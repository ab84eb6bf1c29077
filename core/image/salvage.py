"""Damaged files made decodable: what is whole at their beginning, with the rest of the image empty.

For previews alone; nothing is measured in such an image.

Reference: ISO/IEC 15948 (PNG, third edition 2025), 5.3 chunk layout, 7.2 scanlines, 10 compression.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from itertools import islice

from core.image.layout import ImageHeader

_MAX_RAW_BYTES = 1 << 29
"""Largest decompressed image that is put together again."""
_MAX_CHUNKS = 1 << 16
_PIECE = 1 << 12
_JPEG_END = b"\xff\xd9"
_SAMPLES = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
"""Samples of a pixel by PNG's colour type."""


def salvage(data: bytes | bytearray | memoryview, header: ImageHeader) -> bytes:
    """Return a file that decoders take, with as much of the image as the damaged one holds; others are unchanged."""
    whole = bytes(data)
    if header.format == "jpeg":
        return whole + _JPEG_END  # decoders fill in grey for what is missing before the end
    if header.format == "png":
        return _salvage_png(whole) or whole
    return whole


def _salvage_png(data: bytes) -> bytes | None:
    """Return the file with one IDAT of all rows, those that are lost black; None for an interlaced image."""
    chunks = list(islice(_chunks(data), _MAX_CHUNKS))
    width, height, depth, colour_type, _, _, interlace = struct.unpack(">IIBBBBB", chunks[0][1][:13])
    row_bytes = 1 + (width * depth * _SAMPLES.get(colour_type, 4) + 7) // 8
    if interlace or row_bytes * height > _MAX_RAW_BYTES:
        return None
    compressed = b"".join(content for kind, content in chunks if kind == b"IDAT")
    rows = _inflate(compressed, row_bytes * height).ljust(row_bytes * height, b"\0")
    kept = [(kind, content) for kind, content in chunks if kind in (b"IHDR", b"PLTE")]
    written = [*kept, (b"IDAT", zlib.compress(rows, 1)), (b"IEND", b"")]
    return data[:8] + b"".join(_chunk(kind, content) for kind, content in written)


def _chunks(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Yield kind and content of each chunk, the last one as far as it goes."""
    offset = 8
    while offset + 8 <= len(data):
        length = int.from_bytes(data[offset : offset + 4], "big")
        yield data[offset + 4 : offset + 8], data[offset + 8 : offset + 8 + length]
        offset += length + 12


def _inflate(compressed: bytes, most: int) -> bytes:
    """Return what can be decompressed before the first error, at most so many bytes."""
    stream, found, size = zlib.decompressobj(), [], 0
    for begin in range(0, len(compressed), _PIECE):
        try:
            part = stream.decompress(compressed[begin : begin + _PIECE], most - size)
        except zlib.error:
            break
        found.append(part)
        size += len(part)
        if size >= most:
            break
    return b"".join(found)


def _chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
