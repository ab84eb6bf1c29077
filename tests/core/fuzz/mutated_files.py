"""Damaged image files, each made from its number alone: bytes flipped, cut and spliced, and surgery on each format's
own structure with the checksums put right, so that the damage gets past the outer checks."""

from __future__ import annotations

import functools

import cv2
import numpy as np

from tests.core.fuzz.byte_mutations import (
    Rng,
    bytes_changed,
    cut_short,
    part_overwritten,
    part_removed,
    part_repeated,
)
from tests.core.fuzz.format_surgery import SURGERY
from tests.support.image.image_encoders import (
    GREY_PALETTE,
    bmp,
    bmp_rows,
    filtered,
    png,
    tiff,
)


def mutated_file(number: int) -> bytes:
    """Return the damaged file of this number."""
    rng = np.random.default_rng([1, number])
    names = list(whole_files())
    name = names[rng.integers(len(names))]
    data = whole_files()[name]
    surgery = SURGERY[name.split()[0]]
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


def _spliced(data: bytes, rng: Rng) -> bytes:
    others = list(whole_files().values())
    other = others[rng.integers(len(others))]
    return data[: rng.integers(1, len(data) + 1)] + other[rng.integers(len(other)) :]


_ANY_FORMAT = (bytes_changed, cut_short, part_removed, part_repeated, part_overwritten, _spliced)
