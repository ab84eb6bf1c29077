"""Image files whose headers claim far more than the files hold, each made from its number alone.

Lists as long as the file in every entry of a TIFF directory, JPEG segments and PNG chunks without content by the
hundred thousand, dimensions and offsets at the ends of their ranges.
"""

from __future__ import annotations

import struct
import zlib

import numpy as np

from tests.support.image.image_encoders import GREY_PALETTE, SIGNATURE, chunk

Rng = np.random.Generator

TIFF_TAGS = (256, 257, 258, 259, 262, 266, 273, 274, 277, 278, 279, 284, 317, 322, 323, 324, 325, 339)
"""Every tag whose values are read."""
_OTHER_TAGS = (
    254,
    269,
    282,
    283,
    296,
    301,
    320,
    330,
    333,
    338,
    340,
    347,
    529,
    532,
    700,
    33723,
    34377,
    34665,
    34675,
)
_KINDS = {
    1: 1,
    2: 1,
    3: 2,
    4: 4,
    5: 8,
    6: 1,
    7: 1,
    8: 2,
    9: 4,
    10: 8,
    11: 4,
    12: 8,
    13: 4,
    16: 8,
    17: 8,
    18: 8,
}
_SHORT, _LONG = 3, 4


def greedy_tiff(size: int, *, order: str = "<", big: bool = False, kind: int = _SHORT) -> bytes:
    """Return a TIFF of about `size` bytes in which every tag's list is as long as the file, all over the same bytes."""
    entries = [(tag, kind, size // _KINDS[kind], 16 if big else 8) for tag in TIFF_TAGS]
    body = np.random.default_rng(size).integers(0, 256, size, dtype=np.uint8).tobytes()
    return tiff_directory(order, big, entries, body)


def tiff_directory(order: str, big: bool, entries: list[tuple[int, int, int, int]], body: bytes) -> bytes:
    """Return a TIFF of `body` and a directory of (tag, type, count, value or place) at its end."""
    link, count, head = ("Q", "Q", 16) if big else ("I", "H", 8)
    mark = b"II" if order == "<" else b"MM"
    start = mark + struct.pack(
        order + ("HHHQ" if big else "HI"), *((43, 8, 0) if big else (42,)), head + len(body)
    )
    directory = struct.pack(order + count, len(entries))
    directory += b"".join(struct.pack(f"{order}HH{link}{link}", *entry) for entry in entries)
    return start + body + directory + bytes(struct.calcsize(link))


def empty_segments(size: int, segment: bytes = b"\xff\xe0\0\2") -> bytes:
    """Return a JPEG of `size` bytes that holds nothing but a segment, without content unless given, again and again."""
    return b"\xff\xd8" + segment * ((size - 2) // len(segment))


def empty_chunks(size: int, *, name: bytes = b"IDAT", header: bool = True) -> bytes:
    """Return a PNG of about `size` bytes that consists of chunks without content."""
    start = SIGNATURE + (chunk(b"IHDR", struct.pack(">IIBBBBB", 64, 64, 8, 0, 0, 0, 0)) if header else b"")
    empty = chunk(name, b"")
    return start + empty * ((size - len(start)) // len(empty)) + chunk(b"IEND", b"")


def hostile_header(number: int) -> bytes:
    """Return the file of this number."""
    rng = np.random.default_rng([3, number])
    make = (_hostile_tiff, _hostile_tiff, _hostile_png, _hostile_jpeg, _hostile_bmp)[rng.integers(5)]
    return make(rng, int(2 ** rng.uniform(6, 18 if rng.random() < 0.95 else 22)))


def _odd(rng: Rng, size: int, bits: int) -> int:
    near = (0, 1, 2, 3, 4, 8, 16, 100, size // 8, size // 4, size // 2, size, 2 * size, 65_535, 10**8)
    near += (2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**64 - 1)
    return (near[rng.integers(len(near))] + (int(rng.integers(-2, 3)) if rng.random() < 0.3 else 0)) % 2**bits


def _body(rng: Rng, size: int) -> bytes:
    kind = rng.integers(4)
    if kind == 0:
        return bytes(size)
    if kind == 1:
        return b"\xff" * size
    if kind == 2:
        return (rng.bytes(int(rng.integers(1, 33))) * size)[:size]
    return rng.bytes(size)


def _hostile_tiff(rng: Rng, size: int) -> bytes:
    big, order = bool(rng.random() < 0.3), "<>"[rng.integers(2)]
    bits = 64 if big else 32
    width, height = (int(2 ** rng.uniform(0, 14)) for _ in range(2))
    entries = {
        256: (_LONG, 1, width),
        257: (_LONG, 1, height),
        258: (_SHORT, 1, 8),
        259: (_SHORT, 1, int(rng.choice([1, 5, 7, 8, 32773]))),
        262: (_SHORT, 1, int(rng.integers(0, 4))),
        277: (_SHORT, 1, 1),
        278: (_LONG, 1, int(rng.choice([1, height, 2**32 - 1]))),
    }
    if order == ">" and not big:  # a short value is in the first bytes of its field
        entries = {
            tag: (kind, n, value << 16 if kind == _SHORT else value)
            for tag, (kind, n, value) in entries.items()
        }
    tables = (324, 325) if rng.random() < 0.4 else (273, 279)
    if tables[0] == 324:
        entries[322], entries[323] = ((_LONG, 1, int(rng.choice([1, 16, width, 30_000]))) for _ in range(2))
    for tag in tables:
        entries[tag] = (
            int(rng.choice([1, 3, 4, 16])),
            int(rng.choice([1, height, width * height, size // 4])),
            16,
        )
    tags = (*TIFF_TAGS, *_OTHER_TAGS)
    for _ in range(rng.choice([0, 1, 2, 4, 2 * len(tags)])):
        tag = tags[rng.integers(len(tags))]
        kind = int(rng.choice([*_KINDS, 0, 14, 99]))
        entries[tag] = (kind, _odd(rng, size, bits), _odd(rng, size, bits))
    listed = [(tag, kind, n % 2**bits, value % 2**bits) for tag, (kind, n, value) in sorted(entries.items())]
    if rng.random() < 0.1:
        listed *= int(rng.integers(2, 5000 // len(listed)))
    return tiff_directory(order, big, listed, _body(rng, size))


def _hostile_png(rng: Rng, size: int) -> bytes:
    width, height = (
        _odd(rng, size, 32) if rng.random() < 0.1 else int(2 ** rng.uniform(0, 12)) for _ in range(2)
    )
    depth, colour = int(rng.choice([1, 8, 8, 8, 16, 3])), int(rng.choice([0, 0, 0, 2, 3, 6]))
    header = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, int(rng.random() < 0.2))
    names = (
        b"IDAT",
        b"tEXt",
        b"zTXt",
        b"iTXt",
        b"iCCP",
        b"PLTE",
        b"tRNS",
        b"eXIf",
        b"abCd",
        b"ABCD",
        b"fdAT",
        b"sPLT",
    )
    stream = zlib.compress(bytes(min(width * height * 2, 1 << 20) + height % 4096), 9)
    packed = zlib.compress(bytes(1 << 20), 9)
    parts = [chunk(b"IHDR", header)]
    room = size
    while room > 0:
        name = names[rng.integers(len(names))]
        content = (b"", stream, b"k\0\0" + packed, b"k\0\1\0\0\0" + packed, rng.bytes(40))[rng.integers(5)]
        repeats = 1 if rng.random() < 0.7 else int(rng.integers(1, 2 + room // (12 + len(content))))
        parts.append(chunk(name, content) * repeats)
        room -= repeats * (12 + len(content)) + 12
    if rng.random() < 0.5:
        parts.append(chunk(b"IDAT", stream))
    data = bytearray(SIGNATURE + b"".join(parts) + chunk(b"IEND", b""))
    if rng.random() < 0.3:  # an impossible length
        struct.pack_into(">I", data, int(rng.choice([8, 33, max(33, len(data) - 12)])), _odd(rng, size, 32))
    return bytes(data)


def _hostile_jpeg(rng: Rng, size: int) -> bytes:
    parts = [b"\xff\xd8"]
    room = size
    while room > 0:
        code = int(rng.choice([0xE0, 0xE1, 0xE2, 0xED, 0xFE, 0xDB, 0xC4, 0xDD, 0x01, 0xFF, 0xFF]))
        length = int(rng.choice([2, 3, 20, 1000, 65_535]))
        if rng.random() < 0.02:
            code, length = 0xD0, 0
        part = b"\xff" + bytes([code])
        if code not in (0x01, 0xFF, 0xD0):
            part += struct.pack(">H", length) + _body(rng, max(0, length - 2))
        repeats = 1 if rng.random() < 0.7 else int(rng.integers(1, 2 + room // len(part)))
        parts.append(part * repeats)
        room -= repeats * len(part)
    width, height = (_odd(rng, size, 16) for _ in range(2))
    count = int(rng.choice([1, 1, 3, 3, 4, 255]))
    frame = struct.pack(">BHHB", int(rng.choice([8, 8, 8, 12])), height, width, count) + b"\1\x11\0" * count
    parts.append(
        bytes([0xFF, int(rng.choice([0xC0, 0xC0, 0xC2, 0xC3]))]) + struct.pack(">H", len(frame) + 2) + frame
    )
    scan = (
        b"\xff\xda" + struct.pack(">HB", 6 + 2 * count, count) + b"\1\0" * count + b"\0\x3f\0" + rng.bytes(8)
    )
    parts.append(scan * int(rng.choice([0, 1, 3, 250])))
    return b"".join(parts) + b"\xff\xd9"


def _hostile_bmp(rng: Rng, size: int) -> bytes:
    header_bytes = int(rng.choice([12, 40, 40, 40, 64, 108, 124, 2**32 - 1]))
    width, height = (
        _odd(rng, size, 32) if rng.random() < 0.2 else int(2 ** rng.uniform(0, 12)) for _ in range(2)
    )
    bits, compression = int(rng.choice([1, 4, 8, 8, 24, 32, 0])), int(rng.choice([0, 0, 0, 1, 2, 3, 2**31]))
    fields = struct.pack("<IIIHHII", header_bytes, width, height, 1, bits, compression, _odd(rng, size, 32))
    if header_bytes == 12:
        fields = struct.pack("<IHHHH", 12, width % 2**16, height % 2**16, 1, bits)
    fields = fields.ljust(min(header_bytes, 124), b"\0")
    start = (14 + len(fields) + 1024) if rng.random() < 0.7 else _odd(rng, size, 32)
    pixels = _body(rng, size) + (b"\0\1" if rng.random() < 0.5 else b"")
    return b"BM" + struct.pack("<IHHI", _odd(rng, size, 32), 0, 0, start) + fields + GREY_PALETTE + pixels
