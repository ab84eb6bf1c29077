"""The kinds decoded without OpenCV: the same pixels, the same refusals, and nothing kept but the image."""

from __future__ import annotations

import struct
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from core.errors import UndecodableImage
from core.image import bmp, decode, png_pixels, read_header, tiff
from core.image.png_pixels import unfilter
from tests.support.image import image_encoders as encoders
from tests.support.image.image_encoders import GREY_PALETTE, SIGNATURE, bmp_rows, chunk, filtered, idats, png

FLAGS = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
SIZES = [(1, 1), (1, 37), (37, 1), (2, 2), (3, 5), (17, 23), (64, 255), (40, 1021)]


def by_opencv(data: bytes) -> np.ndarray | None:
    return cv2.imdecode(np.frombuffer(data, np.uint8), FLAGS)


def noise(height: int, width: int, dtype: type = np.uint8, seed: int = 3) -> np.ndarray:
    return np.random.default_rng([seed, height, width]).integers(
        0, np.iinfo(dtype).max + 1, (height, width), dtype=dtype
    )


def sample_image(height: int, width: int, dtype: type = np.uint8) -> np.ndarray:
    """Return shading with some noise: compresses, and every branch of every predictor is taken."""
    y, x = np.mgrid[:height, :width]
    values = (
        0.5 + 0.3 * np.sin(x / 9.0) * np.cos(y / 7.0) + 0.02 * np.random.default_rng(5).normal(size=x.shape)
    )
    return np.round(values * np.iinfo(dtype).max).clip(0, np.iinfo(dtype).max).astype(dtype)


def check_same(data: bytes, truth: np.ndarray, read: Callable[[bytes], np.ndarray | None]) -> None:
    """Compare what this kind's reader makes of a file with the truth and with OpenCV."""
    plain = read(data)
    assert plain is not None
    assert plain.dtype == truth.dtype == plain.dtype.newbyteorder("=")
    assert plain.flags.c_contiguous
    assert plain.flags.writeable
    np.testing.assert_array_equal(plain, truth)
    np.testing.assert_array_equal(decode(data), truth)
    np.testing.assert_array_equal(by_opencv(data), truth)


def read_png(data: bytes) -> np.ndarray | None:
    return png_pixels.read_plain(memoryview(data), read_header(data))


def grey_png(truth: np.ndarray, kinds: np.ndarray | list[int], **more: object) -> bytes:
    height, width = truth.shape
    return png(0, 8 * truth.dtype.itemsize, filtered(truth, list(kinds)), width, height, **more)


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


MEASURE = """
import sys
from pathlib import Path
from core.image import decode

def peak_bytes():  # getrusage would begin with what the parent had
    return 1024 * int(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0])

decode(Path(sys.argv[1]).read_bytes())  # loads and compiles what decoding needs
data = Path(sys.argv[2]).read_bytes()
before = peak_bytes()
image = decode(data)
print(peak_bytes() - before, image.nbytes)
"""


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["png", "png16", "bmp", "tif", "bomb"])
def test_memory(kind: str, tmp_path: Path) -> None:
    """Twenty megapixels, and a small image whose stream goes on for 400 MB, take no more than the image."""
    whole = sample_image(100, 100, np.uint16 if kind == "png16" else np.uint8)
    large = np.tile(whole, (40, 50))
    extension = "." + kind[:3]
    options = [cv2.IMWRITE_TIFF_COMPRESSION, 1] if kind == "tif" else []
    if kind == "bomb":
        rows = filtered(whole, [1] * 100)
        packer = zlib.compressobj()
        stream = (
            packer.compress(rows)
            + b"".join(packer.compress(bytes(1 << 20)) for _ in range(400))
            + packer.flush()
        )
        header = chunk(b"IHDR", struct.pack(">IIBBBBB", 100, 100, 8, 0, 0, 0, 0))
        small_file, file = grey_png(whole, [1] * 100), SIGNATURE + header + idats(stream) + IEND
    else:
        small_file, file = (cv2.imencode(extension, image, options)[1].tobytes() for image in (whole, large))
    paths = [tmp_path / "small", tmp_path / "large"]
    for path, content in zip(paths, (small_file, file), strict=True):
        path.write_bytes(content)
    root = str(Path(__file__).parents[3])
    done = subprocess.run(
        [sys.executable, "-c", MEASURE, *map(str, paths)],
        cwd=root,
        capture_output=True,
        text=True,
        check=True,
    )
    growth, image_bytes = map(int, done.stdout.split())
    assert 0.5 * (image_bytes - (4 << 20)) < growth <= image_bytes + (4 << 20)


@pytest.mark.slow
def test_reading_headers_needs_neither_numba_nor_the_inflater() -> None:
    """The service's front looks at headers and must stay small; the workers decode."""
    program = "import sys, core.image, app.main; print([m for m in ('numba', 'isal') if m in sys.modules])"
    root = str(Path(__file__).parents[3])
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=root, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"
