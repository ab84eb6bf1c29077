"""Whether a chessboard that seems to end goes on beyond something that lies across it: a cable, a ruler, a finger.

What lies across a board along a line of squares ends the lattice as the margin does, and evenly enough to be taken for
it. The squares beyond it distinguish the two: they continue the lattice in pitch, phase and colour. The lattice is
extrapolated by a homography and a cubic for the lens, and each line of squares beyond the outermost is looked at
in several depths, across its edges, close to them and further away. Tiles of another pitch or phase have their
edges elsewhere, and a reflection of the board has the colours of a line at the depth of the next one too.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Shaped

from core.geometry import find_homography, map_in_front
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
    crossed = tuple(_goes_on(image, lattice, extrapolated, side) for side in range(4))
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
        return np.stack([x**i * y**j for i in range(4) for j in range(4 - i)], axis=1)


def _goes_on(
    image: Shaped[np.ndarray, "h w"], lattice: Lattice, extrapolated: _Extrapolation, side: int
) -> bool:
    """Return whether there are squares of the lattice beyond one side: top, bottom, left, right."""
    rows, columns = lattice.gap.shape
    count, last = (columns, rows - 1) if side < 2 else (rows, columns - 1)
    lines = np.arange(_FIRST, _LAST)
    number, depth, along = (a.ravel() for a in np.meshgrid(lines, _DEPTHS, np.arange(count), indexing="ij"))
    outward = -(number + depth) if side in (0, 2) else last + number + depth
    cell = -number - 1 if side in (0, 2) else last + number
    # the square after an edge: bright where the sum of its indices has the origin's parity
    sign = np.where(((along + cell) % 2 == 0) == lattice.origin_is_bright, 1.0, -1.0)
    contrast = float(np.median(lattice.gap[lattice.known]))

    def levels(shift: float) -> Float[np.ndarray, " n"]:
        places = np.stack([along + shift, outward] if side < 2 else [outward, along + shift], axis=1)
        return nearest_levels(image, extrapolated(places))

    for phase in _PHASES:
        # In a right-handed lattice (x, y) and (y, x) have the same squares, so that one sign serves both.
        near = sign * (levels(phase + _NEAR) - levels(phase - _NEAR))
        far = sign * (levels(phase + _FAR) - levels(phase - _FAR))
        shape = (len(lines), len(_DEPTHS), count)
        seen = (np.isfinite(near) & np.isfinite(far)).reshape(shape)
        agree, contrary = (
            ((way * near > _MIN_STEP_NEAR * contrast) & (way * far > _MIN_STEP_FAR * contrast)).reshape(shape)
            for way in (1.0, -1.0)
        )
        enough = np.maximum(_MIN_EDGE_SHARE * seen.sum(axis=2), _MIN_EDGES)
        agrees = agree.sum(axis=2) >= enough
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
