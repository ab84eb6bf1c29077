"""PNG's pixels without libpng, for what industrial cameras send: grey, 8 or 16 bits, not interlaced.

The compressed stream is inflated in pieces small enough to stay in the processor's cache, and each piece is unfiltered
straight into the image: apart from the file and the image no buffer grows with their size. OpenCV decodes all other
kinds. The module is imported when the first image is decoded, since reading headers does not need it.

References: W3C, "Portable Network Graphics (PNG) Specification (Third Edition)", 2025, sections 9 (filtering) and 10
(compression); RFC 1950 (1996), the stream's wrapper and checksum.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator

import numpy as np
from isal import igzip_lib, isal_zlib
from jaxtyping import Int64, UInt8, UInt16

from core.errors import UndecodableImage
from core.image.layout import ImageHeader
from core.image.png import Chunk, read_chunks
from core.jit import jit

_METHODS_AT = slice(24, 29)
_GREY_NOT_INTERLACED = (b"\x08\0\0\0\0", b"\x10\0\0\0\0")
"""Depth, colour type and three methods, as stored in the header (section 11.2.1)."""

_HARMLESS = frozenset(
    (b"IDAT", b"tEXt", b"zTXt", b"iTXt", b"tIME", b"pHYs", b"gAMA", b"cHRM", b"sRGB", b"eXIf")
)
"""Chunks that leave grey values as they are (section 11.3)."""

_MAX_WINDOW = 7
"""Logarithm of the inflater's window, 8 subtracted (RFC 1950, section 2.2)."""

_INPUT_BYTES = 1 << 16
_OUTPUT_BYTES = 1 << 17
"""Pieces of the stream before and after inflating: together a fraction of a level-2 cache."""


def read_plain(
    data: memoryview, header: ImageHeader
) -> UInt8[np.ndarray, "h w"] | UInt16[np.ndarray, "h w"] | None:
    """Return the pixels, or None where OpenCV is to decode.

    Raises
    ------
    UndecodableImage
        The file is damaged or not whole.
    """
    if bytes(data[_METHODS_AT]) not in _GREY_NOT_INTERLACED:
        return None
    chunks = read_chunks(data, isal_zlib.crc32)
    names = [chunk.name for chunk in chunks]
    pixels = [chunk for chunk in chunks if chunk.name == b"IDAT"]
    if not _HARMLESS.issuperset(names[1:-1]):
        return None
    sample_bytes = header.bit_depth // 8
    image = np.empty((header.height_px, header.width_px), dtype=np.uint8 if sample_bytes == 1 else np.uint16)
    rows = image.view(np.uint8)
    state = np.zeros(2, dtype=np.int64)
    left = rows.size + len(rows)
    for piece in _inflate(data, pixels, left):
        left -= len(piece)
        if left < 0:  # more than the image: only libpng knows which such streams it takes
            return None
        if not unfilter(np.frombuffer(piece, dtype=np.uint8), rows, sample_bytes, state):
            raise UndecodableImage("The PNG file's pixels name a filter that does not exist.")
    if sample_bytes == 2 and sys.byteorder == "little":
        image.byteswap(inplace=True)
    return image


def _inflate(data: memoryview, pixels: list[Chunk], wanted: int) -> Iterator[bytes]:
    """Yield the stream of `wanted` bytes in pieces, or so much of a longer one as shows that it is longer."""
    method = next((data[chunk.start] for chunk in pixels if chunk.end > chunk.start), 0)
    if method >> 4 > _MAX_WINDOW:  # of all that is wrong with a stream, the one that isal does not see
        raise UndecodableImage("The PNG file's compressed pixels are damaged.")
    stream = igzip_lib.IgzipDecompressor(flag=igzip_lib.DECOMP_ZLIB)
    for block in _blocks(data, pixels):
        source: bytes | memoryview = block
        while not stream.eof:
            try:
                piece = stream.decompress(source, min(_OUTPUT_BYTES, wanted + 1))
            except igzip_lib.IsalError as error:  # type: ignore[misc]  # isal's stub calls the class an instance
                raise UndecodableImage("The PNG file's compressed pixels are damaged.") from error
            yield piece
            wanted -= len(piece)
            if wanted < 0:
                return
            if stream.needs_input:
                break
            source = b""
    if wanted or not stream.eof:
        raise UndecodableImage("The PNG file's compressed pixels end too early.")


def _blocks(data: memoryview, pixels: list[Chunk]) -> Iterator[bytes | memoryview]:
    """Yield the compressed stream in blocks of one size, whatever the sizes of the chunks."""
    held: list[memoryview] = []
    size = 0
    for chunk in pixels:
        start = chunk.start
        while start < chunk.end:
            part = data[start : min(start + _INPUT_BYTES - size, chunk.end)]
            held.append(part)
            size += len(part)
            start += len(part)
            if size == _INPUT_BYTES:
                yield held[0] if len(held) == 1 else b"".join(held)
                held.clear()
                size = 0
    yield b"".join(held)


@jit("Array(u1, 1, 'C', readonly=True), u1[:, ::1], i8, i8[::1]")
def unfilter(
    piece: UInt8[np.ndarray, " n"], rows: UInt8[np.ndarray, "h w"], step: int, state: Int64[np.ndarray, " 2"]
) -> bool:
    """Undo the filters of the next piece of the stream; False where it names one that does not exist.

    Parameters
    ----------
    piece
        The inflated stream's next bytes; bytes beyond the image are not read.
    rows
        The image's bytes, written from where the piece before this one ended.
    step
        Bytes from a pixel to its right neighbour.
    state
        Bytes of the stream taken so far, the filter of the present row: zeros at first, updated in place.
    """
    height, width = rows.shape
    taken = 0
    while taken < piece.size:
        row, place = divmod(state[0], width + 1)
        if row >= height:
            return True
        if place == 0:
            if piece[taken] > 4:
                return False
            state[1] = piece[taken]
            state[0] += 1
            taken += 1
            continue
        begin = place - 1
        end = min(width, begin + piece.size - taken)
        filtered = piece[taken : taken + end - begin]
        # Zeros stand above the first row. As many as the run has: a row may consist of any number of pieces.
        above = rows[row - 1, begin:end] if row > 0 else np.zeros(end - begin, dtype=np.uint8)
        if step == 1:
            left = rows[row, begin - 1] if begin > 0 else np.uint8(0)
            corner = rows[row - 1, begin - 1] if row > 0 and begin > 0 else np.uint8(0)
            _unfilter_run(filtered, rows[row, begin:end], above, left, corner, state[1])
        else:
            for at in range(begin, min(begin + step, end)):
                left = rows[row, at - step] if at >= step else np.uint8(0)
                corner = rows[row - 1, at - step] if row > 0 and at >= step else np.uint8(0)
                _unfilter_run(
                    filtered[at - begin :: step],
                    rows[row, at:end:step],
                    above[at - begin :: step],
                    left,
                    corner,
                    state[1],
                )
        taken += end - begin
        state[0] += end - begin
    return True


@jit(
    "Array(u1, 1, 'C', readonly=True), u1[::1], u1[::1], u1, u1, i8",
    "Array(u1, 1, 'A', readonly=True), u1[:], u1[:], u1, u1, i8",
)
def _unfilter_run(
    filtered: UInt8[np.ndarray, " n"],
    run: UInt8[np.ndarray, " n"],
    above: UInt8[np.ndarray, " n"],
    left: np.uint8,
    corner: np.uint8,
    kind: int,
) -> None:
    """Undo one filter (section 9.2) over bytes of a row that lie a pixel apart and so depend on each other.

    `left` and `corner` stand before the first of `run` and of `above`. The byte just made stays in a register: what the
    next one has to wait for decides the speed.
    """
    before = np.int32(left)
    if kind == 0:
        for i in range(run.size):
            run[i] = filtered[i]
    elif kind == 1:
        for i in range(run.size):
            before = np.int32((before + filtered[i]) & 255)
            run[i] = before
    elif kind == 2:
        for i in range(run.size):
            run[i] = filtered[i] + above[i]
    elif kind == 3:
        for i in range(run.size):
            before = np.int32((((before + above[i]) >> 1) + filtered[i]) & 255)
            run[i] = before
    else:
        diagonal = np.int32(corner)
        for i in range(run.size):
            # The predictor is the one of left, up and corner nearest to left + up - corner: the larger of left and up
            # if 3 corner <= left + up + the smaller of them, the smaller if 3 corner >= left + up + the larger, else
            # the corner. Solved for `before`, this leaves two thresholds that are known ahead of it.
            up = np.int32(above[i])
            rest = np.int32(3 * diagonal - up)
            most = min(np.int32(rest >> 1), np.int32(rest - up))
            least = max(np.int32((rest + 1) >> 1), np.int32(rest - up))
            predictor = min(before, up) if before <= most else diagonal
            predictor = max(before, up) if before >= least else predictor
            before = np.int32((predictor + filtered[i]) & 255)
            run[i] = before
            diagonal = up
