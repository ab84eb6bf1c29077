"""Where on a ChArUco board a lattice of corners lies, as the markers in its squares tell.

Each marker read says where the lattice's first corner is on the board, and how the lattice is turned. What enough of
them say alike is so; a lattice that more than a few contradict is that of another board, and none of this one. Two rows
of markers must agree: those of one row stand alike on boards of other widths. A corner far from all markers that agree
is not named, since a lattice may have slipped on the way there.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from core.targets.charuco_ends import ends_early, goes_beyond
from core.targets.charuco_layout import CharucoLayout, column_aside, other_layout
from core.targets.growth import whole_lattice
from core.targets.lattice import Lattice
from core.targets.linking import BESIDE, link
from core.targets.marker_codes import MarkerCodes, nearest_markers
from core.targets.marker_reading import Readings, places_in_squares, read_markers
from core.targets.pyramid import Level
from core.targets.quantiles import median
from core.targets.saddles import find_saddles

_CONTRARY = 0.2  # of the markers that agree: so many may contradict them, misread or pasted there
_RIVALS = 2  # markers that agree on another place: another board's
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
    to the power `turn`; `agreeing` are the readings that say so, of the markers `markers`. `contrary` say anything
    else, `rivals` of them the same.
    """

    turn: int
    shift: Int[np.ndarray, "2"]
    agreeing: Int[np.ndarray, " n"]
    markers: Int[np.ndarray, " n"]
    contrary: int
    rivals: int


@dataclass(frozen=True, slots=True)
class PlacedLattice:
    """A lattice of the picture, and where its corners are on the board: for sure if it is `placed`.

    Of one that is `unread` too few markers were read to tell; it is placed by what most of those say. `column`, `row`
    (n,) of its known corners that are supported, `points_px` their places; `markers` the corners (px) of the markers
    that agree, in the order of `CharucoLayout.marker_corners`. `framed` of its squares have a black frame, `read` of
    them a marker of the dictionary. `ends_as_stated` of a placed one that ends where the same board with the other
    `legacy_layout` would go on.
    """

    verdict: Verdict
    framed: int
    read: int
    agreeing: int
    column: Int[np.ndarray, " n"]
    row: Int[np.ndarray, " n"]
    points_px: Float[np.ndarray, "n 2"]
    markers: dict[int, Float[np.ndarray, "4 2"]]
    ends_as_stated: bool = False


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
    votes = _votes(readings.place, readings.codes, layout, codes)
    if _is_sure(votes, layout, codes):
        return _placed("placed", image, lattice, readings, votes, layout)
    mirrored = _votes(readings.place[:, ::-1], readings.mirrored, layout, codes)
    if len(mirrored.markers) > len(votes.markers) and _is_sure(mirrored, layout, codes):
        return _placed("mirrored", image, lattice, readings, mirrored, layout)
    read = len(votes.markers) + votes.contrary
    against = is_contradicted(votes.contrary, len(votes.markers)) or votes.rivals >= _RIVALS
    verdict: Verdict = "contradicted" if against and read >= codes.least_agreeing else "unread"
    return _placed(verdict, image, lattice, readings, votes, layout)


def is_contradicted(contrary: int, agreeing: int) -> bool:
    """Tell whether more markers contradict those that agree than dirt makes."""
    return contrary > _CONTRARY * agreeing


def are_enough(markers: Collection[int], layout: CharucoLayout, codes: MarkerCodes) -> bool:
    """Tell whether so many markers that agree say where the board is: not by chance, and in two of its rows."""
    rows = layout.marker_squares[sorted(markers), 1]
    return len(rows) >= codes.least_agreeing and int(np.ptp(rows)) > 0


def _votes(
    place: Int[np.ndarray, "n 2"], read: np.ndarray, layout: CharucoLayout, codes: MarkerCodes
) -> Votes:
    """Return what most of the markers say; no turn and no shift where there are none."""
    nearest = nearest_markers(read, codes.codes, codes.wrong_bits)
    seen = np.flatnonzero(nearest[:, 0] >= 0)
    own = seen[nearest[seen, 0] < len(layout.marker_squares)]
    if len(own) == 0:
        return Votes(0, np.zeros(2, np.intp), own, own, len(seen), 0)
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
    contrary = len(seen) - int(counts[best])
    rivals = int(np.delete(counts, best).max(initial=0))
    return Votes(int(ways[best, 0]), ways[best, 1:], own[agree], marker[agree], contrary, rivals)


def _is_sure(votes: Votes, layout: CharucoLayout, codes: MarkerCodes) -> bool:
    """Tell whether enough markers agree, and too few contradict them."""
    if is_contradicted(votes.contrary, len(votes.markers)) or votes.rivals >= _RIVALS:
        return False
    return are_enough(votes.markers.tolist(), layout, codes)


def _placed(
    verdict: Verdict,
    image: np.ndarray,
    lattice: Lattice,
    readings: Readings,
    votes: Votes,
    layout: CharucoLayout,
) -> PlacedLattice:
    j, i = np.nonzero(lattice.known)
    column, row = (np.stack([i, j], axis=1) @ _matrix(votes.turn).T + votes.shift).T
    named = np.zeros(len(column), dtype=np.bool_)
    markers: dict[int, Float[np.ndarray, "4 2"]] = {}
    if verdict in ("placed", "unread") and len(votes.markers):
        size = (layout.target.columns, layout.target.rows)
        named = (column >= 0) & (column < size[0]) & (row >= 0) & (row < size[1])
        if goes_beyond(column, row, size) or goes_beyond(row, column, size[::-1]):
            verdict = "contradicted"
        elif verdict == "placed" and np.count_nonzero(named) < layout.target.size:
            margin = 0.5 * (1.0 - layout.marker_mm / layout.target.pitch_mm)
            if ends_early(image, *_by_name(lattice, readings, votes, layout), layout.black, margin):
                verdict = "contradicted"
        named &= _supported(column, row, layout.marker_squares[votes.markers])
        corners = _marker_corners(readings, votes, layout)
        markers = {int(votes.markers[k]): corners[k] for k in np.argsort(votes.markers)}
    return PlacedLattice(
        verdict,
        len(readings.codes),
        len(votes.markers) + votes.contrary,
        len(votes.markers),
        column[named],
        row[named],
        lattice.grid[j, i][named],
        markers,
        verdict == "placed" and _ends_as_stated(image, lattice, readings, votes, layout),
    )


def _ends_as_stated(
    image: np.ndarray, lattice: Lattice, readings: Readings, votes: Votes, layout: CharucoLayout
) -> bool:
    """Tell whether a lattice is seen to end where the other `legacy_layout`, a column aside, would go on."""
    aside = column_aside(votes.markers.tolist(), layout)
    if aside == 0:
        return False
    other = other_layout(layout)
    margin = 0.5 * (1.0 - layout.marker_mm / layout.target.pitch_mm)
    there = replace(votes, shift=votes.shift + np.array([aside, 0]))
    return ends_early(image, *_by_name(lattice, readings, there, other), other.black, margin)


def _by_name(
    lattice: Lattice, readings: Readings, votes: Votes, layout: CharucoLayout
) -> tuple[Float[np.ndarray, "rows columns 2"], Bool[np.ndarray, "rows columns"]]:
    """Return the places of the board's grid points from (-1, -1) to (columns, rows), and which of them are known."""
    rows, columns = readings.places_px.shape[:2]
    j, i = (a.ravel() for a in np.mgrid[-1 : rows - 1, -1 : columns - 1])
    column, row = (np.stack([i, j], axis=1) @ _matrix(votes.turn).T + votes.shift).T + 1
    size = (layout.target.rows + 2, layout.target.columns + 2)
    own = (column >= 0) & (column < size[1]) & (row >= 0) & (row < size[0])
    places, known = np.full((*size, 2), np.nan), np.zeros(size, dtype=np.bool_)
    places[row[own], column[own]] = readings.places_px.reshape(-1, 2)[own]
    known[row[own], column[own]] = np.pad(lattice.known, 1).ravel()[own]
    return places, known


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
