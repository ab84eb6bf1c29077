"""Decode the tags in a lattice of an AprilGrid, and determine which part of the grid the lattice is.

The lines along the tags' sides make a lattice whose cells are tags, white gaps, and the squares in the gaps' crossings.
Every dark cell is decoded as if it were a tag. The grey levels of white and black are taken from the gap and from the
tag's border on all four sides, since light may change across a tag.

One decoded tag determines where the whole lattice lies on the grid. At least two have to agree: of words of 36 random
bits 3e-4 are within three bits of one of the family's 587 in one of four turns, and of these one in hundreds would then
be in its place. Where tags that were read well say otherwise the sheet is another one.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from core.targets.aprilgrid.layout import BORDER_CELLS, CODE_CELLS, DICTIONARY, TAG_CELLS, AprilGridLayout
from core.targets.markers import code_of, marker_codes, nearest_markers
from core.targets.subpixel import levels_between

MAX_HAMMING = 3
"""Of a tag that votes for where the lattice lies; two words of the family differ in 11 at least."""
MAX_CERTAIN_HAMMING = 1
"""Of a tag whose contradiction counts."""
_MIN_LEVELS = 3.0  # between white and black, grey levels of 256
_BORDER = BORDER_CELLS / TAG_CELLS
_MIN_SIDE_RATIO = (
    0.7  # of the larger of the two kinds of dark cells: smaller ones are the squares between tags
)
_MIN_SIDE_PX = 12.0  # in the image: cells of a tag of 1.2 px
_IN_CELL = (-0.2, 0.2)  # where a cell is looked at, in cells from its middle
_ALONG_SIDE = 6  # places on each side of border and gap
_TURNS = (((1, 0), (0, 1)), ((0, 1), (-1, 0)), ((-1, 0), (0, -1)), ((0, -1), (1, 0)))
"""The tag's x and y in the lattice's axes, where it is upright after so many turns by `numpy.rot90`."""
_UPPER_LEFT = ((0, 0), (1, 0), (1, 1), (0, 1))


@dataclass(frozen=True, slots=True)
class TagLattice:
    """A part of the grid as a lattice of corners.

    `tags` are those read in it that agree on where it lies: the corners of each in pixels of the full image, from its
    upper left clockwise. `conflicting` counts the tags that were read well and belong elsewhere; `displaced` are those
    of them that the grid has: the lattice may have a tear, at a highlight.
    """

    tags: dict[int, Float[np.ndarray, "4 2"]]
    conflicting: int
    is_mirrored: bool = False
    displaced: dict[int, Float[np.ndarray, "4 2"]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class _Cells:
    """Dark cells of a lattice: `place` (n, 2) of the corner with the lowest indices, from which on `corners_px`
    (n, 4, 2) go clockwise."""

    place: Int[np.ndarray, "n 2"]
    corners_px: Float[np.ndarray, "n 4 2"]


def read_lattice(
    image: Shaped[np.ndarray, "h w"],
    layout: AprilGridLayout,
    place: Int[np.ndarray, "n 2"],
    points_px: Float[np.ndarray, "n 2"],
) -> TagLattice | None:
    """Return the part of the grid that a lattice of corners is, or None where no tag can be read in it.

    Parameters
    ----------
    image
        The full image, grey.
    place
        Column and row of each corner in the lattice, right-handed; the square between (0, 0) and (1, 1) is bright.
    points_px
        Where the corners are, within some tenths of a tag's cell.
    """
    cells = _dark_cells(place, points_px)
    if len(cells.place) == 0:
        return None
    bits, readable = _read(image, cells.corners_px, layout.gap_mm / layout.tag_mm)
    codes = marker_codes(DICTIONARY).codes
    for is_mirrored in (False, True):
        seen = bits.transpose(0, 2, 1) if is_mirrored else bits
        number, turn, wrong = nearest_markers(code_of(seen), codes, MAX_HAMMING).T
        turn = -turn % 4  # from that of the tag to that of what was read
        read = np.flatnonzero(readable & (wrong <= MAX_HAMMING))
        if is_mirrored:
            read = read[number[read] < len(layout.tag_places)]
            if len(read) < 2:
                return None
            return TagLattice({}, 0, is_mirrored=True)
        if len(read):
            return _placed(layout, cells, read, number, turn, wrong)
    return None


def hamming_distances(
    image: Shaped[np.ndarray, "h w"],
    gap: float,
    codes: Bool[np.ndarray, "n 6 6"],
    corners_px: Float[np.ndarray, "n 4 2"],
) -> Int[np.ndarray, " n"]:
    """Return in how many bits the image differs from tags where they should be: corners from the upper left on,
    clockwise. All bits where there is no dark border in a bright surrounding, the gap (in sides of a tag)."""
    bits, readable = _read(image, corners_px, gap)
    different = np.sum(bits != codes, axis=(1, 2))
    return np.where(readable, different, CODE_CELLS**2)


def _dark_cells(place: Int[np.ndarray, "n 2"], points_px: Float[np.ndarray, "n 2"]) -> _Cells:
    """Return the closed dark cells; where they are of two sizes, the larger ones."""
    low = place.min(axis=0)
    table = np.full(tuple((place.max(axis=0) - low + 2)[::-1]), -1)
    table[place[:, 1] - low[1], place[:, 0] - low[0]] = np.arange(len(place))
    around = np.stack([table[:-1, :-1], table[:-1, 1:], table[1:, 1:], table[1:, :-1]], axis=2)
    j, i = np.nonzero((around >= 0).all(axis=2))
    is_dark = (i + low[0] + j + low[1]) % 2 == 1
    i, j = i[is_dark], j[is_dark]
    corners = points_px[around[j, i]]
    diagonals = corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]
    area = 0.5 * np.abs(diagonals[0][:, 0] * diagonals[1][:, 1] - diagonals[0][:, 1] * diagonals[1][:, 0])
    sides = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
    wanted = (area > _MIN_SIDE_PX * sides.max(axis=1)) & (sides.min(axis=1) > _MIN_SIDE_PX)
    kinds = [(i + low[0]) % 2 == kind for kind in range(2)]
    typical = [float(np.sqrt(np.median(area[kind]))) if kind.any() else 0.0 for kind in kinds]
    for kind, size in zip(kinds, typical, strict=True):
        if size < _MIN_SIDE_RATIO * max(typical):
            wanted &= ~kind
    return _Cells(np.stack([i + low[0], j + low[1]], axis=1)[wanted], corners[wanted])


def _read(
    image: Shaped[np.ndarray, "h w"], corners_px: Float[np.ndarray, "n 4 2"], gap: float
) -> tuple[Bool[np.ndarray, "n 6 6"], Bool[np.ndarray, " n"]]:
    """Return the code's cells, True where white, and whether there is a dark border in a bright surrounding at all.

    `gap` is its width in sides of a tag.
    """
    places = _looks(gap)
    values = _seen(image, corners_px, places)
    codes = CODE_CELLS**2 * len(_IN_CELL) ** 2
    cells = values[:, :codes].reshape(-1, CODE_CELLS, CODE_CELLS, len(_IN_CELL) ** 2).mean(axis=3)
    black, white = values[:, codes:].reshape(-1, 2, 4, _ALONG_SIDE).mean(axis=3).transpose(1, 0, 2)
    middle = (np.arange(CODE_CELLS) - 0.5 * (CODE_CELLS - 1)) / TAG_CELLS
    limit = np.zeros((len(values), CODE_CELLS, CODE_CELLS))
    for sides, apart in ((black, 1.0 - _BORDER), (white, 1.0 + gap)):
        along_y, along_x = (sides[:, 2] - sides[:, 0]) / apart, (sides[:, 1] - sides[:, 3]) / apart
        limit += 0.5 * sides.mean(axis=1)[:, None, None]
        limit += 0.5 * (along_y[:, None, None] * middle[:, None] + along_x[:, None, None] * middle)
    least = _MIN_LEVELS * (257.0 if image.dtype == np.uint16 else 1.0)
    return cells > limit, white.mean(axis=1) - black.mean(axis=1) > least


def _looks(gap: float) -> Float[np.ndarray, "k 2"]:
    """Return where a tag is looked at, in its sides from its upper left corner: some places in each cell of the code,
    then the border's and the gap's middles on the upper, right, lower and left side."""
    cell = (BORDER_CELLS + 0.5 + np.arange(CODE_CELLS)) / TAG_CELLS
    inside = np.array(_IN_CELL) / TAG_CELLS
    y, x, dy, dx = np.meshgrid(cell, cell, inside, inside, indexing="ij")
    places = [np.stack([(x + dx).ravel(), (y + dy).ravel()], axis=1)]
    along = (np.arange(_ALONG_SIDE) + 0.5) / _ALONG_SIDE
    for depth in (0.5 * _BORDER, -0.5 * gap):
        at, far = np.full(_ALONG_SIDE, depth), np.full(_ALONG_SIDE, 1.0 - depth)
        places += [np.stack(pair, axis=1) for pair in ((along, at), (far, along), (along, far), (at, along))]
    return np.concatenate(places)


def _seen(
    image: Shaped[np.ndarray, "h w"], corners_px: Float[np.ndarray, "n 4 2"], places: Float[np.ndarray, "k 2"]
) -> Float[np.ndarray, "n k"]:
    """Return the grey values at places of unit squares whose corners, clockwise, are given in pixels."""
    a, b, c, d = corners_px.transpose(1, 0, 2)
    # P. S. Heckbert, "Fundamentals of texture mapping and image warping" (1989), section 2.2.3
    p, q, s = b - c, d - c, a - b + c - d
    determinant = p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]
    determinant = np.where(np.abs(determinant) > 1e-9, determinant, np.inf)
    g = ((s[:, 0] * q[:, 1] - s[:, 1] * q[:, 0]) / determinant)[:, None]
    h = ((p[:, 0] * s[:, 1] - p[:, 1] * s[:, 0]) / determinant)[:, None]
    x, y = places.T
    scale = g * x + h * y + 1.0
    u, v = (
        ((b[:, k, None] * (1.0 + g) - a[:, k, None]) * x + (d[:, k, None] * (1.0 + h) - a[:, k, None]) * y)
        for k in range(2)
    )
    u, v = (u + a[:, :1]) / scale, (v + a[:, 1:]) / scale
    return levels_between(image, u, v)


def _placed(
    layout: AprilGridLayout,
    cells: _Cells,
    read: Int[np.ndarray, " r"],
    number: Int[np.ndarray, " c"],
    turn: Int[np.ndarray, " c"],
    wrong: Int[np.ndarray, " c"],
) -> TagLattice:
    """Return the lattice in the place on which most of the tags read agree; of equals, those read better."""
    votes: dict[int, tuple[int, int, int]] = {}
    for n in read:
        if number[n] < len(layout.tag_places):
            axes = np.array(_TURNS[turn[n]])
            shift = 2 * layout.tag_places[number[n]] - axes @ (cells.place[n] + _UPPER_LEFT[turn[n]])
            votes[int(n)] = (int(turn[n]), int(shift[0]), int(shift[1]))
    if not votes:
        return TagLattice({}, int(np.sum(wrong[read] <= MAX_CERTAIN_HAMMING)))
    count = Counter(votes.values())
    errors = {vote: sum(int(wrong[n]) for n, other in votes.items() if other == vote) for vote in count}
    chosen = min(count, key=lambda vote: (-count[vote], errors[vote], vote))
    agreeing = [n for n, vote in votes.items() if vote == chosen]
    others = [n for n in read if votes.get(int(n)) != chosen and wrong[n] <= MAX_CERTAIN_HAMMING]
    # clockwise from the lattice's first corner on; the tag's own first one comes as many places later
    tags, displaced = (
        {int(number[n]): np.roll(cells.corners_px[n], -int(turn[n]), axis=0) for n in some}
        for some in (agreeing, [n for n in others if int(n) in votes])
    )
    return TagLattice(tags, len(others), displaced=displaced)
