"""Whether a chessboard that seems to end goes on beyond something that lies across it: a cable, a ruler, a finger.

What lies across a board along a line of squares ends the lattice as the margin does, and evenly enough to be taken for
it. The squares beyond it distinguish the two: they continue the lattice in pitch, phase and colour. The lattice is
extrapolated by a homography and a cubic for the lens, and each line of squares beyond the outermost is looked at
in several depths, across its edges, close to them and further away. Tiles of another pitch or phase have their
edges elsewhere, and a reflection of the board has the colours of a line at the depth of the next one too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float, Shaped

from core.geometry import find_homography, map_in_front
from core.numerics import median
from core.targets.chessboard.fiducial_dots import decode_fiducial_dots, marked_squares
from core.targets.lattice import Board, Lattice
from core.targets.specification import TargetSpec
from core.targets.subpixel import nearest_levels

_FIRST, _LAST = 1, 4  # lines of squares beyond the outermost corners; line 0 is the board's own
_DEPTHS = (0.15, 0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.85)  # of a line of squares; three in a row must agree
_NEAR, _FAR = 0.13, 0.35  # of a square, to both sides of an edge
_MIN_STEP_NEAR, _MIN_STEP_FAR = 0.15, 0.4  # of the contrast at the board's corners
_PHASES = (-0.06, 0.0, 0.06)  # of a square, what a lens may displace the extrapolated edges by
_MIN_EDGES = 3  # in the image
_MIN_EDGE_SHARE = 0.8  # of those in the image
_FEW_DEPTHS = (0.25, 0.5, 0.75)  # the same for a first look at few places
_MIN_FEW_SHARE, _MIN_STEP_FEW = 0.7, 0.3
_MAX_CONTRARY_SHARE = 0.15  # of the edges that agree
_MIN_OF_CUBIC = 30  # corners; fewer determine a homography alone


def with_crossed_sides(image: Shaped[np.ndarray, "h w"], board: Board) -> Board:
    """Return a board that seems whole with those of its sides that something lies across marked as such."""
    if not board.is_whole or not board.is_resolved:
        return board
    lattice = board.lattice
    row, column = np.nonzero(lattice.known)
    places, points = np.stack([column, row], axis=1).astype(np.float64), lattice.grid[row, column]
    H = find_homography(places, points)
    if H is None:
        return board
    extrapolated = _Extrapolation(H, places, points)
    candidates = _may_go_on(image, lattice, extrapolated)
    crossed = tuple(
        bool(candidates[side]) and _goes_on(image, lattice, extrapolated, side) for side in range(4)
    )
    if not any(crossed) or _is_marked_whole(image, lattice):
        return board
    above, below, before, after = (
        replace(side, is_crossed=is_crossed) for side, is_crossed in zip(board.sides, crossed, strict=True)
    )
    return replace(board, sides=(above, below, before, after))


class _Extrapolation:
    """The map of a lattice's columns and rows to the image: a homography, and a cubic polynomial of what is left."""

    def __init__(
        self, H: Float[np.ndarray, "3 3"], places: Float[np.ndarray, "n 2"], points: Float[np.ndarray, "n 2"]
    ) -> None:
        self._H = H
        self._middle = places.mean(axis=0)
        self._scale = float(np.ptp(places, axis=0).max())
        self._rest: Float[np.ndarray, "10 2"] | None = None
        if len(points) >= _MIN_OF_CUBIC:
            left = points - map_in_front(H, places)
            self._rest = np.linalg.lstsq(self._terms(places), left, rcond=1e-6)[0]

    def __call__(self, places: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Return the image of places, NaN behind the camera."""
        drawn = map_in_front(self._H, places)
        return drawn if self._rest is None else drawn + self._terms(places) @ self._rest

    def _terms(self, places: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 10"]:
        x, y = ((places - self._middle) / self._scale).T
        xx, xy, yy = x * x, x * y, y * y
        terms = [np.ones(len(x)), x, y, xx, xy, yy, xx * x, xx * y, x * yy, yy * y]
        return np.array(terms).T


@dataclass(frozen=True, slots=True)
class _Edges:
    """Places on the edges between squares beyond one side of a lattice, (lines, depths, edges) of them in order.

    `sign` is 1 where the square after an edge should be bright, else -1.
    """

    x: Float[np.ndarray, " n"]
    y: Float[np.ndarray, " n"]
    sign: Float[np.ndarray, " n"]
    along_x: bool
    shape: tuple[int, int, int]

    def shifted(self, by: float) -> Float[np.ndarray, "n 2"]:
        """Return places as far along the side from the edges, squares."""
        return np.stack([self.x + by, self.y] if self.along_x else [self.x, self.y + by], axis=1)


@lru_cache(maxsize=64)
def _edges(rows: int, columns: int, origin_is_bright: bool, side: int, depths: tuple[float, ...]) -> _Edges:
    """Return the edges beyond a side (top, bottom, left, right), each at some depths of each line of squares."""
    count, last = (columns, rows - 1) if side < 2 else (rows, columns - 1)
    lines = np.arange(_FIRST, _LAST)
    number, depth, along = (
        a.ravel() for a in np.meshgrid(lines, depths, np.arange(count, dtype=np.float64), indexing="ij")
    )
    is_before = side in (0, 2)
    outward = -(number + depth) if is_before else last + number + depth
    cell = -number - 1 if is_before else last + number
    # In a right-handed lattice (x, y) and (y, x) have the same squares, so that one sign serves both directions.
    sign = np.where(((along + cell) % 2 == 0) == origin_is_bright, 1.0, -1.0)
    x, y = (along, outward) if side < 2 else (outward, along)
    return _Edges(x, y, sign, side < 2, (len(lines), len(depths), count))


def _contrast(lattice: Lattice) -> float:
    return median(lattice.gap[lattice.known])


def _may_go_on(
    image: Shaped[np.ndarray, "h w"], lattice: Lattice, extrapolated: _Extrapolation
) -> Bool[np.ndarray, "4"]:
    """Return which sides have squares beyond them by a look at few places: hardly any board's margin has."""
    sides = [_edges(*lattice.gap.shape, lattice.origin_is_bright, side, _FEW_DEPTHS) for side in range(4)]
    places = np.concatenate([edges.shifted(by) for by in (_FAR, -_FAR) for edges in sides])
    after, before = np.split(nearest_levels(image, extrapolated(places), 0), 2)
    steps = np.concatenate([edges.sign for edges in sides]) * (after - before)
    likely, seen = steps > _MIN_STEP_FEW * _contrast(lattice), np.isfinite(steps)
    may_go_on = np.zeros(4, dtype=np.bool_)
    first = 0
    for side, edges in enumerate(sides):
        part = slice(first, first + len(edges.sign))
        agree, in_image = (which[part].reshape(edges.shape).sum(axis=2) for which in (likely, seen))
        may_go_on[side] = np.any(agree >= np.maximum(_MIN_FEW_SHARE * in_image, _MIN_EDGES))
        first = part.stop
    return may_go_on


def _goes_on(
    image: Shaped[np.ndarray, "h w"], lattice: Lattice, extrapolated: _Extrapolation, side: int
) -> bool:
    """Return whether there are squares of the lattice beyond one side."""
    edges = _edges(*lattice.gap.shape, lattice.origin_is_bright, side, _DEPTHS)
    contrast = _contrast(lattice)

    def step(phase: float, to_side: float) -> Float[np.ndarray, " n"]:
        after, before = (
            nearest_levels(image, extrapolated(edges.shifted(phase + by))) for by in (to_side, -to_side)
        )
        return edges.sign * (after - before)

    for phase in _PHASES:
        near, far = step(phase, _NEAR), step(phase, _FAR)
        seen = (np.isfinite(near) & np.isfinite(far)).reshape(edges.shape)
        agree, contrary = (
            (way * near > _MIN_STEP_NEAR * contrast) & (way * far > _MIN_STEP_FAR * contrast)
            for way in (1.0, -1.0)
        )
        enough = np.maximum(_MIN_EDGE_SHARE * seen.sum(axis=2), _MIN_EDGES)
        agrees = agree.reshape(edges.shape).sum(axis=2) >= enough
        runs = agrees[:, 2:] & agrees[:, 1:-1] & agrees[:, :-2]
        if runs.any() and contrary.sum() <= _MAX_CONTRARY_SHARE * agree.sum():
            return True
    return False


def _is_marked_whole(image: Shaped[np.ndarray, "h w"], lattice: Lattice) -> bool:
    """Return whether the marks of a board are where a whole one of the lattice's size has them."""
    rows, columns = lattice.gap.shape
    for reading in decode_fiducial_dots(image, lattice):
        size = (columns, rows) if reading.turns % 2 == 0 else (rows, columns)
        marks = marked_squares(TargetSpec("chessboard", *size, 1.0))
        if marks and (reading.column, reading.row) == marks[0]:
            return True
    return False
