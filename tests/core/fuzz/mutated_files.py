"""Damaged image files, each made from its number alone: bytes flipped, cut and spliced, and surgery on each format's
own structure with the checksums put right, so that the damage gets past the outer checks."""

from __future__ import annotations

import functools
import struct
import zlib
from collections.abc import Callable

import cv2
import numpy as np

from tests.support.image.image_encoders import (
    GREY_PALETTE,
    SIGNATURE,
    bmp,
    bmp_rows,
    chunk,
    filtered,
    idats,
    png,
    tiff,
)

Rng = np.random.Generator


def mutated_file(number: int) -> bytes:
    """Return the damaged file of this number."""
    rng = np.random.default_rng([1, number])
    names = list(whole_files())
    name = names[rng.integers(len(names))]
    data = whole_files()[name]
    surgery = _SURGERY[name.split()[0]]
    for _ in range(1 + rng.geometric(0.6)):
        mutation = surgery if rng.random() < 0.6 else _ANY_FORMAT[rng.integers(len(_ANY_FORMAT))]
        data = mutation(data, rng)
    return data


@functools.cache
def whole_files() -> dict[str, bytes]:
    """Return whole files of every kind: one pixel, a few, and a small chessboard."""
    files = {}
    for size in ((1, 1), (17, 23), (120, 160)):
        y, x = np.mgrid[: size[0], : size[1]]
        rng = np.random.default_rng(size)
        grey = np.where((x // 14 + y // 14) % 2 == 0, 60, 190) + rng.integers(-5, 6, size)
        grey = grey.astype(np.uint8)
        files |= {f"{name} {size[1]}x{size[0]}": data for name, data in _written(grey, rng).items()}
    return files


def _written(grey: np.ndarray, rng: Rng) -> dict[str, bytes]:
    height, width = grey.shape
    deep = grey.astype(np.uint16) * 257
    colour = cv2.merge([grey, 255 - grey, grey // 2])
    four = cv2.merge([grey, grey // 3, 255 - grey, 255 - grey])
    kinds = list(rng.integers(0, 5, height))
    strips = [grey[first : first + 5].tobytes() for first in range(0, height, 5)]
    deep_strips = [deep[first : first + 7].astype(">u2").tobytes() for first in range(0, height, 7)]
    runs = (
        b"".join(b"".join(bytes([1, value]) for value in row) + b"\0\0" for row in grey[::-1])[:-2] + b"\0\1"
    )

    def encoded(extension: str, image: np.ndarray, *options: int) -> bytes:
        return cv2.imencode(extension, image, options)[1].tobytes()

    files = {
        "png all filters": png(0, 8, filtered(grey, kinds), width, height),
        "png in pieces": png(0, 8, filtered(grey, kinds), width, height, cuts=range(9, 20_000, 97)),
        "png with texts": png(
            0, 8, filtered(grey, kinds), width, height, extra=[(b"gAMA", b"\0\0\1\0"), (b"tEXt", b"a\0b")]
        ),
        "png grey": encoded(".png", grey),
        "png 16": encoded(".png", deep),
        "png colour": encoded(".png", colour),
        "png alpha": encoded(".png", four),
        "png palette": png(3, 8, filtered(grey, kinds), width, height, bytes(range(256)) * 3),
        "png bits": encoded(".png", grey, cv2.IMWRITE_PNG_BILEVEL, 1),
        "jpeg grey": encoded(".jpg", grey),
        "jpeg colour": encoded(".jpg", colour),
        "jpeg progressive": encoded(".jpg", colour, cv2.IMWRITE_JPEG_PROGRESSIVE, 1),
        "jpeg restarts": encoded(".jpg", grey, cv2.IMWRITE_JPEG_RST_INTERVAL, 2),
        "bmp grey": encoded(".bmp", grey),
        "bmp top": bmp(8, 0, bmp_rows(grey), width, -height, GREY_PALETTE),
        "bmp runs": bmp(8, 1, runs, width, height, GREY_PALETTE),
        "bmp colour": encoded(".bmp", colour),
        "bmp alpha": encoded(".bmp", four),
        "tiff strips": tiff("<", strips, 8, width, height, 5, gap=1),
        "tiff 16": tiff(">", deep_strips, 16, width, height, 7),
        "tiff big": tiff("<", strips, 8, width, height, 5, big=True),
        "tiff lzw": encoded(".tif", grey),
        "tiff 16 deflate": encoded(".tif", deep, cv2.IMWRITE_TIFF_COMPRESSION, 8),
        "tiff runs": encoded(".tif", grey, cv2.IMWRITE_TIFF_COMPRESSION, 32773),
        "tiff colour": encoded(".tif", colour),
    }
    return files


def _bytes_changed(data: bytes, rng: Rng) -> bytes:
    changed = bytearray(data)
    begin = min(64, len(data)) if rng.random() < 0.5 else len(data)  # the beginning decides most
    for _ in range(rng.integers(1, 9)):
        place = rng.integers(begin)
        changed[place] = _odd_byte(rng) if rng.random() < 0.5 else changed[place] ^ (1 << rng.integers(8))
    return bytes(changed)


def _cut_short(data: bytes, rng: Rng) -> bytes:
    return data[: rng.integers(1, len(data) + 1)]


def _part_removed(data: bytes, rng: Rng) -> bytes:
    begin, end = np.sort(rng.integers(0, len(data) + 1, 2))
    return data[:begin] + data[min(end, begin + 40) :] or b"\0"


def _part_repeated(data: bytes, rng: Rng) -> bytes:
    begin, end = np.sort(rng.integers(0, len(data) + 1, 2))
    return data[:end] + data[begin:end][:4000] * rng.integers(1, 4) + data[end:]


def _part_overwritten(data: bytes, rng: Rng) -> bytes:
    begin = rng.integers(len(data))
    size = min(len(data) - begin, rng.integers(1, 30))
    return data[:begin] + bytes([_odd_byte(rng)]) * size + data[begin + size :]


def _spliced(data: bytes, rng: Rng) -> bytes:
    others = list(whole_files().values())
    other = others[rng.integers(len(others))]
    return data[: rng.integers(1, len(data) + 1)] + other[rng.integers(len(other)) :]


_ANY_FORMAT = (_bytes_changed, _cut_short, _part_removed, _part_repeated, _part_overwritten, _spliced)


def _odd_byte(rng: Rng) -> int:
    return int(rng.choice([0, 1, 2, 3, 4, 5, 8, 16, 127, 128, 254, 255, rng.integers(256)]))


def _odd_number(rng: Rng, bits: int) -> int:
    near = int(rng.choice([0, 1, 2, 3, 7, 8, 100, 1000, 5000, 65_535, 2**31 - 1, 2**31, 2**32 - 1, 2**63]))
    return (near + int(rng.integers(-2, 3))) % 2**bits


def _png_surgery(data: bytes, rng: Rng) -> bytes:
    """Change chunks, or the stream inside them, and put the checksums right."""
    chunks = _png_chunks(data)
    if not chunks:
        return _bytes_changed(data, rng)
    at = rng.integers(len(chunks))
    name, body = chunks[at]
    operation = rng.integers(9)
    if operation == 0 and body:
        chunks[at] = (name, _bytes_changed(body, rng))
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
        header[field] = _odd_number(rng, 32) if field < 2 else int(rng.choice([0, 1, 2, 3, 4, 6, 8, 16]))
        chunks[0] = (b"IHDR", struct.pack(">IIBBBBB", *header))
    elif operation == 6:
        body = b"".join(body for name, body in chunks if name == b"IDAT")
        return _png_with_stream(chunks, _bytes_changed(body, rng) if body else b"\x78", rng)
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
    mutation = [_bytes_changed, _cut_short, _part_removed, _part_repeated, lambda rows, _: rows][
        rng.integers(5)
    ]
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
        return _bytes_changed(data, rng)
    begin, end = places[rng.integers(len(places))]
    segment = bytearray(data[begin:end])
    operation = rng.integers(5)
    if operation <= 1 and len(segment) > 4:
        for _ in range(rng.integers(1, 4)):
            segment[rng.integers(4, len(segment))] = _odd_byte(rng)
    elif operation == 2:
        segment *= int(rng.integers(0, 3))
    elif operation == 3:
        other_begin, other_end = places[rng.integers(len(places))]
        segment += data[other_begin:other_end]
    else:
        segment[1 if rng.random() < 0.5 else rng.integers(len(segment))] = _odd_byte(rng)
    return data[:begin] + bytes(segment) + data[end:]


def _tiff_surgery(data: bytes, rng: Rng) -> bytes:
    """Change an entry of the directory: its tag, type, count or value."""
    order = "<" if data[:2] == b"II" else ">"
    if len(data) < 16:
        return _bytes_changed(data, rng)
    big = data[2:4] in (b"+\0", b"\0+")
    (directory,) = struct.unpack_from(order + ("Q" if big else "I"), data, 8 if big else 4)
    count_layout, entry = ("Q", 20) if big else ("H", 12)
    start = directory + struct.calcsize("=" + count_layout)
    if start + entry > len(data):
        return _bytes_changed(data, rng)
    (count,) = struct.unpack_from(order + count_layout, data, directory)
    fitting = min(count, (len(data) - start) // entry)
    if fitting == 0:
        return _bytes_changed(data, rng)
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
        struct.pack_into(order + number, changed, at + 4, _odd_number(rng, bits))
    else:
        struct.pack_into(order + number, changed, at + 4 + bits // 8, _odd_number(rng, bits))
    return bytes(changed)


def _bmp_surgery(data: bytes, rng: Rng) -> bytes:
    """Change a field of the two headers."""
    if len(data) < 54:
        return _bytes_changed(data, rng)
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
        else _odd_number(rng, 8 * struct.calcsize(layout))
    )
    if place == 22 and rng.random() < 0.5:
        value = -struct.unpack_from("<i", data, 22)[0] % 2**32
    struct.pack_into("<" + layout, changed, place, value)
    return bytes(changed)


_SURGERY: dict[str, Callable[[bytes, Rng], bytes]] = {
    "png": _png_surgery,
    "jpeg": _jpeg_surgery,
    "tiff": _tiff_surgery,
    "bmp": _bmp_surgery,
}
