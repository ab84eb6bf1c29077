"""Where on a ChArUco board a lattice of corners lies, as the markers in its squares tell.

Each marker read says where the lattice's first corner is on the board, and how the lattice is turned. What enough of
them say alike is so; a lattice that more than a few contradict is that of another board, and none of this one. Two rows
of markers must agree: those of one row stand alike on boards of other widths. A corner far from all markers that agree
is not named, since a lattice may have slipped on the way there.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from core.targets.charuco_layout import CharucoLayout
from core.targets.growth import whole_lattice
from core.targets.lattice import Lattice
from core.targets.linking import BESIDE, link
from core.targets.marker_codes import MarkerCodes, nearest_markers
from core.targets.marker_reading import Readings, places_in_squares, read_markers
from core.targets.pyramid import Level
from core.targets.quantiles import median
from core.targets.saddles import find_saddles

CONTRARY = 0.125  # of the markers that agree: so many may contradict them
_LEAST_PATCH = 4  # corners: one closed cell
_MOST_PATCHES = 12  # of a level, the largest
_PLAIN = 0.9  # of the margin between a square's edges and its marker
_BESIDE = 0.5  # of the margin: where an edge's two sides are looked at
_SUPPORT = 2.5  # squares, from a corner to the middle of a marker that agrees
_TURN = np.array([[0, -1], [1, 0]])

Verdict = Literal["placed", "contradicted", "mirrored", "unread"]


@dataclass(frozen=True, slots=True)
class Votes:
    """What the markers of a lattice say, for one way of taking the picture (as it is, or mirrored).

    `turn` and `shift` (columns, rows) take the lattice's indices p to the board's, M p + shift with M the quarter turn
    to the power `turn`; `agreeing` are the readings that say so, of the markers `markers`, and `contrary` how many say
    anything else.
    """

    turn: int
    shift: Int[np.ndarray, "2"]
    agreeing: Int[np.ndarray, " n"]
    markers: Int[np.ndarray, " n"]
    contrary: int


@dataclass(frozen=True, slots=True)
class PlacedLattice:
    """A lattice of the picture, and where its corners are on the board: for sure if it is `placed`.

    Of one that is `unread` too few markers were read to tell; it is placed by what most of those say. `column`, `row`
    (n,) of its known corners that are supported, `points_px` their places; `markers` the corners (px) of the markers
    that agree, in the order of `CharucoLayout.marker_corners`. `framed` of its squares have a black frame, `read` of
    them a marker of the dictionary.
    """

    verdict: Verdict
    framed: int
    read: int
    agreeing: int
    column: Int[np.ndarray, " n"]
    row: Int[np.ndarray, " n"]
    points_px: Float[np.ndarray, "n 2"]
    markers: dict[int, Float[np.ndarray, "4 2"]]


def lattices_of(image: np.ndarray, level: Level, layout: CharucoLayout) -> Iterator[Lattice]:
    """Yield the lattices that a level's corners belong to, largest patch first, each once."""
    margin = 0.5 * (1.0 - layout.marker_mm / layout.target.pitch_mm)
    saddles = find_saddles(level)
    patches = link(saddles, min(BESIDE, _BESIDE * margin))
    grown: list[Lattice] = []
    for number in range(min(len(patches.sizes), _MOST_PATCHES)):
        if patches.sizes[number] < _LEAST_PATCH:
            return
        members = np.flatnonzero(patches.patch == number)
        points = level.to_full(saddles.points[members])
        if any(_is_inside(points, lattice) for lattice in grown):
            continue
        lattice = whole_lattice(image, points, patches.place[members], _PLAIN * margin)
        if lattice.known.sum() >= _LEAST_PATCH:
            grown.append(lattice)
            yield lattice


def place_lattice(
    image: np.ndarray, lattice: Lattice, layout: CharucoLayout, codes: MarkerCodes
) -> PlacedLattice:
    """Read a lattice's markers and place it on the board by them."""
    size = layout.marker_mm / layout.target.pitch_mm
    readings = read_markers(image, lattice, codes.side, size)
    as_seen = _votes(readings.place, readings.codes, layout, codes)
    if _is_sure(as_seen, layout, codes):
        return _placed("placed", lattice, readings, as_seen, layout)
    mirrored = _votes(readings.place[:, ::-1], readings.mirrored, layout, codes)
    if _is_sure(mirrored, layout, codes):
        return _placed("mirrored", lattice, readings, mirrored, layout)
    read = len(as_seen.agreeing) + as_seen.contrary
    return _placed(
        "contradicted" if read >= codes.least_agreeing else "unread", lattice, readings, as_seen, layout
    )


def _votes(
    place: Int[np.ndarray, "n 2"], read: np.ndarray, layout: CharucoLayout, codes: MarkerCodes
) -> Votes:
    """Return what most of the markers say; no turn and no shift where there are none."""
    nearest = nearest_markers(read, codes.codes, codes.wrong_bits)
    seen = np.flatnonzero(nearest[:, 0] >= 0)
    own = seen[nearest[seen, 0] < len(layout.marker_squares)]
    if len(own) == 0:
        return Votes(0, np.zeros(2, np.intp), own, own, len(seen))
    marker, turn = nearest[own, 0], nearest[own, 1]
    shift = np.empty((len(own), 2), np.intp)
    for quarter in range(4):
        chosen = turn == quarter
        # twice the middle of a square: whole numbers
        middle = 2 * layout.marker_squares[marker[chosen]] - 1
        shift[chosen] = (middle - (2 * place[own[chosen]] + 1) @ _matrix(quarter).T) // 2
    said = np.column_stack([turn, shift])
    ways, which, counts = np.unique(said, axis=0, return_inverse=True, return_counts=True)
    best = int(np.argmax(counts))
    agree = which.ravel() == best
    return Votes(int(ways[best, 0]), ways[best, 1:], own[agree], marker[agree], len(seen) - int(agree.sum()))


def _is_sure(votes: Votes, layout: CharucoLayout, codes: MarkerCodes) -> bool:
    """Tell whether enough markers agree, in two rows of the board, and too few contradict them."""
    if len(votes.markers) < codes.least_agreeing or votes.contrary > CONTRARY * len(votes.markers):
        return False
    return bool(np.ptp(layout.marker_squares[votes.markers, 1]) > 0)


def _placed(
    verdict: Verdict, lattice: Lattice, readings: Readings, votes: Votes, layout: CharucoLayout
) -> PlacedLattice:
    j, i = np.nonzero(lattice.known)
    column, row = (np.stack([i, j], axis=1) @ _matrix(votes.turn).T + votes.shift).T
    supported = np.zeros(len(column), dtype=np.bool_)
    markers: dict[int, Float[np.ndarray, "4 2"]] = {}
    if verdict != "mirrored" and len(votes.markers):
        supported = _supported(column, row, layout.marker_squares[votes.markers])
        supported &= (
            (column >= 0) & (column < layout.target.columns) & (row >= 0) & (row < layout.target.rows)
        )
        corners = _marker_corners(readings, votes, layout)
        markers = {int(votes.markers[k]): corners[k] for k in np.argsort(votes.markers)}
    return PlacedLattice(
        verdict,
        len(readings.codes),
        len(votes.agreeing) + votes.contrary,
        len(votes.agreeing),
        column[supported],
        row[supported],
        lattice.grid[j, i][supported],
        markers,
    )


def _supported(
    column: Int[np.ndarray, " n"], row: Int[np.ndarray, " n"], squares: Int[np.ndarray, "k 2"]
) -> Bool[np.ndarray, " n"]:
    """Tell which corners are near enough to one of the squares."""
    across = np.abs(np.subtract.outer(column, squares[:, 0] - 0.5))
    down = np.abs(np.subtract.outer(row, squares[:, 1] - 0.5))
    return np.asarray((np.maximum(across, down) <= _SUPPORT).any(axis=1))


def _marker_corners(readings: Readings, votes: Votes, layout: CharucoLayout) -> Float[np.ndarray, "n 4 2"]:
    """Return where the corners of the markers that agree are in the picture, from the marker's own upper left on."""
    half = 0.5 * layout.marker_mm / layout.target.pitch_mm
    signs = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    # rows times the matrix: from the board's directions back to the lattice's
    in_square = 0.5 + half * signs @ _matrix(votes.turn)
    return places_in_squares(readings.places_px, readings.place[votes.agreeing], in_square)


def _matrix(turn: int) -> Int[np.ndarray, "2 2"]:
    return np.linalg.matrix_power(_TURN, turn)


def _is_inside(points: Float[np.ndarray, "n 2"], lattice: Lattice) -> bool:
    """Tell whether most of a patch's corners lie between those of a lattice that was grown already: they are its own,
    or those of what is printed in its squares."""
    known = lattice.grid[lattice.known]
    few = points[:: max(1, len(points) // 5)]
    areas = _areas(lattice.grid)
    square = np.sqrt(median(areas)) if len(areas) else 0.0
    near = np.hypot(*(few[:, None] - known[None]).transpose(2, 0, 1)).min(axis=1)
    return bool(np.median(near) < square)


def _areas(grid: Float[np.ndarray, "rows columns 2"]) -> Float[np.ndarray, " n"]:
    across, down = (grid[:-1, 1:] - grid[:-1, :-1]), (grid[1:, :-1] - grid[:-1, :-1])
    areas = np.abs(across[..., 0] * down[..., 1] - across[..., 1] * down[..., 0])
    return np.asarray(areas[np.isfinite(areas)])
