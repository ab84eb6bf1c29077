"""Image files: what is read of them, what is refused, and that nothing else ever comes out."""

from __future__ import annotations

import re
import struct

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from core.errors import (
    EmptyImage,
    GridposeError,
    ImageTooManyPixels,
    UndecodableImage,
    UnsupportedImage,
)
from core.image import check_pixels, check_whole, decode, read_header
from core.image.jpeg import next_marker
from tests.support.image.image_encoders import GREY_PALETTE, bmp, png, tiff

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
def test_cut_short_anywhere_is_never_decoded(name: str) -> None:
    whole = WHOLE[name]
    for length in range(1, len(whole)):
        with pytest.raises(UndecodableImage):
            decode(whole[:length])


@pytest.mark.parametrize("extension", [".jpg", ".png", ".tif", ".bmp"])
def test_larger_image_cut_short(extension: str) -> None:
    image = cv2.GaussianBlur(RNG.integers(0, 256, (480, 640), dtype=np.uint8), (0, 0), 3)
    whole = encode(extension, image)
    for part in np.linspace(0.02, 0.999, 40):
        with pytest.raises(UndecodableImage):
            decode(whole[: int(part * len(whole))])


@pytest.mark.parametrize("name", WHOLE)
def test_bytes_after_the_end_do_not_matter(name: str) -> None:
    np.testing.assert_array_equal(decode(WHOLE[name] + b"\xff\xd9 appended by a camera"), decode(WHOLE[name]))


def test_jpeg_whose_thumbnail_alone_has_an_end() -> None:
    whole = encode(".jpg", COLOUR)
    thumbnail = encode(".jpg", COLOUR[:8, :8])
    inside = whole[:2] + b"\xff\xe1" + struct.pack(">H", len(thumbnail) + 2) + thumbnail + whole[2:]
    np.testing.assert_array_equal(decode(inside), decode(whole))
    with pytest.raises(UndecodableImage):
        decode(inside[:-10])


def test_no_bytes() -> None:
    for function in (read_header, decode, check_whole):
        with pytest.raises(EmptyImage):
            function(b"")


@pytest.mark.parametrize(
    "data",
    [
        b"GIF89a" + bytes(100),
        b"%PDF-1.7",
        b"RIFF\0\0\0\0WEBPVP8 ",
        b"\0\0\0\x0cjP  \r\n\x87\n",
        b"<svg/>",
        b"P5 1 1 255 x",
        b"#?RADIANCE\n",
        bytes(64),
    ],
)
def test_other_formats(data: bytes) -> None:
    for function in (read_header, decode):
        with pytest.raises(UnsupportedImage):
            function(data)


def test_cmyk_and_float() -> None:
    jpeg = bytearray(WHOLE["jpeg colour"])
    frame = jpeg.index(b"\xff\xc0")
    jpeg[frame + 9] = 4
    with pytest.raises(UnsupportedImage, match="CMYK"):
        read_header(bytes(jpeg))
    with pytest.raises(UnsupportedImage, match="CMYK"):
        read_header(tiff_of("<", bytes(4 * WIDTH * HEIGHT), 8, extra=((262, 5), (277, 4))))
    with pytest.raises(UnsupportedImage, match="floating"):
        read_header(encode(".tif", GREY.astype(np.float32)))
    with pytest.raises(UnsupportedImage, match="bits"):
        read_header(tiff_of(">", bytes(4 * WIDTH * HEIGHT), 32))


def test_bombs_are_refused_by_their_header() -> None:
    row = b"\0" + bytes(20_000 // 8)
    bomb = png(0, 1, row * 20_000, 20_000, 20_000)
    assert len(bomb) < 100_000
    with pytest.raises(ImageTooManyPixels, match="20000 x 20000"):
        decode(bomb)
    bitmap = bytearray(WHOLE["bmp grey"])
    struct.pack_into("<ii", bitmap, 18, 2**31 - 1, 2**31 - 1)
    jpeg = bytearray(WHOLE["jpeg grey"])
    struct.pack_into(">HH", jpeg, jpeg.index(b"\xff\xc0") + 5, 65535, 65535)
    for data in (
        bytes(bitmap),
        bytes(jpeg),
        tiff_of("<", b"", 8, extra=((256, 2**32 - 1), (257, 2**32 - 1))),
    ):
        with pytest.raises(ImageTooManyPixels):
            decode(data)


def test_limit_is_inclusive() -> None:
    header = read_header(WHOLE["png grey"])
    check_pixels(header, WIDTH * HEIGHT)
    with pytest.raises(ImageTooManyPixels):
        check_pixels(header, WIDTH * HEIGHT - 1)
    with pytest.raises(ImageTooManyPixels):
        decode(WHOLE["png grey"], max_pixels=WIDTH * HEIGHT - 1)


def test_pixel_data_that_do_not_fill_the_stated_image() -> None:
    rows = b"".join(b"\0" + row.tobytes() for row in GREY)
    with pytest.raises(UndecodableImage):
        decode(png(0, 8, rows[: len(rows) // 2], WIDTH, HEIGHT))  # every checksum is right
    jpeg = bytearray(WHOLE["jpeg grey"])
    second = jpeg[jpeg.index(b"\xff\xc0") :][:13]
    with pytest.raises(UndecodableImage, match="several"):
        decode(bytes(jpeg[:2] + second + jpeg[2:]))


@pytest.mark.parametrize("extension", [".png", ".jpg", ".tif", ".bmp"])
def test_single_pixel(extension: str) -> None:
    image = decode(encode(extension, np.full((1, 1), 200, dtype=np.uint8)))
    assert image.shape == (1, 1)
    assert abs(int(image[0, 0]) - 200) <= 2


def test_tiff_whose_tag_holds_nothing() -> None:
    data = bytearray(WHOLE["tiff little"])
    entry = data.index(struct.pack("<HHI", 258, 4, 1))
    struct.pack_into("<I", data, entry + 4, 0)
    with pytest.raises(UndecodableImage):
        decode(bytes(data))


def test_no_pixels() -> None:
    with pytest.raises(UndecodableImage, match="0 x 17"):
        read_header(png(0, 8, b"", 0, HEIGHT))


@given(st.binary(max_size=300))
def test_random_bytes(data: bytes) -> None:
    with pytest.raises(GridposeError):
        decode(data)


@settings(max_examples=300)
@given(
    st.sampled_from(sorted(WHOLE)),
    st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255)), min_size=1, max_size=8),
)
def test_damaged_files_give_an_image_of_the_stated_size_or_our_error(
    name: str, damages: list[tuple[int, int]]
) -> None:
    data = bytearray(WHOLE[name])
    for place, value in damages:
        data[place % min(len(data), 200 if value % 2 else len(data))] = value
    try:
        header = read_header(bytes(data))
        image = decode(bytes(data), max_pixels=10**6)
    except GridposeError:
        return
    assert image.shape == (header.height_px, header.width_px)
    assert image.dtype in (np.uint8, np.uint16)


@given(
    st.sampled_from([b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff\xe0", b"II*\0", b"MM\0+", b"BM"]),
    st.binary(max_size=200),
)
def test_right_magic_then_random_bytes(magic: bytes, rest: bytes) -> None:
    with pytest.raises(GridposeError):
        decode(magic + rest)


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
