"""Small whole image files of every kind, and the pixels in them."""

from __future__ import annotations

import cv2
import numpy as np

from tests.support.image.image_encoders import GREY_PALETTE, bmp, tiff

WIDTH, HEIGHT = 23, 17
RNG = np.random.default_rng(7)
GREY = RNG.integers(0, 256, (HEIGHT, WIDTH), dtype=np.uint8)
GREY16 = RNG.integers(0, 65536, (HEIGHT, WIDTH), dtype=np.uint16)
COLOUR = RNG.integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
RGBA = np.dstack([COLOUR, GREY])


def encode(extension: str, image: np.ndarray, *parameters: int) -> bytes:
    ok, data = cv2.imencode(extension, image, list(parameters))
    assert ok
    return data.tobytes()


def tiff_of(
    order: str, samples: bytes, bits: int, *, big: bool = False, extra: tuple[tuple[int, int], ...] = ()
) -> bytes:
    return tiff(order, [samples], bits, WIDTH, HEIGHT, HEIGHT, big=big, extra=extra)


def bmp_of(
    bits: int, compression: int, pixels: bytes, palette: bytes = b"", *, height: int = HEIGHT
) -> bytes:
    return bmp(bits, compression, pixels, WIDTH, height, palette)


RLE8 = b"".join(b"".join(bytes([1, value]) for value in row) + b"\0\0" for row in GREY[::-1])[:-2] + b"\0\1"

WHOLE = {
    "png grey": encode(".png", GREY),
    "png grey 16": encode(".png", GREY16),
    "png colour": encode(".png", COLOUR),
    "png rgba": encode(".png", RGBA),
    "jpeg grey": encode(".jpg", GREY),
    "jpeg colour": encode(".jpg", COLOUR),
    "jpeg progressive": encode(".jpg", COLOUR, cv2.IMWRITE_JPEG_PROGRESSIVE, 1),
    "jpeg with restarts": encode(".jpg", COLOUR, cv2.IMWRITE_JPEG_RST_INTERVAL, 1),
    "tiff grey": encode(".tif", GREY),
    "tiff grey 16": encode(".tif", GREY16),
    "tiff colour": encode(".tif", COLOUR),
    "tiff plain": encode(".tif", GREY, cv2.IMWRITE_TIFF_COMPRESSION, 1),
    "tiff deflate": encode(".tif", GREY, cv2.IMWRITE_TIFF_COMPRESSION, 8),
    "tiff little": tiff_of("<", GREY.tobytes(), 8),
    "tiff big-endian": tiff_of(">", GREY16.astype(">u2").tobytes(), 16),
    "bigtiff": tiff_of("<", GREY.tobytes(), 8, big=True),
    "bmp grey": encode(".bmp", GREY),
    "bmp colour": encode(".bmp", COLOUR),
    "bmp rgba": encode(".bmp", RGBA),
    "bmp rle8": bmp_of(8, 1, RLE8, GREY_PALETTE),
}
