"""TIFF and BigTIFF, both byte orders: header and wholeness of the first page.

References: Adobe, "TIFF Revision 6.0", 1992, section 2; "The BigTIFF File Format Proposal", 2004.
"""

from __future__ import annotations

from dataclasses import dataclass

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
    planes = header.channels if page.one(_PLANAR, 1) == 2 else 1
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
    if any(offset + count > len(data) for offset, count in zip(offsets, counts, strict=True)):
        raise UndecodableImage("The TIFF file ends before its pixels do.")
    if page.one(_COMPRESSION, _UNCOMPRESSED) == _UNCOMPRESSED:
        row_bits = header.width_px * header.bit_depth * (header.channels // planes)
        if sum(counts) < (row_bits + 7) // 8 * header.height_px * planes:
            raise UndecodableImage("The TIFF file's strips or tiles hold too few bytes for its pixels.")


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
    return ImageHeader("tiff", width, height, depth, channels)


def _read_page(data: memoryview) -> _Page:
    """Read the entries that matter from the first image file directory."""
    order = "<" if bytes(data[:2]) == b"II" else ">"
    (version,) = unpack(order + "H", data, 2, "the TIFF header")
    big = version == 43
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
    entries: dict[int, tuple[int, ...]] = {}
    for _ in range(count):
        tag, kind, values = unpack(order + ("HHQ" if big else "HHI"), data, offset, "the TIFF directory")
        if tag in _TAGS:
            entries[tag] = _values(data, offset + (12 if big else 8), order, big, kind, values)
        offset += 20 if big else 12
    unpack(order + ("Q" if big else "I"), data, offset, "the TIFF directory")  # the next page's place, or 0
    return _Page(entries)


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
