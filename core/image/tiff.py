"""TIFF and BigTIFF, both byte orders: header and wholeness of the first page.

References: Adobe, "TIFF Revision 6.0", 1992, section 2; "The BigTIFF File Format Proposal", 2004.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import UInt8, UInt16

from core.errors import UndecodableImage, UnsupportedImage
from core.image.layout import ImageHeader, check_dimensions, unpack

_WIDTH, _HEIGHT, _BITS, _COMPRESSION, _PHOTOMETRIC = 256, 257, 258, 259, 262
_STRIP_OFFSETS, _SAMPLES, _ROWS_PER_STRIP, _STRIP_BYTES, _PLANAR = 273, 277, 278, 279, 284
_TILE_WIDTH, _TILE_HEIGHT, _TILE_OFFSETS, _TILE_BYTES, _SAMPLE_FORMAT = 322, 323, 324, 325, 339
_TAGS = {_WIDTH, _HEIGHT, _BITS, _COMPRESSION, _PHOTOMETRIC, _STRIP_OFFSETS, _SAMPLES, _ROWS_PER_STRIP}
_TAGS |= {_STRIP_BYTES, _PLANAR, _TILE_WIDTH, _TILE_HEIGHT, _TILE_OFFSETS, _TILE_BYTES, _SAMPLE_FORMAT}

_TYPES = {1: "B", 3: "H", 4: "I", 6: "b", 8: "h", 9: "i", 16: "Q"}  # the whole-number types
_SIZES = {"B": 1, "H": 2, "I": 4, "b": 1, "h": 2, "i": 4, "Q": 8}
_BLACK_OR_WHITE, _RGB, _PALETTE, _YCBCR = (0, 1), 2, 3, 6
_UNCOMPRESSED = 1
_UNSIGNED = 1
_INTERLEAVED, _PLANES = 1, 2
_SHORT = 3
_FILL_ORDER, _ORIENTATION, _PREDICTOR = 266, 274, 317
_PLAIN = {
    _PHOTOMETRIC: 1,
    _COMPRESSION: _UNCOMPRESSED,
    _SAMPLES: 1,
    _FILL_ORDER: 1,
    _PREDICTOR: 1,
}
"""Black is zero, stored as it is: what a missing tag means, too (section 8)."""
_STRIPPED = {_PHOTOMETRIC, _STRIP_OFFSETS, _STRIP_BYTES}
_TILED = {_TILE_WIDTH, _TILE_HEIGHT, _TILE_OFFSETS, _TILE_BYTES}
_TAGS |= {_FILL_ORDER, _PREDICTOR}
_MAX_ENTRIES = 4096


@dataclass(frozen=True, slots=True)
class _Page:
    """The first directory's entries: tag -> values."""

    entries: dict[int, tuple[int, ...]]

    def one(self, tag: int, default: int | None = None) -> int:
        """Return a tag's first value."""
        values = self.entries.get(tag, ())
        if values:
            return values[0]
        if default is None:
            raise UndecodableImage(f"The TIFF file's directory lacks tag {tag}.")
        return default


def read_header(data: memoryview) -> ImageHeader:
    """Return what the first image file directory states."""
    return _header(_read_page(data))


def check_whole(data: memoryview) -> None:
    """Check that every strip or tile of the first page lies within the file, and that none is missing."""
    page = _read_page(data)
    header = _header(page)
    tiled = _TILE_OFFSETS in page.entries
    offsets = page.entries.get(_TILE_OFFSETS if tiled else _STRIP_OFFSETS, ())
    counts = page.entries.get(_TILE_BYTES if tiled else _STRIP_BYTES, ())
    planes = header.channels if page.one(_PLANAR, _INTERLEAVED) == _PLANES else 1
    if tiled:
        part_width, part_height = page.one(_TILE_WIDTH), page.one(_TILE_HEIGHT)
    else:
        part_width, part_height = (
            header.width_px,
            min(page.one(_ROWS_PER_STRIP, header.height_px), header.height_px),
        )
    if part_width <= 0 or part_height <= 0:
        raise UndecodableImage("The TIFF file's strips or tiles have no pixels.")
    parts = -(-header.width_px // part_width) * -(-header.height_px // part_height) * planes
    if len(offsets) != len(counts) or len(offsets) < parts:
        raise UndecodableImage(
            f"The TIFF file lists {min(len(offsets), len(counts))} of {parts} strips or tiles."
        )
    strips = zip(offsets, counts, strict=True)
    if any(offset < 0 or count < 0 or offset + count > len(data) for offset, count in strips):
        raise UndecodableImage("The TIFF file ends before its pixels do.")
    if page.one(_COMPRESSION, _UNCOMPRESSED) == _UNCOMPRESSED:
        row_bits = header.width_px * header.bit_depth * (header.channels // planes)
        if sum(counts) < (row_bits + 7) // 8 * header.height_px * planes:
            raise UndecodableImage("The TIFF file's strips or tiles hold too few bytes for its pixels.")


def unturned(data: memoryview) -> memoryview:
    """Return the file with the first page's Orientation as 1, where OpenCV turns nothing: pixels are the sensor's."""
    order, big = _layout(data)
    entry = struct.pack(order + ("HHQH6x" if big else "HHIH2x"), _ORIENTATION, _SHORT, 1, 1)
    places = [at for at, tag, _, _ in _entries(data) if tag == _ORIENTATION]
    if all(data[at : at + len(entry)] == entry for at in places):
        return data
    copy = bytearray(data)
    for at in places:
        copy[at : at + len(entry)] = entry
    return memoryview(copy)


def read_plain(data: memoryview) -> UInt8[np.ndarray, "h w"] | UInt16[np.ndarray, "h w"] | None:
    """Return the pixels of uncompressed grey strips, or None where OpenCV is to decode."""
    check_whole(data)
    page = _read_page(data)
    header = _header(page)
    has = page.entries.keys()
    plain = all(page.entries.get(tag, (value,)) == (value,) for tag, value in _PLAIN.items())
    if not plain or header.bit_depth not in (8, 16) or not has >= _STRIPPED or has & _TILED:
        return None
    sample = np.dtype(np.uint8 if header.bit_depth == 8 else np.uint16)
    stored = sample.newbyteorder("<" if bytes(data[:2]) == b"II" else ">")
    image = np.empty((header.height_px, header.width_px), dtype=sample)
    for first, last, offset, size in _runs(page, image.strides[0], header.height_px):
        rows = image[first:last]
        if size < rows.nbytes:
            return None
        rows[...] = np.frombuffer(data, dtype=stored, count=rows.size, offset=offset).reshape(rows.shape)
    return image


def _runs(page: _Page, row_bytes: int, height: int) -> Iterator[tuple[int, int, int, int]]:
    """Yield first row, row after the last, place and bytes of strips that are whole and follow without a gap."""
    rows_per_strip = min(page.one(_ROWS_PER_STRIP, height), height)
    strip_bytes = rows_per_strip * row_bytes
    strips = -(-height // rows_per_strip)
    offsets, sizes = page.entries[_STRIP_OFFSETS][:strips], page.entries[_STRIP_BYTES][:strips]
    begin = 0
    for last in range(strips):
        follows = (
            last + 1 < strips
            and sizes[last] == strip_bytes
            and offsets[last + 1] == offsets[last] + strip_bytes
        )
        if not follows:
            size = (last - begin) * strip_bytes + sizes[last]
            yield begin * rows_per_strip, min((last + 1) * rows_per_strip, height), offsets[begin], size
            begin = last + 1


def _header(page: _Page) -> ImageHeader:
    width, height = page.one(_WIDTH), page.one(_HEIGHT)
    check_dimensions(width, height, "TIFF")
    channels = page.one(_SAMPLES, 1)
    depths = set(page.entries.get(_BITS) or (1,))  # a tag may be there and hold nothing
    formats = set(page.entries.get(_SAMPLE_FORMAT) or (_UNSIGNED,))
    photometric = page.one(_PHOTOMETRIC, 1)
    if formats != {_UNSIGNED}:
        raise UnsupportedImage("TIFF with floating-point or signed samples is not taken.")
    colours = {**dict.fromkeys(_BLACK_OR_WHITE, 1), _RGB: 3, _PALETTE: 1, _YCBCR: 3}.get(photometric)
    if colours is None:
        raise UnsupportedImage(
            f"TIFF with photometric interpretation {photometric} (such as CMYK) is not taken."
        )
    if not colours <= channels <= colours + 1:
        raise UnsupportedImage(f"TIFF with {channels} samples a pixel is not taken.")
    depth = depths.pop()
    if depths or depth not in (1, 4, 8, 16):
        raise UnsupportedImage("TIFF is taken with 1, 4, 8 or 16 bits a sample, all alike.")
    planar = page.entries.get(_PLANAR, (_INTERLEAVED,))
    if planar not in ((_INTERLEAVED,), (_PLANES,)):
        raise UndecodableImage("The TIFF file's planar configuration is neither 1 nor 2.")
    # of such planes OpenCV returns pixels that it never set
    if planar == (_PLANES,) and channels > 1 and depth == 16:
        raise UnsupportedImage(
            "TIFF with 16 bits a sample is not taken where each sample has a plane of its own.",
            advice="Save it with the samples of a pixel together (PlanarConfiguration 1), or as grey.",
        )
    return ImageHeader("tiff", width, height, depth, channels)


def _read_page(data: memoryview) -> _Page:
    """Read the entries that matter from the first image file directory."""
    order, big = _layout(data)
    entries: dict[int, tuple[int, ...]] = {}
    for at, tag, kind, count in _entries(data):
        if tag in _TAGS and tag not in entries:  # of an entry stated twice the first counts, as in libtiff
            entries[tag] = _values(data, at + (12 if big else 8), order, big, kind, count)
    return _Page(entries)


def _layout(data: memoryview) -> tuple[str, bool]:
    """Return the byte order, for struct, and whether it is a BigTIFF."""
    order = "<" if bytes(data[:2]) == b"II" else ">"
    (version,) = unpack(order + "H", data, 2, "the TIFF header")
    return order, version == 43


def _entries(data: memoryview) -> Iterator[tuple[int, int, int, int]]:
    """Yield place, tag, type and number of values of each entry of the first directory."""
    order, big = _layout(data)
    if big:
        offset_bytes, zero, offset = unpack(order + "HHQ", data, 4, "the TIFF header")
        if offset_bytes != 8 or zero:
            raise UnsupportedImage("BigTIFF with offsets of other than 8 bytes is not taken.")
    else:
        (offset,) = unpack(order + "I", data, 4, "the TIFF header")
    (count,) = unpack(order + ("Q" if big else "H"), data, offset, "the TIFF directory")
    if not 1 <= count <= _MAX_ENTRIES:
        raise UndecodableImage(f"The TIFF directory states {count} entries.")
    offset += 8 if big else 2
    for _ in range(count):
        tag, kind, values = unpack(order + ("HHQ" if big else "HHI"), data, offset, "the TIFF directory")
        yield offset, tag, kind, values
        offset += 20 if big else 12
    unpack(order + ("Q" if big else "I"), data, offset, "the TIFF directory")  # the next page's place, or 0


def _values(data: memoryview, at: int, order: str, big: bool, kind: int, count: int) -> tuple[int, ...]:
    """Return an entry's values: in its value field at `at` if they fit, else where that field points."""
    letter = _TYPES.get(kind)
    if letter is None:
        raise UndecodableImage("The TIFF directory holds a size or place that is no whole number.")
    if count * _SIZES[letter] > len(data):
        raise UndecodableImage("The TIFF file ends before its directory does.")
    if count * _SIZES[letter] > (8 if big else 4):
        (at,) = unpack(order + ("Q" if big else "I"), data, at, "the TIFF directory")
    return unpack(f"{order}{count}{letter}", data, at, "the TIFF directory")
