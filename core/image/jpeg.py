"""JPEG: header and wholeness.

Reference: ITU-T T.81 (1992), Annex B: SOI, segments with a length, scans of entropy-coded bytes, EOI.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from core.errors import UndecodableImage, UnsupportedImage
from core.image.layout import ImageHeader, check_dimensions, unpack

_SOI, _EOI, _SOS, _TEM, _APP14 = 0xD8, 0xD9, 0xDA, 0x01, 0xEE
_FRAMES_TAKEN = {0xC0, 0xC1, 0xC2}  # baseline, extended sequential, progressive; all Huffman coded
_FRAMES = set(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}  # DHT, JPG and DAC are no frames
_WINDOW_BYTES = 1 << 16
_MAX_SCANS = 200
"""A progressive picture has about ten; thousands over a large frame attack the decoder's time."""


def read_header(data: memoryview) -> ImageHeader:
    """Return what the frame header (SOF) states (B.2.2)."""
    for marker, offset in _segments(data):  # noqa: B007 - used after the loop
        if marker in _FRAMES:
            break
        if marker in (_SOS, _EOI):
            raise UndecodableImage("The JPEG file's picture comes before its header.")
    else:
        raise UndecodableImage("The JPEG file has no header.")
    depth, height, width, components = unpack(">BHHB", data, offset + 2, "the JPEG header")
    if marker not in _FRAMES_TAKEN:
        raise UnsupportedImage("JPEG with arithmetic coding, lossless or hierarchical, is not taken.")
    if depth != 8:
        raise UnsupportedImage(f"JPEG with {depth} bits is not taken.")
    if components not in (1, 3):
        raise UnsupportedImage(f"JPEG with {components} colour components (CMYK) is not taken.")
    check_dimensions(width, height, "JPEG")
    return ImageHeader("jpeg", width, height, depth, components)


def check_whole(data: memoryview) -> None:
    """Walk segments and scans to EOI: decoders fill in grey for what is missing, without a word."""
    frames = scans = 0
    for marker, _ in _segments(data):
        frames += marker in _FRAMES
        scans += marker == _SOS
        if frames > 1:
            raise UndecodableImage("The JPEG file has several headers.")
        if scans > _MAX_SCANS:
            raise UndecodableImage(f"The JPEG file has more than {_MAX_SCANS} scans.")
    if not (frames and scans):
        raise UndecodableImage("The JPEG file holds no picture.")


def _segments(data: memoryview) -> Iterator[tuple[int, int]]:
    """Yield each marker after SOI and the offset behind it, up to and with EOI, skipping scans.

    Raises
    ------
    UndecodableImage
        The bytes end before EOI, or no marker stands where one must.
    """
    offset = 2
    while True:
        (prefix, marker) = unpack(">BB", data, offset, "the JPEG file's segments")
        if prefix != 0xFF:
            raise UndecodableImage("The JPEG file is damaged: a segment does not begin with a marker.")
        if marker == 0xFF:  # a fill byte (B.1.1.2)
            offset += 1
            continue
        offset += 2
        yield marker, offset
        if marker == _EOI:
            return
        if marker == _TEM:
            continue
        if marker == 0 or 0xD0 <= marker <= _SOI:
            raise UndecodableImage("The JPEG file is damaged: a marker stands where it must not.")
        (length,) = unpack(">H", data, offset, "the JPEG file's segments")
        if length < 2:
            raise UndecodableImage("The JPEG file is damaged: a segment's length is impossible.")
        offset += length
        if marker == _SOS:
            offset = _end_of_scan(data, offset)


def _end_of_scan(data: memoryview, offset: int) -> int:
    """Return where the first marker after `offset` begins that is neither a stuffed byte nor a restart (B.1.1.5)."""
    scan = np.frombuffer(data, dtype=np.uint8)
    while offset < len(scan) - 1:
        window = scan[offset : offset + _WINDOW_BYTES]
        prefixes = np.flatnonzero(window[:-1] == 0xFF)
        codes = window[prefixes + 1]
        ends = prefixes[(codes != 0) & (codes != 0xFF) & ((codes < 0xD0) | (codes > 0xD7))]
        if ends.size:
            return offset + int(ends[0])
        offset += len(window) - 1  # a prefix may be the last byte
    raise UndecodableImage("The JPEG file ends inside its picture.")
