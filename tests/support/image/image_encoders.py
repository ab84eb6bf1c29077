"""Image files written by hand: kinds, and damages, that no encoder writes."""

from __future__ import annotations

import itertools
import struct
import zlib
from collections.abc import Iterable, Sequence

import numpy as np

SIGNATURE = b"\x89PNG\r\n\x1a\n"


def chunk(name: bytes, body: bytes) -> bytes:
    """Return a PNG chunk with its length and its right checksum."""
    return struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))


def png(
    colour: int,
    depth: int,
    rows: bytes,
    width: int,
    height: int,
    palette: bytes = b"",
    *,
    level: int = 6,
    cuts: Iterable[int] = (),
    extra: Sequence[tuple[bytes, bytes]] = (),
) -> bytes:
    """Write a PNG of filtered rows, its stream cut into IDAT chunks at `cuts`, with extra chunks before them."""
    header = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0)
    body = chunk(b"IHDR", header) + (chunk(b"PLTE", palette) if palette else b"")
    body += b"".join(chunk(name, content) for name, content in extra)
    return SIGNATURE + body + idats(zlib.compress(rows, level), cuts) + chunk(b"IEND", b"")


def idats(stream: bytes, cuts: Iterable[int] = ()) -> bytes:
    """Return a compressed stream as IDAT chunks."""
    places = [0, *sorted(min(cut, len(stream)) for cut in cuts), len(stream)]
    return b"".join(chunk(b"IDAT", stream[a:b]) for a, b in itertools.pairwise(places))


def filtered(samples: np.ndarray, kinds: Sequence[int]) -> bytes:
    """Return an image's bytes with each row filtered by its kind: 0 none, 1 sub, 2 up, 3 average, 4 Paeth."""
    step = samples.dtype.itemsize
    image = samples.astype(samples.dtype.newbyteorder(">")).view(np.uint8).reshape(len(samples), -1)
    padded = np.zeros((image.shape[0] + 1, image.shape[1] + step), dtype=np.int16)
    padded[1:, step:] = image
    left, above, corner = padded[1:, :-step], padded[:-1, step:], padded[:-1, :-step]
    nearest = np.argmin([abs(above - corner), abs(left - corner), abs(left + above - 2 * corner)], axis=0)
    paeth = np.choose(nearest, [left, above, corner])
    predictions = np.stack([np.zeros_like(left), left, above, (left + above) // 2, paeth])
    chosen = predictions[np.asarray(kinds), np.arange(len(image))]
    return b"".join(
        bytes([kind]) + row.tobytes()
        for kind, row in zip(kinds, (image - chosen).astype(np.uint8), strict=True)
    )


def tiff(
    order: str,
    strips: Sequence[bytes],
    bits: int,
    width: int,
    height: int,
    rows_per_strip: int,
    *,
    big: bool = False,
    gap: int = 0,
    extra: tuple[tuple[int, int], ...] = (),
) -> bytes:
    """Write an uncompressed TIFF: strips, `gap` bytes before each, then the directory."""
    letter, kind = ("Q", 16) if big else ("I", 4)
    pixels = bytearray(16 if big else 8)
    offsets = []
    for strip in strips:
        pixels += b"\xee" * gap
        offsets.append(len(pixels))
        pixels += strip
    lists = {273: offsets, 279: [len(strip) for strip in strips]}
    entries: dict[int, tuple[int, int]] = {}
    for tag, values in lists.items():
        entries[tag] = (len(values), values[0] if len(values) == 1 else len(pixels))
        if len(values) > 1:
            pixels += struct.pack(f"{order}{len(values)}{letter}", *values)
    for tag, value in ((256, width), (257, height), (258, bits), (259, 1), (262, 1), (277, 1), *extra):
        entries[tag] = (1, value)
    entries.setdefault(278, (1, rows_per_strip))
    mark = b"II" if order == "<" else b"MM"
    head = struct.pack(order + ("HHHQ" if big else "HI"), *((43, 8, 0) if big else (42,)), len(pixels))
    directory = struct.pack(order + ("Q" if big else "H"), len(entries))
    directory += b"".join(
        struct.pack(f"{order}HH{letter}{letter}", tag, kind, count, value)
        for tag, (count, value) in sorted(entries.items())
    )
    return mark + head + bytes(pixels[16 if big else 8 :]) + directory + bytes(8 if big else 4)


def bmp(
    bits: int, compression: int, pixels: bytes, width: int, height: int, palette: bytes = b"", *, gap: int = 0
) -> bytes:
    """Write a BMP with a 40-byte header, `gap` bytes between palette and pixels."""
    start = 14 + 40 + len(palette) + gap
    info = struct.pack(
        "<IiiHHIIiiII", 40, width, height, 1, bits, compression, len(pixels), 0, 0, len(palette) // 4, 0
    )
    return (
        b"BM" + struct.pack("<IHHI", start + len(pixels), 0, 0, start) + info + palette + bytes(gap) + pixels
    )


def bmp_rows(image: np.ndarray) -> bytes:
    """Return grey rows padded to four bytes."""
    return b"".join(row.tobytes().ljust((row.size + 3) // 4 * 4, b"\xaa") for row in image)


GREY_PALETTE = b"".join(bytes([i, i, i, 0]) for i in range(256))
