"""TIFF and BigTIFF, both byte orders: header and wholeness of the first page.

References: Adobe, "TIFF Revision 6.0", 1992, section 2; "The BigTIFF File Format Proposal", 2004.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Int64, UInt8, UInt16

from core.errors import UndecodableImage, UnsupportedImage
from core.image.layout import ByteSource, ImageHeader, check_dimensions, unpack

_WIDTH, _HEIGHT, _BITS, _COMPRESSION, _PHOTOMETRIC = 256, 257, 258, 259, 262
_STRIP_OFFSETS, _SAMPLES, _ROWS_PER_STRIP, _STRIP_BYTES, _PLANAR = 273, 277, 278, 279, 284
_TILE_WIDTH, _TILE_HEIGHT, _TILE_OFFSETS, _TILE_BYTES, _SAMPLE_FORMAT = 322, 323, 324, 325, 339
_TAGS = {_WIDTH, _HEIGHT, _BITS, _COMPRESSION, _PHOTOMETRIC, _STRIP_OFFSETS, _SAMPLES, _ROWS_PER_STRIP}
_TAGS |= {_STRIP_BYTES, _PLANAR, _TILE_WIDTH, _TILE_HEIGHT, _TILE_OFFSETS, _TILE_BYTES, _SAMPLE_FORMAT}

_TYPES = {1: "u1", 3: "u2", 4: "u4", 6: "i1", 8: "i2", 9: "i4", 16: "u8"}  # the whole-number types
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
_MAX_PARTS = 1 << 20
"""Strips or tiles: 16 x 16 pixels each make 268 megapixels."""
_MAX_TILE_PIXELS = 1 << 24
"""Of a tile that is larger than its image: a decoder makes room for all of it."""


@dataclass(frozen=True, slots=True)
class _Entry:
    """Where a tag's values stand: their type, their number and the place of the first."""

    kind: np.dtype[np.integer]
    count: int
    at: int


@dataclass(frozen=True, slots=True)
class _Page:
    """The first directory's entries that matter. Their values are read when asked for, as many as are asked for."""

    data: ByteSource
    entries: dict[int, _Entry]

    def values(self, tag: int, most: int) -> np.ndarray:
        """Return a tag's first values, at most `most` of them; none where the tag is missing or holds nothing."""
        entry = self.entries.get(tag)
        if entry is None:
            return np.zeros(0, dtype=np.int64)
        end = entry.at + min(entry.count, most) * entry.kind.itemsize
        if end > len(self.data):
            raise UndecodableImage("The file ends inside the TIFF directory.")
        return np.frombuffer(self.data[entry.at : end], dtype=entry.kind)

    def count(self, tag: int) -> int:
        """Return how many values a tag claims to have."""
        entry = self.entries.get(tag)
        return 0 if entry is None else entry.count

    def one(self, tag: int, default: int | None = None) -> int:
        """Return a tag's first value."""
        values = self.values(tag, 1)
        if values.size:
            return int(values[0])
        if default is None:
            raise UndecodableImage(f"The TIFF file's directory lacks tag {tag}.")
        return default

    def is_only(self, tag: int, *wanted: int) -> bool:
        """Return whether a tag is missing, or holds a single value that is among `wanted`."""
        return tag not in self.entries or (self.count(tag) == 1 and self.one(tag) in wanted)

    def tables(self) -> tuple[int, int]:
        """Return the tags of the places and sizes of the strips or tiles."""
        return (
            (_TILE_OFFSETS, _TILE_BYTES) if _TILE_OFFSETS in self.entries else (_STRIP_OFFSETS, _STRIP_BYTES)
        )


def read_header(data: ByteSource) -> ImageHeader:
    """Return what the first image file directory states."""
    return _header(_read_page(data))


def check_whole(data: memoryview) -> None:
    """Check that every strip or tile of the first page lies within the file, and that none is missing."""
    page = _read_page(data)
    _places(page, _header(page))


def _places(page: _Page, header: ImageHeader) -> tuple[Int64[np.ndarray, " n"], Int64[np.ndarray, " n"]]:
    """Return place and size of every strip or tile, bytes, all of which lie within the file."""
    parts, planes = _parts(page, header)
    offsets_tag, sizes_tag = page.tables()
    listed = page.count(offsets_tag)
    if listed != page.count(sizes_tag) or listed < parts:
        listed = min(listed, page.count(sizes_tag))
        raise UndecodableImage(f"The TIFF file lists {listed} of {parts} strips or tiles.")
    offsets, sizes = page.values(offsets_tag, parts), page.values(sizes_tag, parts)
    end = len(page.data)
    if np.any((offsets < 0) | (offsets > end)) or np.any((sizes < 0) | (sizes > end)):
        raise UndecodableImage("The TIFF file ends before its pixels do.")
    offsets, sizes = offsets.astype(np.int64), sizes.astype(np.int64)
    if np.any(offsets + sizes > end):
        raise UndecodableImage("The TIFF file ends before its pixels do.")
    if page.one(_COMPRESSION, _UNCOMPRESSED) == _UNCOMPRESSED:
        row_bits = header.width_px * header.bit_depth * (header.channels // planes)
        if int(sizes.sum()) < (row_bits + 7) // 8 * header.height_px * planes:
            raise UndecodableImage("The TIFF file's strips or tiles hold too few bytes for its pixels.")
    return offsets, sizes


def _parts(page: _Page, header: ImageHeader) -> tuple[int, int]:
    """Return how many strips or tiles the image has, and in how many planes, by its dimensions alone."""
    planes = header.channels if page.one(_PLANAR, _INTERLEAVED) == _PLANES else 1
    if _TILE_OFFSETS in page.entries:
        width, height = page.one(_TILE_WIDTH), page.one(_TILE_HEIGHT)
        if width * height > max(_MAX_TILE_PIXELS, header.pixels):
            raise UnsupportedImage("TIFF is not taken where one tile is far larger than the image.")
    else:
        width, height = header.width_px, page.one(_ROWS_PER_STRIP, header.height_px)
        height = min(height, header.height_px)
    if width <= 0 or height <= 0:
        raise UndecodableImage("The TIFF file's strips or tiles have no pixels.")
    parts = -(-header.width_px // width) * -(-header.height_px // height) * planes
    if parts > _MAX_PARTS:
        raise UnsupportedImage(
            f"TIFF in {parts} strips or tiles is not taken; at most {_MAX_PARTS} are.",
            advice="Save it with more rows in a strip (RowsPerStrip), or as PNG.",
        )
    return parts, planes


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
    page = _read_page(data)
    header = _header(page)
    offsets, sizes = _places(page, header)
    has = page.entries.keys()
    plain = all(page.is_only(tag, value) for tag, value in _PLAIN.items())
    if not plain or header.bit_depth not in (8, 16) or not has >= _STRIPPED or has & _TILED:
        return None
    sample = np.dtype(np.uint8 if header.bit_depth == 8 else np.uint16)
    stored = sample.newbyteorder("<" if bytes(data[:2]) == b"II" else ">")
    image = np.empty((header.height_px, header.width_px), dtype=sample)
    rows_per_strip = min(page.one(_ROWS_PER_STRIP, header.height_px), header.height_px)
    for first, last, offset, size in _runs(offsets, sizes, rows_per_strip * image.strides[0]):
        rows = image[first * rows_per_strip : last * rows_per_strip]
        if size < rows.nbytes:
            return None
        rows[...] = np.frombuffer(data, dtype=stored, count=rows.size, offset=offset).reshape(rows.shape)
    return image


def _runs(
    offsets: Int64[np.ndarray, " n"], sizes: Int64[np.ndarray, " n"], strip_bytes: int
) -> Iterator[tuple[int, int, int, int]]:
    """Yield first strip, strip after the last, place and bytes of strips that are whole and follow without a gap."""
    follows = (sizes[:-1] == strip_bytes) & (offsets[1:] == offsets[:-1] + strip_bytes)
    begin = 0
    for last in (*np.flatnonzero(~follows), offsets.size - 1):
        size = (last - begin) * strip_bytes + sizes[last]
        yield int(begin), int(last) + 1, int(offsets[begin]), int(size)
        begin = last + 1


def _header(page: _Page) -> ImageHeader:
    width, height = page.one(_WIDTH), page.one(_HEIGHT)
    check_dimensions(width, height, "TIFF")
    channels = page.one(_SAMPLES, 1)
    photometric = page.one(_PHOTOMETRIC, 1)
    colours = {**dict.fromkeys(_BLACK_OR_WHITE, 1), _RGB: 3, _PALETTE: 1, _YCBCR: 3}.get(photometric)
    if colours is None:
        raise UnsupportedImage(
            f"TIFF with photometric interpretation {photometric} (such as CMYK) is not taken."
        )
    if not colours <= channels <= colours + 1:
        raise UnsupportedImage(f"TIFF with {channels} samples a pixel is not taken.")
    # a tag may be there and hold nothing; of one that holds more values than samples the rest means nothing
    if any(kind != _UNSIGNED for kind in page.values(_SAMPLE_FORMAT, channels)):
        raise UnsupportedImage("TIFF with floating-point or signed samples is not taken.")
    depths = {int(depth) for depth in page.values(_BITS, channels)} or {1}
    depth = depths.pop()
    if depths or depth not in (1, 4, 8, 16):
        raise UnsupportedImage(
            "TIFF is supported with 1, 4, 8 or 16 bits a sample, the same for all samples."
        )
    if not page.is_only(_PLANAR, _INTERLEAVED, _PLANES):
        raise UndecodableImage("The TIFF file's planar configuration is neither 1 nor 2.")
    # of such planes OpenCV returns pixels that it never set
    if page.one(_PLANAR, _INTERLEAVED) == _PLANES and channels > 1 and depth == 16:
        raise UnsupportedImage(
            "TIFF with 16 bits a sample is not taken where each sample has a plane of its own.",
            advice="Save it with the samples of a pixel together (PlanarConfiguration 1), or as grey.",
        )
    return ImageHeader("tiff", width, height, depth, channels)


def _read_page(data: ByteSource) -> _Page:
    """Find the entries that matter in the first image file directory."""
    order, big = _layout(data)
    entries: dict[int, _Entry] = {}
    for at, tag, kind, count in _entries(data):
        if tag in _TAGS and tag not in entries:  # of an entry stated twice the first counts, as in libtiff
            entries[tag] = _entry(data, at + (12 if big else 8), order, big, kind, count)
    return _Page(data, entries)


def _layout(data: ByteSource) -> tuple[str, bool]:
    """Return the byte order, for struct, and whether it is a BigTIFF."""
    order = "<" if bytes(data[:2]) == b"II" else ">"
    (version,) = unpack(order + "H", data, 2, "the TIFF header")
    return order, version == 43


def _entries(data: ByteSource) -> Iterator[tuple[int, int, int, int]]:
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
    entry = struct.Struct(order + ("HHQ8x" if big else "HHI4x"))
    end = offset + count * entry.size
    unpack(order + ("Q" if big else "I"), data, end, "the TIFF directory")  # the next page's place, or 0
    listed = entry.iter_unpack(data[offset:end])
    for at, (tag, kind, values) in zip(range(offset, end, entry.size), listed, strict=True):
        yield at, tag, kind, values


def _entry(data: ByteSource, at: int, order: str, big: bool, kind: int, count: int) -> _Entry:
    """Return where an entry's values are: in its value field at `at` if they fit, else where that field points."""
    if kind not in _TYPES:
        raise UndecodableImage("The TIFF directory holds a size or place that is no whole number.")
    number = np.dtype(order + _TYPES[kind])
    if count * number.itemsize > len(data):
        raise UndecodableImage("The TIFF file ends before its directory does.")
    if count * number.itemsize > (8 if big else 4):
        (at,) = unpack(order + ("Q" if big else "I"), data, at, "the TIFF directory")
        if at + count * number.itemsize > len(data):
            raise UndecodableImage("The file ends inside the TIFF directory.")
    return _Entry(number, count, at)
