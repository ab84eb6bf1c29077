"""JPEG: header and wholeness.

Reference: ITU-T T.81 (1992), Annex B: SOI, segments with a length, scans of entropy-coded bytes, EOI.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import UInt8

from core.errors import UndecodableImage, UnsupportedImage
from core.image.layout import ByteSource, ImageHeader, check_dimensions, unpack
from core.jit import jit

_SOI, _EOI, _SOS, _TEM = 0xD8, 0xD9, 0xDA, 0x01
_FRAMES_TAKEN = {0xC0, 0xC1, 0xC2}  # baseline, extended sequential, progressive; all Huffman coded
_FRAMES = set(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}  # DHT, JPG and DAC are no frames
_BLOCK_BYTES = 1 << 12
_MAX_SCANS = 200
"""A progressive image has about ten; thousands over a large frame attack the decoder's time."""
_MAX_MARKERS = 1 << 13
"""Markers and fill bytes outside of scans. Full segments hold 512 MiB; millions of empty ones attack the reader."""


def read_header(data: ByteSource) -> ImageHeader:
    """Return what the frame header (SOF) states (B.2.2)."""
    for marker, offset in _segments(data):  # noqa: B007 - used after the loop
        if marker in _FRAMES:
            break
        if marker in (_SOS, _EOI):
            raise UndecodableImage("The JPEG file's image data come before its header.")
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
        raise UndecodableImage("The JPEG file holds no image.")


def _segments(data: ByteSource) -> Iterator[tuple[int, int]]:
    """Yield each marker after SOI and the offset behind it, up to and with EOI, skipping scans.

    Raises
    ------
    UndecodableImage
        The bytes end before EOI, no marker stands where one must, or there are more than any encoder writes.
    """
    offset = 2
    for _ in range(_MAX_MARKERS):
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
    raise UndecodableImage(f"The JPEG file has more than {_MAX_MARKERS} segments and fill bytes.")


def _end_of_scan(data: ByteSource, offset: int) -> int:
    """Return where the first marker after `offset` begins that is neither a stuffed byte nor a restart (B.1.1.5)."""
    scan = np.frombuffer(data[offset:], dtype=np.uint8)
    end = next_marker(scan, 0)
    if end < 0:
        raise UndecodableImage("The JPEG file ends inside its image data.")
    return offset + end


@jit("Array(u1, 1, 'C', readonly=True), i8")
def next_marker(scan: UInt8[np.ndarray, " n"], offset: int) -> int:
    """Return where 0xFF is followed by anything but 0, 0xFF and a restart's 0xD0 to 0xD7, from `offset` on; else -1."""
    last = scan.shape[0] - 1
    for begin in range(offset, last, _BLOCK_BYTES):
        end = min(begin + _BLOCK_BYTES, last)
        prefixes, codes = scan[begin:end], scan[begin + 1 : end + 1]
        is_marker = False  # a loop without a way out is compiled to vector instructions
        for i in range(end - begin):
            is_marker |= (prefixes[i] == 0xFF) & (codes[i] != 0)
        if not is_marker:
            continue
        for i in range(end - begin):
            code = codes[i]
            if prefixes[i] == 0xFF and code != 0 and code != 0xFF and not 0xD0 <= code <= 0xD7:
                return begin + i
    return -1
