"""Determine where on a ChArUco board a lattice of corners lies, from the markers in its squares.

Each decoded marker votes for the place of the lattice's first corner on the board, and for the lattice's turn. The
lattice is placed by the vote of enough markers; if more than a few contradict it, it belongs to another board. Their
rows must determine its width: those of one row, and often of two adjacent ones, have the same places on boards of
other widths. A corner far from all agreeing markers is not labelled, since a lattice may have slipped on the way there.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from core.targets.candidates import patch_corners, whole_lattices
from core.targets.charuco.board_ends import PlacedCorners, extends_beyond, is_too_short
from core.targets.charuco.layout import CharucoLayout, column_offset, legacy_counterpart
from core.targets.charuco.marker_agreement import has_enough_markers, is_inconsistent
from core.targets.lattice import EDGE_SIDE_OFFSET, MIN_COSINE, Lattice, Level, find_saddles, link
from core.targets.markers import (
    DecodedMarkers,
    MarkerDictionary,
    decode_markers,
    decode_small_markers,
    nearest_markers,
    places_in_squares,
)

_MIN_READ = 0.2
"""Share of a lattice's frames that read as markers of the dictionary, for these to say that the board is another one.
Out of focus, or of another dictionary, a few read as some marker by chance; of a sharp board nearly all do."""
_RIVALS = 2  # markers that agree on another place: another board's
_MAX_PATCHES = 12  # of a level, the largest
_PLAIN = 0.9  # of the margin between a square's edges and its marker
_SIDE_OFFSET = 0.5  # of the margin: where an edge's two sides are looked at
_MIN_FINE_COSINE = 0.97  # 14°
_SUPPORT = 2.5  # squares, from a corner to the middle of a marker that agrees
_SMALL_CELL_PX = 2.5  # of a marker: narrower ones are read closely where looks in their middles fail
_MIN_READ_CLOSELY = 8  # corners of a lattice: fewer are clutter, or too few to be measured
_MOST = 0.8  # of the markers that a lattice can hold
_TURN = np.array([[0, -1], [1, 0]])

Verdict = Literal["placed", "contradicted", "mirrored", "unread"]


@dataclass(frozen=True, slots=True)
class PlacementVotes:
    """The votes of a lattice's markers, for one reading of the image (as it is, or mirrored).

    `turn` and `shift` (columns, rows) take the lattice's indices p to the board's, M p + shift with M the quarter turn
    to the power `turn`; `agreeing` are the readings that say so, of the markers `markers`. `conflicting` say anything
    else, `runner_up` of them the same.
    """

    turn: int
    shift: Int[np.ndarray, "2"]
    agreeing: Int[np.ndarray, " n"]
    markers: Int[np.ndarray, " n"]
    conflicting: int
    runner_up: int


@dataclass(frozen=True, slots=True)
class PlacedLattice:
    """A lattice of the image, and where its corners are on the board: certain if it is `placed`.

    Of one that is `unread` too few markers were decoded to decide; it is placed by the vote of most of them.
    `column`, `row` (n,) of its known corners that are supported, `points_px` their places; `markers` the corners
    (px) of the markers that agree, in the order of `CharucoLayout.marker_corners`. `framed` of its squares have a
    black frame, `read` of them a marker of the dictionary. `ends_as_stated` of a placed one that ends where the same
    board with the other `legacy_layout` would go on. `small_print` counts the squares with something printed in them
    where these are small, `square_px` wide.
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
    square_px: float = 0.0
    small_print: int = 0


def lattices_of(
    image: np.ndarray,
    level: Level,
    layout: CharucoLayout,
    *,
    is_fine: bool = False,
    known: Sequence[Lattice] = (),
) -> Iterator[Lattice]:
    """Return the lattices that a level's corners belong to, largest patch first, each once.

    On one that `is_fine` corners of the markers' cells are seen as well, so that neighbours must lie in line with
    edges. `known` lattices are not grown again.
    """
    margin = layout.margin
    saddles = find_saddles(level)
    cosine = _MIN_FINE_COSINE if is_fine else MIN_COSINE
    patches = link(saddles, min(EDGE_SIDE_OFFSET, _SIDE_OFFSET * margin), cosine)
    corners = patch_corners(level, saddles, patches, _MAX_PATCHES)
    return whole_lattices(image, corners, _one_square, _PLAIN * margin, known)


def locate_on_board(
    image: np.ndarray, lattice: Lattice, layout: CharucoLayout, codes: MarkerDictionary
) -> PlacedLattice:
    """Read a lattice's markers and place it on the board by them."""
    size = layout.marker_mm / layout.target.pitch_mm
    readings = decode_markers(image, lattice, codes.side, size)
    votes = _votes(readings.place, readings.codes, layout, codes)
    is_close, printed = False, 0
    is_small = layout.cell * lattice.square_px < _SMALL_CELL_PX
    if (
        is_small
        and np.count_nonzero(lattice.known) >= _MIN_READ_CLOSELY
        and not _are_most_read(votes, lattice)
    ):
        closely, printed = decode_small_markers(image, lattice, codes.side, size)
        more = _votes(closely.place, closely.codes, layout, codes)
        turned = _votes(closely.place[:, ::-1], closely.mirrored, layout, codes)
        if max(len(more.markers), len(turned.markers)) > len(votes.markers):
            readings, votes, is_close = closely, more, True
    if _is_sure(votes, layout, codes):
        return _placed("placed", image, lattice, readings, votes, layout)
    mirrored = _votes(readings.place[:, ::-1], readings.mirrored, layout, codes)
    if len(mirrored.markers) > len(votes.markers) and _is_sure(mirrored, layout, codes):
        return _placed("mirrored", image, lattice, readings, mirrored, layout)
    read = len(votes.markers) + votes.conflicting
    against = is_inconsistent(votes.conflicting, len(votes.markers)) or votes.runner_up >= _RIVALS
    if is_close:  # where few are read, one misread marker among them says nothing of the board
        against &= votes.conflicting > len(votes.markers)
    enough = max(codes.least_agreeing, _MIN_READ * len(readings.codes))
    verdict: Verdict = "contradicted" if against and read >= enough else "unread"
    placed = _placed(verdict, image, lattice, readings, votes, layout)
    return (
        replace(placed, square_px=lattice.square_px, small_print=printed) if verdict == "unread" else placed
    )


def _are_most_read(votes: PlacementVotes, lattice: Lattice) -> bool:
    """Return whether most of a lattice's bright squares, half of them all, have a marker that agrees."""
    known = lattice.known
    closed = known[:-1, :-1] & known[:-1, 1:] & known[1:, :-1] & known[1:, 1:]
    return bool(len(votes.markers) >= _MOST * 0.5 * np.count_nonzero(closed))


def _votes(
    place: Int[np.ndarray, "n 2"], read: np.ndarray, layout: CharucoLayout, codes: MarkerDictionary
) -> PlacementVotes:
    """Return the vote of most markers; no turn and no shift without markers."""
    nearest = nearest_markers(np.ascontiguousarray(read), codes.codes, codes.max_hamming)
    seen = np.flatnonzero(nearest[:, 0] >= 0)
    own = seen[nearest[seen, 0] < len(layout.marker_squares)]
    if len(own) == 0:
        return PlacementVotes(0, np.zeros(2, np.intp), own, own, len(seen), 0)
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
    conflicting = len(seen) - int(counts[best])
    runner_up = int(np.delete(counts, best).max(initial=0))
    return PlacementVotes(
        int(ways[best, 0]), ways[best, 1:], own[agree], marker[agree], conflicting, runner_up
    )


def _is_sure(votes: PlacementVotes, layout: CharucoLayout, codes: MarkerDictionary) -> bool:
    """Return whether enough markers agree, and too few contradict them."""
    if is_inconsistent(votes.conflicting, len(votes.markers)) or votes.runner_up >= _RIVALS:
        return False
    return has_enough_markers(votes.markers.tolist(), layout, codes)


def _placed(
    verdict: Verdict,
    image: np.ndarray,
    lattice: Lattice,
    readings: DecodedMarkers,
    votes: PlacementVotes,
    layout: CharucoLayout,
) -> PlacedLattice:
    j, i = np.nonzero(lattice.known)
    column, row = (np.stack([i, j], axis=1) @ _matrix(votes.turn).T + votes.shift).T
    named = np.zeros(len(column), dtype=np.bool_)
    markers: dict[int, Float[np.ndarray, "4 2"]] = {}
    if verdict in ("placed", "unread") and len(votes.markers):
        size = (layout.target.columns, layout.target.rows)
        named = (column >= 0) & (column < size[0]) & (row >= 0) & (row < size[1])
        is_beyond = extends_beyond(column, row, size) or extends_beyond(row, column, size[::-1])
        if is_beyond and verdict == "unread" and len(votes.markers) < _RIVALS:
            # one that was misread by chance
            votes = replace(votes, agreeing=votes.agreeing[:0], markers=votes.markers[:0])
            named[:] = False
        elif is_beyond:
            verdict = "contradicted"
        elif verdict == "placed" and np.count_nonzero(named) < layout.target.size:
            margin = layout.margin
            if is_too_short(image, _placed_corners(lattice, readings, votes, layout), margin):
                verdict = "contradicted"
        if len(votes.markers):
            named &= _supported(column, row, layout.marker_squares[votes.markers])
        corners = _marker_corners(readings, votes, layout)
        markers = {int(votes.markers[k]): corners[k] for k in np.argsort(votes.markers)}
    return PlacedLattice(
        verdict,
        len(readings.codes),
        len(votes.markers) + votes.conflicting,
        len(votes.markers),
        column[named],
        row[named],
        lattice.grid[j, i][named],
        markers,
        verdict == "placed" and _ends_as_stated(image, lattice, readings, votes, layout),
    )


def _ends_as_stated(
    image: np.ndarray,
    lattice: Lattice,
    readings: DecodedMarkers,
    votes: PlacementVotes,
    layout: CharucoLayout,
) -> bool:
    """Return whether a lattice is seen to end where the other `legacy_layout`, displaced by a column, would go on."""
    offset = column_offset(votes.markers.tolist(), layout)
    if offset == 0:
        return False
    other = legacy_counterpart(layout)
    margin = layout.margin
    there = replace(votes, shift=votes.shift + np.array([offset, 0]))
    return is_too_short(image, _placed_corners(lattice, readings, there, other), margin)


def _placed_corners(
    lattice: Lattice, readings: DecodedMarkers, votes: PlacementVotes, layout: CharucoLayout
) -> PlacedCorners:
    """Return the places of the board's grid points from (-1, -1) to (columns, rows)."""
    rows, columns = readings.places_px.shape[:2]
    j, i = (a.ravel() for a in np.mgrid[-1 : rows - 1, -1 : columns - 1])
    column, row = (np.stack([i, j], axis=1) @ _matrix(votes.turn).T + votes.shift).T + 1
    size = (layout.target.rows + 2, layout.target.columns + 2)
    own = (column >= 0) & (column < size[1]) & (row >= 0) & (row < size[0])
    places, known = np.full((*size, 2), np.nan), np.zeros(size, dtype=np.bool_)
    places[row[own], column[own]] = readings.places_px.reshape(-1, 2)[own]
    known[row[own], column[own]] = np.pad(lattice.known, 1).ravel()[own]
    return PlacedCorners(places, known, layout.black)


def _supported(
    column: Int[np.ndarray, " n"], row: Int[np.ndarray, " n"], squares: Int[np.ndarray, "k 2"]
) -> Bool[np.ndarray, " n"]:
    """Return which corners are near enough to one of the squares."""
    across = np.abs(np.subtract.outer(column, squares[:, 0] - 0.5))
    down = np.abs(np.subtract.outer(row, squares[:, 1] - 0.5))
    return np.asarray((np.maximum(across, down) <= _SUPPORT).any(axis=1))


def _marker_corners(
    readings: DecodedMarkers, votes: PlacementVotes, layout: CharucoLayout
) -> Float[np.ndarray, "n 4 2"]:
    """Return the places (px) of the corners of the agreeing markers, from the marker's own upper left on."""
    half = 0.5 * layout.marker_mm / layout.target.pitch_mm
    signs = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    # rows times the matrix: from the board's directions back to the lattice's
    in_square = 0.5 + half * signs @ _matrix(votes.turn)
    return places_in_squares(readings.places_px, readings.place[votes.agreeing], in_square)


def _matrix(turn: int) -> Int[np.ndarray, "2 2"]:
    return np.linalg.matrix_power(_TURN, turn)


def _one_square(_: Float[np.ndarray, "n 2"], lattice: Lattice) -> float:
    """Return the side of a lattice's squares: corners within one are its own, or those of what is printed in them."""
    return lattice.square_px
