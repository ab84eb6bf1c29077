"""Whether the bytes of an image file are all there, by the structure of its format; pixels are not decoded."""

from __future__ import annotations

import struct

_PNG = b"\x89PNG\r\n\x1a\n"
_TIFF_LAYOUTS = {b"II*\0": "<", b"MM\0*": ">"}
_TIFF_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8}
_STRIPS, _TILES = (273, 279), (324, 325)
_MAX_ENTRIES = 1 << 20


def why_incomplete(data: bytes) -> str | None:
    """Return why a file is not whole, or None where it is, or where its format is unknown: the service judges that."""
    if not data:
        return "it is empty"
    if any(magic.startswith(data) for magic in (_PNG, b"\xff\xd8", b"BM", *_TIFF_LAYOUTS)):
        return "it ends within its signature"
    try:
        if data.startswith(_PNG):
            return _png(data)
        if data.startswith(b"\xff\xd8"):
            return _jpeg(data)
        if data[:4] in _TIFF_LAYOUTS:
            return _tiff(data, _TIFF_LAYOUTS[data[:4]])
        if data.startswith(b"BM"):
            return _bmp(data)
    except (struct.error, IndexError):
        return "it ends within its header"
    return None


def _png(data: bytes) -> str | None:
    position = len(_PNG)
    while position < len(data):
        length, kind = struct.unpack_from(">I4s", data, position)
        position += 12 + length
        if position > len(data):
            return f"it ends within its {kind.decode('latin-1')} chunk"
        if kind == b"IEND":
            return None
    return "it has no end"


def _jpeg(data: bytes) -> str | None:
    """Segments are passed over by their lengths, so that the end of an embedded thumbnail is not taken for the end."""
    position = 2
    while True:
        if data[position] != 0xFF:
            return None  # not a sequence of segments: damaged, not short
        while data[position] == 0xFF:
            position += 1
        marker = data[position]
        position += 1
        if marker == 0xD9:
            return None
        if marker == 0x01 or 0xD0 <= marker <= 0xD7:
            continue
        (length,) = struct.unpack_from(">H", data, position)
        position += length
        if marker == 0xDA:  # pixels follow, in which FF D9 is nothing but the end
            return None if data.find(b"\xff\xd9", position) >= 0 else "its pixels end early"


def _tiff(data: bytes, order: str) -> str | None:
    (directory,) = struct.unpack_from(f"{order}I", data, 4)
    (count,) = struct.unpack_from(f"{order}H", data, directory)
    fields: dict[int, tuple[int, ...]] = {}
    for number in range(count):
        at = directory + 2 + 12 * number
        tag, kind, values = struct.unpack_from(f"{order}HHI", data, at)
        size = _TIFF_SIZES.get(kind, 1) * values
        place = at + 8 if size <= 4 else struct.unpack_from(f"{order}I", data, at + 8)[0]
        if place + size > len(data):
            return "it ends within its directory"
        if tag in (*_STRIPS, *_TILES) and kind in (3, 4) and values <= _MAX_ENTRIES:
            letter = "H" if kind == 3 else "I"
            fields[tag] = struct.unpack_from(f"{order}{values}{letter}", data, place)
    for offsets, lengths in (_STRIPS, _TILES):
        ends = (o + n for o, n in zip(fields.get(offsets, ()), fields.get(lengths, ()), strict=False))
        if max(ends, default=0) > len(data):
            return "its pixels end early"
    return None


def _bmp(data: bytes) -> str | None:
    (pixels, _, width, height, _, depth, packing) = struct.unpack_from("<IIiiHHI", data, 10)
    if packing:
        return None
    row = (width * depth + 31) // 32 * 4
    return "its pixels end early" if pixels + row * abs(height) > len(data) else None
