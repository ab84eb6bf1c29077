"""Surgery on each format's own structure, with the checksums put right."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable

from tests.core.fuzz.byte_mutations import (
    Rng,
    bytes_changed,
    cut_short,
    odd_byte,
    odd_number,
    part_removed,
    part_repeated,
)
from tests.support.image.image_encoders import (
    SIGNATURE,
    chunk,
    idats,
)


def _png_surgery(data: bytes, rng: Rng) -> bytes:
    """Change chunks, or the stream inside them, and put the checksums right."""
    chunks = _png_chunks(data)
    if not chunks:
        return bytes_changed(data, rng)
    at = rng.integers(len(chunks))
    name, body = chunks[at]
    operation = rng.integers(9)
    if operation == 0 and body:
        chunks[at] = (name, bytes_changed(body, rng))
    elif operation == 1:
        del chunks[at]
    elif operation == 2:
        chunks.insert(rng.integers(len(chunks) + 1), chunks[at])
    elif operation == 3:
        odd = [
            b"tRNS",
            b"gAMA",
            b"sBIT",
            b"bKGD",
            b"acTL",
            b"fcTL",
            b"PLTE",
            b"IDAT",
            b"IEND",
            b"eXIf",
            b"iCCP",
        ]
        chunks.insert(at, (odd[rng.integers(len(odd))], rng.bytes(int(rng.integers(0, 30)))))
    elif operation == 4:
        names = bytearray(name)
        names[rng.integers(4)] ^= 1 << rng.integers(8)
        chunks[at] = (bytes(names), body)
    elif operation == 5 and chunks[0][0] == b"IHDR" and len(chunks[0][1]) == 13:
        header = list(struct.unpack(">IIBBBBB", chunks[0][1]))
        field = rng.integers(7)
        header[field] = odd_number(rng, 32) if field < 2 else int(rng.choice([0, 1, 2, 3, 4, 6, 8, 16]))
        chunks[0] = (b"IHDR", struct.pack(">IIBBBBB", *header))
    elif operation == 6:
        body = b"".join(body for name, body in chunks if name == b"IDAT")
        return _png_with_stream(chunks, bytes_changed(body, rng) if body else b"\x78", rng)
    else:
        return _png_with_stream(chunks, _recompressed(chunks, rng), rng)
    return SIGNATURE + b"".join(chunk(name, body) for name, body in chunks)


def _recompressed(chunks: list[tuple[bytes, bytes]], rng: Rng) -> bytes:
    """Return the stream with other bytes in it: filters that do not exist, rows too few and too many."""
    try:
        rows = zlib.decompressobj().decompress(
            b"".join(body for name, body in chunks if name == b"IDAT"), 1 << 20
        )
    except zlib.error:
        rows = rng.bytes(100)
    mutation = [bytes_changed, cut_short, part_removed, part_repeated, lambda rows, _: rows][rng.integers(5)]
    packer = zlib.compressobj(
        int(rng.integers(0, 10)), wbits=int(rng.integers(9, 16)), strategy=int(rng.integers(5))
    )
    return packer.compress(mutation(rows or b"\0", rng)) + packer.flush()


def _png_with_stream(chunks: list[tuple[bytes, bytes]], stream: bytes, rng: Rng) -> bytes:
    cuts = rng.integers(0, len(stream) + 1, rng.integers(0, 5))
    before = b"".join(chunk(name, body) for name, body in chunks if name not in (b"IDAT", b"IEND"))
    return SIGNATURE + before + idats(stream, list(cuts)) + chunk(b"IEND", b"")


def _png_chunks(data: bytes) -> list[tuple[bytes, bytes]]:
    chunks, at = [], len(SIGNATURE)
    while at + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, at)
        chunks.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + length]))
        at += 12 + length
    return chunks


def _jpeg_surgery(data: bytes, rng: Rng) -> bytes:
    """Change, repeat, drop or move a segment: frame, tables, scan."""
    places, at = [], 2
    while at + 4 <= len(data) and data[at] == 0xFF and data[at + 1] != 0xD9:
        (length,) = struct.unpack_from(">H", data, at + 2)
        places.append((at, at + 2 + length))
        at += 2 + length
        if data[places[-1][0] + 1] == 0xDA:
            while at + 1 < len(data) and not (
                data[at] == 0xFF and data[at + 1] not in (0, *range(0xD0, 0xD8))
            ):
                at += 1
    if not places:
        return bytes_changed(data, rng)
    begin, end = places[rng.integers(len(places))]
    segment = bytearray(data[begin:end])
    operation = rng.integers(5)
    if operation <= 1 and len(segment) > 4:
        for _ in range(rng.integers(1, 4)):
            segment[rng.integers(4, len(segment))] = odd_byte(rng)
    elif operation == 2:
        segment *= int(rng.integers(0, 3))
    elif operation == 3:
        other_begin, other_end = places[rng.integers(len(places))]
        segment += data[other_begin:other_end]
    else:
        segment[1 if rng.random() < 0.5 else rng.integers(len(segment))] = odd_byte(rng)
    return data[:begin] + bytes(segment) + data[end:]


def _tiff_surgery(data: bytes, rng: Rng) -> bytes:
    """Change an entry of the directory: its tag, type, count or value."""
    order = "<" if data[:2] == b"II" else ">"
    if len(data) < 16:
        return bytes_changed(data, rng)
    big = data[2:4] in (b"+\0", b"\0+")
    (directory,) = struct.unpack_from(order + ("Q" if big else "I"), data, 8 if big else 4)
    count_layout, entry = ("Q", 20) if big else ("H", 12)
    start = directory + struct.calcsize("=" + count_layout)
    if start + entry > len(data):
        return bytes_changed(data, rng)
    (count,) = struct.unpack_from(order + count_layout, data, directory)
    fitting = min(count, (len(data) - start) // entry)
    if fitting == 0:
        return bytes_changed(data, rng)
    at = start + entry * int(rng.integers(fitting))
    changed = bytearray(data)
    number, bits = ("Q", 64) if big else ("I", 32)
    field = rng.integers(5)
    if field == 0:
        tags = [
            254,
            256,
            257,
            258,
            259,
            262,
            266,
            273,
            274,
            277,
            278,
            279,
            284,
            317,
            322,
            323,
            324,
            325,
            330,
            339,
        ]
        struct.pack_into(order + "H", changed, at, int(rng.choice(tags)))
    elif field == 1:
        struct.pack_into(order + "H", changed, at + 2, int(rng.integers(0, 18)))
    elif field == 2:
        struct.pack_into(order + number, changed, at + 4, odd_number(rng, bits))
    else:
        struct.pack_into(order + number, changed, at + 4 + bits // 8, odd_number(rng, bits))
    return bytes(changed)


def _bmp_surgery(data: bytes, rng: Rng) -> bytes:
    """Change a field of the two headers."""
    if len(data) < 54:
        return bytes_changed(data, rng)
    changed = bytearray(data)
    layout, place = [
        ("I", 2),
        ("I", 10),
        ("I", 14),
        ("I", 18),
        ("I", 22),
        ("H", 26),
        ("H", 28),
        ("I", 30),
        ("I", 34),
    ][rng.integers(9)]
    value = (
        int(rng.choice([1, 4, 8, 16, 24, 32]))
        if place == 28
        else odd_number(rng, 8 * struct.calcsize(layout))
    )
    if place == 22 and rng.random() < 0.5:
        value = -struct.unpack_from("<i", data, 22)[0] % 2**32
    struct.pack_into("<" + layout, changed, place, value)
    return bytes(changed)


SURGERY: dict[str, Callable[[bytes, Rng], bytes]] = {
    "png": _png_surgery,
    "jpeg": _jpeg_surgery,
    "tiff": _tiff_surgery,
    "bmp": _bmp_surgery,
}
