"""BMP and TIFF files decoded without OpenCV: the same pixels, the same refusals; photographs of every kind."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

from core.errors import UndecodableImage
from core.image import bmp, decode, tiff
from tests.support.image import image_encoders as encoders
from tests.support.image.image_encoders import GREY_PALETTE, bmp_rows
from tests.support.image.plain_kinds import SIZES, by_opencv, check_same, noise, read_png, sample_image


def read_bmp(data: bytes) -> np.ndarray | None:
    return bmp.read_plain(memoryview(data))


@pytest.mark.parametrize("size", SIZES)
def test_bmp(size: tuple[int, int]) -> None:
    truth = noise(*size)
    height, width = size
    for gap in (0, 1, 6):
        from_the_top = encoders.bmp(8, 0, bmp_rows(truth), width, -height, GREY_PALETTE, gap=gap)
        from_the_bottom = encoders.bmp(8, 0, bmp_rows(truth[::-1]), width, height, GREY_PALETTE, gap=gap)
        check_same(from_the_top, truth, read_bmp)
        check_same(from_the_bottom, truth, read_bmp)
    check_same(cv2.imencode(".bmp", truth)[1].tobytes(), truth, read_bmp)


def test_bmp_left_to_opencv() -> None:
    truth = noise(17, 23)
    inverted = b"".join(bytes([255 - i] * 3 + [0]) for i in range(256))
    coloured = GREY_PALETTE[:-4] + bytes([255, 254, 255, 0])
    for palette in (inverted, coloured, GREY_PALETTE[: 4 * 200]):
        data = encoders.bmp(8, 0, bmp_rows(truth), 23, 17, palette)
        assert read_bmp(data) is None
        np.testing.assert_array_equal(decode(data), by_opencv(data))
    colour = cv2.imencode(".bmp", cv2.merge([truth] * 3))[1].tobytes()
    assert read_bmp(colour) is None
    np.testing.assert_array_equal(decode(colour), truth)


def read_tiff(data: bytes) -> np.ndarray | None:
    return tiff.read_plain(memoryview(data))


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("big", [False, True])
def test_tiff(order: str, dtype: type, size: tuple[int, int], big: bool) -> None:
    truth = noise(*size, dtype)
    height, width = size
    stored = truth.astype(truth.dtype.newbyteorder(order))
    for rows in {1, 7, height, height + 5}:
        strips = [stored[first : first + rows].tobytes() for first in range(0, height, rows)]
        for gap in (0, 3):
            data = encoders.tiff(order, strips, 8 * truth.itemsize, width, height, rows, big=big, gap=gap)
            check_same(data, truth, read_tiff)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_tiff_by_opencv(dtype: type) -> None:
    truth = sample_image(211, 303, dtype)
    check_same(cv2.imencode(".tif", truth, [cv2.IMWRITE_TIFF_COMPRESSION, 1])[1].tobytes(), truth, read_tiff)
    for compression in (5, 8, 32773):
        data = cv2.imencode(".tif", truth, [cv2.IMWRITE_TIFF_COMPRESSION, compression])[1].tobytes()
        assert read_tiff(data) is None
        np.testing.assert_array_equal(decode(data), truth)


def test_tiff_strips_out_of_order() -> None:
    truth = noise(6, 9)
    swapped = [truth[3:].tobytes(), truth[:3].tobytes()]
    data = bytearray(encoders.tiff("<", swapped, 8, 9, 6, 3))
    places = data.index(struct.pack("<II", 8, 35))
    struct.pack_into("<II", data, places, 35, 8)
    check_same(bytes(data), truth, read_tiff)


@pytest.mark.parametrize("tags", [((262, 0),), ((266, 2),)])
def test_tiff_left_to_opencv(tags: tuple[tuple[int, int], ...]) -> None:
    """White is zero, bits in the other order."""
    data = encoders.tiff("<", [noise(17, 23).tobytes()], 8, 23, 17, 17, extra=tags)
    assert read_tiff(data) is None
    np.testing.assert_array_equal(decode(data), by_opencv(data))


def test_tiff_strip_shorter_than_its_rows() -> None:
    truth = noise(8, 9)
    strips = [truth[:4].tobytes(), truth[4:].tobytes()]
    data = bytearray(encoders.tiff("<", strips, 8, 9, 8, 4))
    sizes = data.index(struct.pack("<II", 36, 36))
    struct.pack_into("<II", data, sizes, 40, 32)
    assert read_tiff(bytes(data)) is None
    expected = by_opencv(bytes(data))
    if expected is None:
        with pytest.raises(UndecodableImage):
            decode(bytes(data))
    else:
        np.testing.assert_array_equal(decode(bytes(data)), expected)


def test_tiff_strip_before_the_file() -> None:
    """A place may be stated as a signed number."""
    data = bytearray(encoders.tiff("<", [noise(17, 23).tobytes()], 8, 23, 17, 17))
    entry = data.index(struct.pack("<HHI", 273, 4, 1))
    struct.pack_into("<HHIi", data, entry, 273, 9, 1, -5)
    with pytest.raises(UndecodableImage):
        decode(bytes(data))


def test_tiff_one_strip_of_all_rows() -> None:
    """Rows in a strip: as many as there can be, which is also what no statement means."""
    truth = noise(17, 23)
    data = encoders.tiff("<", [truth.tobytes()], 8, 23, 17, 17, extra=((278, 2**32 - 1),))
    np.testing.assert_array_equal(decode(data), truth)


@pytest.mark.slow
def test_photographs(data_folder: Path) -> None:
    """Every photograph as it is, and as the plain kinds."""
    paths = [
        path
        for path in sorted(data_folder.rglob("*"))
        if path.suffix.lower() in (".png", ".jpg", ".bmp", ".tif")
    ]
    assert len(paths) > 60
    for path in paths:
        data = path.read_bytes()
        grey = decode(data)
        np.testing.assert_array_equal(grey, by_opencv(data), err_msg=str(path))
        for extension, read in ((".png", read_png), (".bmp", read_bmp)):
            check_same(cv2.imencode(extension, grey)[1].tobytes(), grey, read)
