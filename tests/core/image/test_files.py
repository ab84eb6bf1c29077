"""Image files: what is read of them."""

from __future__ import annotations

import re
import struct

import cv2
import numpy as np
import pytest

from core.errors import (
    UndecodableImage,
)
from core.image import decode, read_header
from core.image.jpeg import next_marker
from tests.support.image.image_encoders import GREY_PALETTE, png
from tests.support.image.small_files import COLOUR, GREY, GREY16, HEIGHT, RNG, WHOLE, WIDTH, bmp_of, encode


@pytest.mark.parametrize(
    ("name", "depth", "channels", "truth"),
    [
        ("png grey", 8, 1, GREY),
        ("png grey 16", 16, 1, GREY16),
        ("tiff grey", 8, 1, GREY),
        ("tiff grey 16", 16, 1, GREY16),
        ("tiff plain", 8, 1, GREY),
        ("tiff deflate", 8, 1, GREY),
        ("tiff little", 8, 1, GREY),
        ("tiff big-endian", 16, 1, GREY16),
        ("bigtiff", 8, 1, GREY),
        ("bmp grey", 8, 1, GREY),
        ("bmp rle8", 8, 1, GREY),
    ],
)
def test_grey_values_come_out_as_they_went_in(
    name: str, depth: int, channels: int, truth: np.ndarray
) -> None:
    header = read_header(WHOLE[name])
    assert (header.width_px, header.height_px, header.bit_depth, header.channels) == (
        WIDTH,
        HEIGHT,
        depth,
        channels,
    )
    image = decode(WHOLE[name])
    assert image.dtype == truth.dtype
    np.testing.assert_array_equal(image, truth)


@pytest.mark.parametrize("name", ["png colour", "png rgba", "tiff colour", "bmp colour", "bmp rgba"])
def test_colour_becomes_luma(name: str) -> None:
    luma = COLOUR.astype(float) @ (0.114, 0.587, 0.299)  # OpenCV's order is blue, green, red
    image = decode(WHOLE[name])
    assert image.dtype == np.uint8
    np.testing.assert_allclose(image.astype(float), luma, atol=1.5)  # some decoders cut in place of rounding


@pytest.mark.parametrize("name", ["jpeg grey", "jpeg colour", "jpeg progressive", "jpeg with restarts"])
def test_jpeg_header(name: str) -> None:
    header = read_header(WHOLE[name])
    assert (header.format, header.width_px, header.height_px, header.bit_depth) == ("jpeg", WIDTH, HEIGHT, 8)
    assert header.channels == (1 if "grey" in name else 3)
    assert decode(WHOLE[name]).shape == (HEIGHT, WIDTH)


def test_palette_and_one_bit() -> None:
    bits = RNG.integers(0, 2, (HEIGHT, WIDTH), dtype=np.uint8)
    rows = b"".join(b"\0" + np.packbits(row).tobytes() for row in bits)
    np.testing.assert_array_equal(decode(png(0, 1, rows, WIDTH, HEIGHT)), bits * 255)
    indices = b"".join(b"\0" + row.tobytes() for row in GREY)
    greys = b"".join(bytes([255 - i] * 3) for i in range(256))
    data = png(3, 8, indices, WIDTH, HEIGHT, greys)
    assert read_header(data).channels == 1
    np.testing.assert_array_equal(decode(data), 255 - GREY)
    stride = (WIDTH + 31) // 32 * 4
    packed = b"".join(np.packbits(row).tobytes().ljust(stride, b"\0") for row in bits[::-1])
    np.testing.assert_array_equal(decode(bmp_of(1, 0, packed, b"\0\0\0\0\xff\xff\xff\0")), bits * 255)


def test_bmp_stored_from_the_top() -> None:
    rows = b"".join(row.tobytes().ljust((WIDTH + 3) // 4 * 4, b"\0") for row in GREY)
    data = bmp_of(8, 0, rows, GREY_PALETTE, height=-HEIGHT)
    assert read_header(data).height_px == HEIGHT
    np.testing.assert_array_equal(decode(data), GREY)


def test_exif_orientation_is_ignored() -> None:
    plain = WHOLE["jpeg grey"]
    exif = b"Exif\0\0MM\0*\0\0\0\x08\0\1" + struct.pack(">HHIHH", 0x0112, 3, 1, 6, 0) + b"\0\0\0\0"
    turned = plain[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + plain[2:]
    upright = cv2.imdecode(np.frombuffer(turned, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert upright.shape == (WIDTH, HEIGHT)  # the tag is one that decoders obey unless asked not to
    np.testing.assert_array_equal(decode(turned), decode(plain))


@pytest.mark.parametrize("name", WHOLE)
def test_header_needs_no_more_than_the_beginning(name: str) -> None:
    whole = WHOLE[name]
    if name.startswith(("tiff", "bigtiff")):  # the directory may stand at the end
        with pytest.raises(UndecodableImage):
            read_header(whole[:8])
    else:
        shortest = next(n for n in range(1, len(whole)) if _header_or_none(whole[:n]) is not None)
        assert shortest < len(whole) - 100
        assert read_header(whole[:shortest]) == read_header(whole)


def _header_or_none(data: bytes) -> object:
    try:
        return read_header(data)
    except UndecodableImage:
        return None


@pytest.mark.parametrize("name", WHOLE)
def test_bytes_after_the_end_do_not_matter(name: str) -> None:
    np.testing.assert_array_equal(decode(WHOLE[name] + b"\xff\xd9 appended by a camera"), decode(WHOLE[name]))


@pytest.mark.parametrize("extension", [".png", ".jpg", ".tif", ".bmp"])
def test_single_pixel(extension: str) -> None:
    image = decode(encode(extension, np.full((1, 1), 200, dtype=np.uint8)))
    assert image.shape == (1, 1)
    assert abs(int(image[0, 0]) - 200) <= 2


def test_views_and_bytearrays_are_taken() -> None:
    for data in (bytearray(WHOLE["png grey"]), memoryview(WHOLE["png grey"])):
        np.testing.assert_array_equal(decode(data), GREY)


@pytest.mark.parametrize("length", [2, 3, 300, 4096, 4097, 4098, 20_000])
def test_the_next_marker_is_found_wherever_it_stands(length: int) -> None:
    """The compiled search against a regular expression: stuffed bytes, restarts and fill bytes are no markers."""
    rng = np.random.default_rng(length)
    scan = rng.choice(np.array([0, 1, 0x7F, 0xFF, 0xD0, 0xD7], dtype=np.uint8), length)
    after = scan[1:]
    after[(scan[:-1] == 0xFF) & (after != 0xFF) & (after < 0xD0)] = 0
    for _ in range(8):
        data = scan.tobytes()
        marker = re.search(rb"\xff[^\x00\xff\xd0-\xd7]", data)
        assert next_marker(np.frombuffer(data, dtype=np.uint8), 0) == (marker.start() if marker else -1)
        at = int(rng.integers(0, length - 1))
        scan[at : at + 2] = 0xFF, rng.choice([0x01, 0xCF, 0xD8, 0xD9, 0xFE])
        found = next_marker(scan, at)
        assert found == at
        assert next_marker(scan, length - 1) == -1
