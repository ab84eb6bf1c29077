"""TIFF whose directory says how rows, columns and planes lie: what is read unturned, and what is refused."""

from __future__ import annotations

import struct
from collections.abc import Callable

import cv2
import numpy as np
import pytest

from core.errors import UndecodableImage, UnsupportedImage
from core.image import decode, read_header, tiff
from tests.support.image import image_encoders as encoders

RNG = np.random.default_rng(11)
SIZE = HEIGHT, WIDTH = 17, 23
GREY = RNG.integers(0, 256, SIZE, dtype=np.uint8)
DEEP = RNG.integers(0, 65536, SIZE, dtype=np.uint16)
COLOUR = RNG.integers(0, 256, (*SIZE, 3), dtype=np.uint8)
DEEP_COLOUR = RNG.integers(0, 65536, (*SIZE, 3), dtype=np.uint16)
LZW = 5
ORIENTATION, SHORT, LONG = 274, 3, 4
FLAGS = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
LUMA = cv2.cvtColor(COLOUR, cv2.COLOR_RGB2GRAY)

TURNED: dict[int, Callable[[np.ndarray], np.ndarray]] = {
    1: lambda image: image,
    2: np.fliplr,
    3: lambda image: image[::-1, ::-1],
    4: np.flipud,
    5: lambda image: image.T,
    6: lambda image: np.rot90(image, -1),
    7: lambda image: image[::-1, ::-1].T,
    8: np.rot90,
}
"""What a stored image looks like to who obeys the tag (TIFF 6.0, section 8)."""


def by_opencv(data: bytes) -> np.ndarray | None:
    return cv2.imdecode(np.frombuffer(data, np.uint8), FLAGS)


def oriented(data: bytes, orientation: int, kind: int = SHORT, times: int = 1) -> bytes:
    """Return the file with its directory copied to the end, with the tag put in or replaced."""
    order = "<" if data[:2] == b"II" else ">"
    big = struct.unpack_from(order + "H", data, 2) == (43,)
    place, number, link, size = (8, "Q", "Q", 20) if big else (4, "H", "I", 12)
    (start,) = struct.unpack_from(order + link, data, place)
    (count,) = struct.unpack_from(order + number, data, start)
    start += struct.calcsize(number)
    entries = [data[at : at + size] for at in range(start, start + count * size, size)]
    value = struct.pack(order + {SHORT: "H", LONG: "I"}[kind], orientation).ljust(8 if big else 4, b"\0")
    added = struct.pack(order + "HH" + link, ORIENTATION, kind, 1) + value
    before = [entry for entry in entries if struct.unpack_from(order + "H", entry) < (ORIENTATION,)]
    after = [entry for entry in entries if struct.unpack_from(order + "H", entry) > (ORIENTATION,)]
    entries = [*before, *[added] * times, *after]
    result = bytearray(data + bytes(len(data) % 2))
    struct.pack_into(order + link, result, place, len(result))
    return bytes(result) + struct.pack(order + number, len(entries)) + b"".join(entries) + bytes(8)


def strips(order: str, image: np.ndarray, big: bool, *extra: tuple[int, int]) -> bytes:
    stored = image.astype(image.dtype.newbyteorder(order))
    parts = [stored[first : first + 5].tobytes() for first in range(0, HEIGHT, 5)]
    return encoders.tiff(order, parts, 8 * image.itemsize, WIDTH, HEIGHT, 5, big=big, extra=extra)


def tiles(order: str, image: np.ndarray, big: bool) -> bytes:
    """Return a TIFF of 16 x 16 tiles."""
    height, width = -(-HEIGHT // 16) * 16, -(-WIDTH // 16) * 16
    padded = np.zeros((height, width), image.dtype.newbyteorder(order))
    padded[:HEIGHT, :WIDTH] = image
    parts = [
        padded[y : y + 16, x : x + 16].tobytes() for y in range(0, height, 16) for x in range(0, width, 16)
    ]
    data = bytearray(
        encoders.tiff(
            order, parts, 8 * image.itemsize, WIDTH, HEIGHT, 16, big=big, extra=((322, 16), (323, 16))
        )
    )
    kind, link = (16, "Q") if big else (4, "I")
    moves = {273: 324, 279: 325}  # strips' places and sizes become tiles'
    start = struct.unpack_from(order + link, data, 8 if big else 4)[0] + (8 if big else 2)
    size = 20 if big else 12
    entries = []
    for at in range(start, len(data) - (8 if big else 4), size):
        (tag,) = struct.unpack_from(order + "H", data, at)
        struct.pack_into(order + "HH", data, at, moves.get(tag, tag), kind)
        entries.append((moves.get(tag, tag), bytes(data[at : at + size])))
    data[start : start + size * len(entries)] = b"".join(entry for _, entry in sorted(entries))
    return bytes(data)


def compressed(image: np.ndarray) -> bytes:
    return cv2.imencode(".tif", image, [cv2.IMWRITE_TIFF_COMPRESSION, LZW])[1].tobytes()


LITTLE_AND_BIG = [(order, big) for order in "<>" for big in (False, True)]
FILES = {
    **{f"strips {order}{big}": (strips(order, GREY, big), GREY) for order, big in LITTLE_AND_BIG},
    **{f"strips 16 {order}{big}": (strips(order, DEEP, big), DEEP) for order, big in LITTLE_AND_BIG},
    **{
        f"white is zero {order}{big}": (strips(order, GREY, big, (262, 0)), 255 - GREY)
        for order, big in LITTLE_AND_BIG
    },
    **{f"tiles 16 {order}{big}": (tiles(order, DEEP, big), DEEP) for order, big in LITTLE_AND_BIG},
    "lzw": (compressed(GREY), GREY),
    "lzw 16": (compressed(DEEP), DEEP),
    "lzw colour": (compressed(COLOUR[..., ::-1]), LUMA),
}


@pytest.mark.parametrize("orientation", TURNED)
@pytest.mark.parametrize("name", FILES)
def test_pixels_are_as_stored_whatever_the_orientation(name: str, orientation: int) -> None:
    data, truth = FILES[name]
    for kind in (SHORT, LONG):
        turned = oriented(data, orientation, kind)
        np.testing.assert_array_equal(by_opencv(turned), TURNED[orientation](by_opencv(data)))
        np.testing.assert_array_equal(decode(turned), by_opencv(data))
    if "colour" not in name:
        np.testing.assert_array_equal(decode(turned), truth)
    else:
        assert np.abs(decode(turned).astype(int) - truth).max() <= 1


def test_plain_files_need_no_opencv_whatever_the_orientation() -> None:
    for orientation in TURNED:
        image = tiff.read_plain(memoryview(oriented(strips("<", GREY, False), orientation)))
        np.testing.assert_array_equal(image, GREY)


def test_orientation_stated_twice_or_as_what_does_not_exist() -> None:
    data = compressed(GREY)
    for orientation, times in ((6, 2), (0, 1), (9, 1), (65535, 1)):
        np.testing.assert_array_equal(decode(oriented(data, orientation, times=times)), GREY)


def test_file_is_copied_only_to_change_it_and_never_changed_itself() -> None:
    for data in (compressed(GREY), oriented(compressed(GREY), 1), oriented(strips(">", GREY, True), 1)):
        view = memoryview(data)
        assert tiff.unturned(view) is view
    turned = bytearray(oriented(compressed(GREY), 6))
    before = bytes(turned)
    decode(turned)
    assert turned == before


def planes(order: str, image: np.ndarray, planar: int) -> bytes:
    """Return a TIFF of a plane after the other where `planar` is 2, else of samples side by side."""
    stored = image.astype(image.dtype.newbyteorder(order)).reshape(HEIGHT, WIDTH, -1)
    channels = stored.shape[2]
    parts = [stored[..., k].tobytes() for k in range(channels)] if planar == 2 else [stored.tobytes()]
    photometric = 2 if channels > 2 else 1
    return encoders.tiff(
        order,
        parts,
        8 * image.itemsize,
        WIDTH,
        HEIGHT,
        HEIGHT,
        extra=((262, photometric), (277, channels), (284, planar)),
    )


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("channels", [2, 3, 4])
def test_planes_of_16_bit_are_refused_by_the_header(channels: int, order: str) -> None:
    """OpenCV returns them with pixels that it never set."""
    image = RNG.integers(0, 65536, (*SIZE, channels), dtype=np.uint16)
    for function in (read_header, decode):
        with pytest.raises(UnsupportedImage, match="16 bits") as refusal:
            function(planes(order, image, 2))
        assert "PlanarConfiguration 1" in str(refusal.value.advice)


@pytest.mark.parametrize("order", ["<", ">"])
def test_other_planes_are_read(order: str) -> None:
    for layout in (1, 2):  # of a single plane they are the same
        np.testing.assert_array_equal(decode(planes(order, DEEP, layout)), DEEP)
    for image in (planes(order, COLOUR, 2), planes(order, COLOUR, 1)):
        assert np.abs(decode(image).astype(int) - LUMA).max() <= 1
    deep = planes(order, DEEP_COLOUR, 1)
    weights = np.array([4899, 9617, 1868]) / 2**14  # .299, .587 and .114 as OpenCV has them
    assert np.abs(decode(deep) - DEEP_COLOUR @ weights).max() <= 0.5
    np.testing.assert_array_equal(decode(deep), by_opencv(deep))


@pytest.mark.parametrize("planar", [0, 3, 65535])
@pytest.mark.parametrize("image", [GREY, DEEP, COLOUR], ids=["grey", "16 bit", "colour"])
def test_planar_configurations_that_do_not_exist(image: np.ndarray, planar: int) -> None:
    data = planes("<", image, planar)
    assert by_opencv(data) is None
    for function in (read_header, decode):
        with pytest.raises(UndecodableImage, match="planar configuration"):
            function(data)


@pytest.mark.parametrize("count", [0, 2])
def test_planar_configuration_of_none_or_several_values(count: int) -> None:
    data = bytearray(planes("<", GREY, 1))
    entry = data.index(struct.pack("<HHII", 284, LONG, 1, 1))
    struct.pack_into("<HHIHH", data, entry, 284, SHORT, count, 1, 1)
    assert by_opencv(bytes(data)) is None
    with pytest.raises(UndecodableImage, match="planar configuration"):
        decode(bytes(data))
