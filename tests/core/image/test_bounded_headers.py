"""What is read of a header is bounded by constants, whatever the file claims and however long it is."""

from __future__ import annotations

import struct
import tracemalloc
import zlib

import numpy as np
import pytest

from core.errors import ImageError, UndecodableImage, UnsupportedImage
from core.image import check_whole, decode, png, read_header, tiff
from tests.support.image import image_encoders as encoders
from tests.support.image.hostile_headers import (
    empty_chunks,
    empty_segments,
    greedy_tiff,
    tiff_directory,
)

MIB = 1 << 20
MOST_BYTES = 128 * 1024
SHORT, LONG, LONG8 = 3, 4, 16
HOSTILE = {
    **{
        f"tiff {order} {big} {kind}": greedy_tiff(2 * MIB, order=order, big=big, kind=kind)
        for order in "<>"
        for big in (False, True)
        for kind in (1, SHORT, LONG, LONG8)
    },
    "jpeg of empty segments": empty_segments(8 * MIB),
    "jpeg of fill bytes": empty_segments(8 * MIB, b"\xff"),
    "jpeg of markers without a length": empty_segments(8 * MIB, b"\xff\x01"),
    "png of empty pixel chunks": empty_chunks(8 * MIB),
    "png of other empty chunks": empty_chunks(8 * MIB, name=b"abCd"),
    "png without a header": empty_chunks(8 * MIB, header=False),
    "bmp": b"BM" + struct.pack("<IHHIIiiHHI", 8 * MIB, 0, 0, 54, 40, 100, 100, 1, 8, 0) + bytes(8 * MIB),
}


class Counted:
    """A file's bytes, and how many of them were read."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self.read = 0

    def __len__(self) -> int:
        return len(self._data)

    def __getitem__(self, part: slice) -> bytes:
        found = self._data[part]
        self.read += len(found)
        return found


@pytest.mark.parametrize("name", HOSTILE)
def test_header_reading_takes_no_more_than_a_constant(name: str) -> None:
    source = Counted(HOSTILE[name])
    tracemalloc.start()
    try:
        read_header(source)
    except ImageError:
        pass
    finally:
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
    assert source.read <= MOST_BYTES
    assert most <= 2 * MIB


@pytest.mark.parametrize("name", [name for name in HOSTILE if name.startswith(("jpeg", "png"))])
def test_wholeness_of_what_holds_nothing_is_refused(name: str) -> None:
    with pytest.raises(UndecodableImage):
        check_whole(HOSTILE[name])


def grey_tiff(size: int, **changes: tuple[int, int, int]) -> bytes:
    """Return a grey TIFF of 64 x 64 with a body of `size` bytes, the entries `t<tag>` changed."""
    entries = {
        256: (LONG, 1, 64),
        257: (LONG, 1, 64),
        258: (SHORT, 1, 8),
        262: (SHORT, 1, 1),
        273: (LONG, 1, 8),
        278: (LONG, 1, 64),
        279: (LONG, 1, 4096),
    }
    entries |= {int(tag[1:]): entry for tag, entry in changes.items()}
    return tiff_directory("<", False, [(tag, *entry) for tag, entry in sorted(entries.items())], bytes(size))


def test_scalar_tags_are_read_once_and_lists_as_far_as_the_image_needs_them() -> None:
    whole = grey_tiff(MIB)
    assert decode(whole).shape == (64, 64)
    longer = grey_tiff(MIB, t273=(LONG, MIB // 8, 8), t279=(LONG, MIB // 8, 8))
    source = Counted(longer)
    assert read_header(source) == read_header(whole)
    assert source.read < 1000
    several = grey_tiff(MIB, t258=(SHORT, MIB // 2, 8))
    with pytest.raises(UnsupportedImage, match="bits"):  # the first value alone counts for one sample
        read_header(several)


def test_strips_are_counted_before_their_tables_are_read() -> None:
    few = grey_tiff(MIB, t278=(LONG, 1, 1), t273=(LONG, 63, 8), t279=(LONG, 63, 8))
    with pytest.raises(UndecodableImage, match="63 of 64"):
        check_whole(few)
    height = (1 << 20) + 1
    many = grey_tiff(5 * MIB, t256=(LONG, 1, 1), t257=(LONG, 1, height), t278=(LONG, 1, 1))
    with pytest.raises(UnsupportedImage, match="strips or tiles"):
        check_whole(many)


def test_a_tile_far_larger_than_its_image_is_refused() -> None:
    changes = {
        "t322": (LONG, 1, 32_768),
        "t323": (LONG, 1, 32_768),
        "t324": (LONG, 1, 8),
        "t325": (LONG, 1, 4096),
    }
    with pytest.raises(UnsupportedImage, match="larger than the image"):
        check_whole(grey_tiff(8192, **changes))


@pytest.mark.parametrize("height", [1000, 1 << 20])
def test_a_plain_image_of_as_many_strips_as_rows_is_read(height: int) -> None:
    image = np.random.default_rng(height).integers(0, 256, (height, 2), dtype=np.uint8)
    tables = np.arange(height, dtype="<u4") * 2 + 8
    sizes = np.full(height, 2, dtype="<u4")
    body = image.tobytes() + tables.tobytes() + sizes.tobytes()
    entries = [(256, LONG, 1, 2), (257, LONG, 1, height), (258, SHORT, 1, 8), (262, SHORT, 1, 1)]
    entries += [(273, LONG, height, 8 + image.size), (278, LONG, 1, 1)]
    entries += [(279, LONG, height, 8 + image.size + tables.nbytes)]
    np.testing.assert_array_equal(
        tiff.read_plain(memoryview(tiff_directory("<", False, entries, body))), image
    )


@pytest.mark.parametrize("name", [b"zTXt", b"iTXt", b"iCCP"])
def test_compressed_texts_of_a_png_are_not_inflated(name: bytes) -> None:
    start = {b"iTXt": b"k\0\1\0\0\0"}.get(name, b"k\0\0")
    bomb = (name, start + zlib.compress(bytes(MIB), 9))
    rows = encoders.filtered(np.arange(3 * 64, dtype=np.uint8).reshape(8, 24), [0] * 8)
    plain, bombed = (encoders.png(2, 8, rows, 8, 8, extra=extra) for extra in ([], [bomb] * 50))
    assert png.without_compressed_text(memoryview(bombed)) == plain
    np.testing.assert_array_equal(decode(bombed), decode(plain))
