"""Image files that are refused: cut short, of other formats, too large, empty, damaged; nothing else ever comes out."""

from __future__ import annotations

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
from tests.support.image.image_encoders import png
from tests.support.image.small_files import COLOUR, GREY, HEIGHT, RNG, WHOLE, WIDTH, encode, tiff_of


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


@pytest.mark.parametrize("size", [(32_767, 2), (2, 32_767)])
def test_sides_longer_than_opencv_interpolates_in_are_refused(size: tuple[int, int]) -> None:
    data = cv2.imencode(".png", np.zeros(size, np.uint8))[1].tobytes()
    with pytest.raises(ImageTooManyPixels, match=r"32767.* along a side"):
        decode(data)
    taken = np.zeros(tuple(min(side, 32_766) for side in size), np.uint8)
    assert decode(cv2.imencode(".png", taken)[1].tobytes()).shape == taken.shape
