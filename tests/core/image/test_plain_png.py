"""PNG files decoded without OpenCV: the same pixels, the same refusals, and the rest left to OpenCV."""

from __future__ import annotations

import struct
import time
import zlib

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from core.errors import UndecodableImage
from core.image import decode
from core.image.png_pixels import unfilter
from tests.support.image.image_encoders import SIGNATURE, chunk, filtered, idats, png
from tests.support.image.plain_kinds import (
    SIZES,
    by_opencv,
    check_same,
    grey_png,
    noise,
    read_png,
    sample_image,
)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("kind", [0, 1, 2, 3, 4, "mixed"])
def test_png_filters(kind: int | str, size: tuple[int, int], dtype: type) -> None:
    for truth in (noise(*size, dtype), sample_image(*size, dtype)):
        kinds = np.arange(3, 3 + size[0]) * 7 % 5 if kind == "mixed" else [kind] * size[0]
        check_same(grey_png(truth, kinds), truth, read_png)


@pytest.mark.parametrize("level", range(10))
def test_png_compression_levels(level: int) -> None:
    truth = sample_image(301, 403)
    check_same(grey_png(truth, [4] * 301, level=level), truth, read_png)


@pytest.mark.parametrize("strategy", range(5))
@pytest.mark.parametrize("level", [0, 1, 6, 9])
def test_png_by_opencv(level: int, strategy: int) -> None:
    for truth in (
        sample_image(211, 303),
        sample_image(211, 303, np.uint16),
        np.full((211, 303), 255, np.uint8),
    ):
        options = [cv2.IMWRITE_PNG_COMPRESSION, level, cv2.IMWRITE_PNG_STRATEGY, strategy]
        check_same(cv2.imencode(".png", truth, options)[1].tobytes(), truth, read_png)


@pytest.mark.parametrize(
    "cuts", [range(1, 10_000), [0, 0, 5, 5, 5, 1 << 20], [1, 2, 3], [100, 65_635, 65_636]]
)
def test_png_stream_in_many_chunks(cuts: list[int]) -> None:
    """Chunks of one byte, of none, and such as end where the pieces for the inflater do."""
    truth = noise(300, 400)
    check_same(grey_png(truth, np.arange(300) % 5, cuts=cuts), truth, read_png)


def test_png_larger_than_the_pieces_it_is_read_in() -> None:
    for truth in (noise(1025, 1027), np.zeros((1500, 2000), np.uint8)):
        check_same(grey_png(truth, np.arange(len(truth)) % 5), truth, read_png)


@settings(max_examples=150)
@given(st.data(), st.integers(1, 6), st.integers(1, 20), st.sampled_from([1, 2]))
def test_unfilter_against_plain_python(data: st.DataObject, height: int, pixels: int, step: int) -> None:
    width = pixels * step
    rows = data.draw(st.lists(st.integers(0, 4), min_size=height, max_size=height))
    values = data.draw(st.binary(min_size=height * width, max_size=height * width))
    stream = b"".join(
        bytes([kind]) + values[row * width : (row + 1) * width] for row, kind in enumerate(rows)
    )
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=6)))
    result = np.full((height, width), 0xEE, np.uint8)
    state = np.zeros(2, np.int64)
    for begin, end in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        assert unfilter(np.frombuffer(stream[begin:end], np.uint8), result, step, state)
    np.testing.assert_array_equal(result, unfiltered(stream, height, width, step))


def unfiltered(stream: bytes, height: int, width: int, step: int) -> np.ndarray:
    """Undo filters by the letter of the specification (section 9.2), a byte at a time."""
    result = np.zeros((height + 1, width + step), dtype=int)  # a row above and a pixel to the left, of zeros
    for row in range(height):
        line = stream[row * (width + 1) : (row + 1) * (width + 1)]
        for place in range(width):
            a, b, c = result[row + 1, place], result[row, place + step], result[row, place]
            p = a + b - c
            nearest = min((a, b, c), key=lambda value: abs(p - value))
            prediction = (0, a, b, (a + b) // 2, nearest)[line[0]]
            result[row + 1, place + step] = (line[1 + place] + prediction) % 256
    return result[1:, step:].astype(np.uint8)


def test_unfilter_writes_no_further_than_the_image() -> None:
    whole = np.full((4, 6), 7, np.uint8)
    state = np.zeros(2, np.int64)
    endless = np.frombuffer(bytes(1000), np.uint8)
    assert unfilter(endless, whole[1:3], 1, state)
    np.testing.assert_array_equal(whole, [[7] * 6, [0] * 6, [0] * 6, [7] * 6])
    assert unfilter(endless, whole[1:3], 1, state)
    assert not unfilter(np.frombuffer(b"\5", np.uint8), whole, 1, np.zeros(2, np.int64))


@pytest.mark.parametrize("step", [1, 2])
def test_unfilter_takes_a_first_row_of_many_pieces_like_every_other(step: int) -> None:
    """An image of 90 million pixels in one row was unfiltered within 47 s: each piece cost as much as the row."""
    rows = np.zeros((2, 40_000_000), np.uint8)
    pieces = [np.frombuffer(bytes(1000), np.uint8)] * 400
    unfilter(pieces[0], rows, step, np.zeros(2, np.int64))  # compiled
    took_s = []
    for row in range(2):
        state = np.array([row * (rows.shape[1] + 1), 0], np.int64)
        began = time.process_time()
        for piece in pieces:
            assert unfilter(piece, rows, step, state)
        took_s.append(time.process_time() - began)
    assert took_s[0] < 100.0 * took_s[1]


TRUTH = noise(17, 23)
ROWS = filtered(TRUTH, [row % 5 for row in range(17)])
STREAM = zlib.compress(ROWS)
IHDR = chunk(b"IHDR", struct.pack(">IIBBBBB", 23, 17, 8, 0, 0, 0, 0))
IEND = chunk(b"IEND", b"")
ORIENTED = b"MM\0*\0\0\0\x08\0\1" + struct.pack(">HHIHH", 0x0112, 3, 1, 6, 0) + b"\0\0\0\0"
SMALL_WINDOW = zlib.compressobj(wbits=9)


def of(*parts: bytes) -> bytes:
    return SIGNATURE + IHDR + b"".join(parts) + IEND


READABLE = {
    "bytes after the stream": of(idats(STREAM + b"garbage")),
    "a chunk after the stream": of(idats(STREAM), chunk(b"IDAT", b"garbage")),
    "an empty chunk first": of(chunk(b"IDAT", b""), idats(STREAM)),
    "a small window": of(idats(SMALL_WINDOW.compress(ROWS) + SMALL_WINDOW.flush())),
    "stored, not compressed": of(idats(zlib.compress(ROWS, 0))),
    "text before and after": of(chunk(b"tEXt", b"a\0b"), idats(STREAM), chunk(b"tEXt", b"a\0b")),
    "a text of many bytes": of(chunk(b"tEXt", b"a\0" + b"b" * 10**7), idats(STREAM)),
    "gamma": of(chunk(b"gAMA", struct.pack(">I", 220_000)), idats(STREAM)),
    "an impossible gamma": of(chunk(b"gAMA", b"ab"), idats(STREAM)),
    "sRGB": of(chunk(b"sRGB", b"\1"), idats(STREAM)),
    "chromaticities": of(chunk(b"cHRM", b"\1" * 32), idats(STREAM)),
    "resolution": of(chunk(b"pHYs", struct.pack(">IIB", 5, 6, 1)), idats(STREAM)),
    "time": of(chunk(b"tIME", b"1234567"), idats(STREAM)),
    "orientation": of(chunk(b"eXIf", ORIENTED), idats(STREAM)),
    "compressed text": of(chunk(b"zTXt", b"a\0\0" + zlib.compress(b"b" * 100)), idats(STREAM)),
    "international text": of(chunk(b"iTXt", b"abbb"), idats(STREAM)),
}
LEFT_TO_OPENCV = {
    "more than the image": of(idats(zlib.compress(ROWS + b"\0"))),
    "much more than the image": of(idats(zlib.compress(ROWS + bytes(10**6)))),
    "more, and a wrong checksum": of(idats(zlib.compress(ROWS + bytes(10**4))[:-1] + b"x")),
    "a transparent grey": of(chunk(b"tRNS", b"\0\5"), idats(STREAM)),
    "significant bits": of(chunk(b"sBIT", b"\5"), idats(STREAM)),
    "a background": of(chunk(b"bKGD", b"\0\5"), idats(STREAM)),
    "a palette that is not used": of(chunk(b"PLTE", b"\0\1\2"), idats(STREAM)),
    "an animation": of(
        chunk(b"acTL", struct.pack(">II", 1, 0)),
        chunk(b"fcTL", struct.pack(">IIIIIHHBB", 0, 23, 17, 0, 0, 1, 1, 0, 0)),
        idats(STREAM),
    ),
    "a private chunk": of(chunk(b"abCd", b"abc"), idats(STREAM)),
}
REFUSED = {
    "wrong checksum of the stream": of(idats(STREAM[:-1] + bytes([STREAM[-1] ^ 1]))),
    "no checksum of the stream": of(idats(STREAM[:-4])),
    "more than the image, but no end": of(idats(zlib.compress(ROWS + b"\0")[:-5])),
    "half a checksum": of(idats(STREAM[:-2])),
    "a byte too few": of(idats(zlib.compress(ROWS[:-1]))),
    "a row too few": of(idats(zlib.compress(ROWS[:-24]))),
    "empty": of(chunk(b"IDAT", b"")),
    "text amid the stream": of(
        chunk(b"IDAT", STREAM[:50]), chunk(b"tEXt", b"a\0b"), chunk(b"IDAT", STREAM[50:])
    ),
    "a profile amid the stream": of(
        chunk(b"IDAT", STREAM[:50]),
        chunk(b"iCCP", b"a\0\0" + zlib.compress(b"b" * 100)),
        chunk(b"IDAT", STREAM[50:]),
    ),
    "a filter that does not exist": of(idats(zlib.compress(b"\5" + ROWS[1:]))),
    "the same in the last row": of(idats(zlib.compress(ROWS[:-24] + b"\xc8" + ROWS[-23:]))),
    "a wrong check of the stream's head": of(idats(bytes([STREAM[0], STREAM[1] ^ 1]) + STREAM[2:])),
    "a preset dictionary": of(idats(b"\x78\x20" + STREAM[2:])),
    "another compression": of(idats(b"\x77\x18" + STREAM[2:])),
    "an impossible window": of(idats(b"\x88\x1c" + STREAM[2:])),
    "a damaged block": of(idats(STREAM[:60] + b"\xff" * 9 + STREAM[69:])),
    "two headers": of(IHDR, idats(STREAM)),
    "an unknown chunk that matters": of(chunk(b"ABCD", b"abc"), idats(STREAM)),
    "wrong checksum of a chunk": of(idats(STREAM)[:-1] + b"x"),
}


@pytest.mark.parametrize("name", READABLE)
def test_png_out_of_the_ordinary(name: str) -> None:
    check_same(READABLE[name], TRUTH, read_png)


@pytest.mark.parametrize("name", LEFT_TO_OPENCV)
def test_png_left_to_opencv(name: str) -> None:
    data = LEFT_TO_OPENCV[name]
    assert read_png(data) is None
    np.testing.assert_array_equal(decode(data), by_opencv(data))


@pytest.mark.parametrize("name", REFUSED)
def test_png_refused_as_by_opencv(name: str) -> None:
    assert by_opencv(REFUSED[name]) is None
    with pytest.raises(UndecodableImage):
        decode(REFUSED[name])


def test_png_of_endlessly_many_chunks() -> None:
    data = of(chunk(b"IDAT", b"") * 140_000, idats(STREAM))
    with pytest.raises(UndecodableImage, match="chunks"):
        decode(data)


def test_png_of_other_kinds_is_left_to_opencv() -> None:
    colour = np.random.default_rng(1).integers(0, 256, (17, 23, 4), dtype=np.uint8)
    bits = np.packbits(TRUTH > 99, axis=1)
    two_bits = cv2.imencode(".png", TRUTH, [cv2.IMWRITE_PNG_BILEVEL, 1])[1].tobytes()
    grey_alpha = b"".join(b"\0" + row.tobytes() for row in colour[..., :2])
    palette = png(3, 8, ROWS, 23, 17, bytes(range(256)) * 3)
    one_bit = png(0, 1, b"".join(b"\0" + row.tobytes() for row in bits), 23, 17)
    interlaced = bytearray(of(idats(STREAM)))
    interlaced[28] = 1
    interlaced[29:33] = struct.pack(">I", zlib.crc32(interlaced[12:29]))
    written = [cv2.imencode(".png", colour[..., :channels])[1].tobytes() for channels in (3, 4)]
    for data in (palette, one_bit, two_bits, png(4, 8, grey_alpha, 23, 17), *written):
        assert read_png(data) is None
        np.testing.assert_array_equal(decode(data), by_opencv(data))
    assert read_png(bytes(interlaced)) is None


@settings(max_examples=300)
@given(st.integers(0, 10**6), st.integers(1, 255), st.integers(0, 3))
def test_png_with_a_damaged_stream(place: int, change: int, cut: int) -> None:
    """With right checksums around it: what passes is what passes OpenCV."""
    stream = bytearray(STREAM)
    stream[place % len(stream)] ^= change
    data = of(idats(bytes(stream[: len(stream) - cut * (place % 50)]), cuts=[place % 300]))
    expected = by_opencv(data)
    if expected is None:
        with pytest.raises(UndecodableImage):
            decode(data)
    else:
        np.testing.assert_array_equal(decode(data), expected)
