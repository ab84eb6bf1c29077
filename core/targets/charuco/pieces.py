"""Merge the lattices of one ChArUco board that an image shows.

An obstacle in front of a board may split it into several lattices. They are merged if they belong to one board: they
share markers, at the same places, or lie where the plane through the part with most markers has them, up to lens
distortion. The same marker at two places means two boards; a much smaller one is a print or a reflection of a board.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from core.errors import TargetMismatch
from core.geometry import find_homography, map_in_front
from core.targets.charuco.layout import CharucoLayout
from core.targets.charuco.marker_agreement import has_enough_markers
from core.targets.charuco.placement import PlacedLattice
from core.targets.markers import MarkerDictionary
from core.targets.specification import TargetSpec

_SAME = 0.5  # of a marker's side: what is nearer is the same marker
_OFF_PLANE, _BENT = 0.5, 0.15  # squares; the latter for each square of distance, as lenses bend
_MIN_EXTENT = 0.25  # of the larger board's: a smaller one is ignored


@dataclass(frozen=True, slots=True)
class LatticePiece:
    """Grid points of a board and their places in the image, to some px, row by row; and the markers (px) by id."""

    column: Int[np.ndarray, " n"]
    row: Int[np.ndarray, " n"]
    points_px: Float[np.ndarray, "n 2"]
    markers: Mapping[int, Float[np.ndarray, "4 2"]]

    def __len__(self) -> int:
        return len(self.column)


def merge_pieces(
    lattices: Sequence[PlacedLattice], layout: CharucoLayout, codes: MarkerDictionary
) -> LatticePiece | None:
    """Return the board that the lattices make, one that is placed for sure or several that are so together; else None.

    Raises TargetMismatch where two boards of about one size are in view.
    """
    usable = [lattice for lattice in lattices if lattice.verdict in ("placed", "unread") and lattice.markers]
    usable.sort(key=lambda lattice: (lattice.verdict != "placed", -lattice.agreeing))
    if not usable:
        return None
    parts, markers = [usable[0]], dict(usable[0].markers)
    for lattice in usable[1:]:
        common = lattice.markers.keys() & markers.keys()
        if any(_apart(lattice.markers[k], markers[k]) for k in common):
            if lattice.verdict == "placed" and _extent_px(lattice) > _MIN_EXTENT * _extent_px(usable[0]):
                raise TargetMismatch(
                    f"{len(common)} of the ChArUco board's markers are in view more than once.",
                    "Cover the other boards with the same markers, and mirrors.",
                )
            continue
        if _belongs(lattice, usable[0], markers):
            parts.append(lattice)
            markers = {**lattice.markers, **markers}
    if not has_enough_markers(markers, layout, codes) or any(
        _belongs(lattice, parts[0], markers) for lattice in lattices if lattice.verdict == "contradicted"
    ):
        return None
    return _union(parts, markers, layout.target)


def corners_in_view(part: LatticePiece, target: TargetSpec, shape: Sequence[int]) -> int:
    """Return how many of the board's corners should be in the image, by the plane through those of a part."""
    if len(part) == target.size:
        return target.size
    H = find_homography(_cells(part), part.points_px)
    if H is None:
        return target.size
    row, column = (a.ravel() for a in np.mgrid[0 : target.rows, 0 : target.columns])
    places = map_in_front(H, np.stack([column, row], axis=1))
    inside = np.all(places >= 1.0, axis=1) & np.all(places <= np.array(shape[1::-1]) - 2.0, axis=1)
    return int(np.count_nonzero(inside))


def _belongs(
    lattice: PlacedLattice, first: PlacedLattice, markers: Mapping[int, Float[np.ndarray, "4 2"]]
) -> bool:
    """Return whether a lattice is of the same board: it shares markers, or all its markers put it in that plane.

    One that is contradicted though all its markers agree ends where that board must not.
    """
    if lattice.verdict == "contradicted" and lattice.agreeing < lattice.read:
        return False
    common = lattice.markers.keys() & markers.keys()
    if common:
        return not any(_apart(lattice.markers[k], markers[k]) for k in common)
    return lattice.agreeing == lattice.read > 0 and _is_in_plane(lattice, first)


def _union(
    parts: Sequence[PlacedLattice], markers: Mapping[int, Float[np.ndarray, "4 2"]], target: TargetSpec
) -> LatticePiece:
    """Return all corners, each where the first part that has it has it."""
    column, row = (np.concatenate([getattr(part, name) for part in parts]) for name in ("column", "row"))
    points = np.concatenate([part.points_px for part in parts])
    _, first = np.unique(row * target.columns + column, return_index=True)
    return LatticePiece(
        column[first], row[first], points[first], {number: markers[number] for number in sorted(markers)}
    )


def _apart(one: Float[np.ndarray, "4 2"], other: Float[np.ndarray, "4 2"]) -> bool:
    """Return whether two markers are at different places."""
    side = float(np.linalg.norm(np.diff(one, axis=0), axis=1).min())
    return bool(np.linalg.norm(one.mean(axis=0) - other.mean(axis=0)) > _SAME * side)


def _extent_px(lattice: PlacedLattice) -> float:
    return float(np.max(np.ptp(lattice.points_px, axis=0))) if len(lattice.points_px) else 0.0


def _is_in_plane(lattice: PlacedLattice, first: PlacedLattice) -> bool:
    """Return whether a lattice lies where the plane through the first one has it."""
    H = find_homography(_cells(first), first.points_px)
    if H is None or len(lattice.column) == 0:
        return False
    cells = _cells(lattice)
    places, right, below = (map_in_front(H, cells + step) for step in ((0, 0), (1, 0), (0, 1)))
    square = np.maximum(np.linalg.norm(right - places, axis=1), np.linalg.norm(below - places, axis=1))
    away = np.maximum(
        np.abs(np.subtract.outer(lattice.column, first.column)),
        np.abs(np.subtract.outer(lattice.row, first.row)),
    ).min(axis=1)
    off = np.linalg.norm(lattice.points_px - places, axis=1) / square
    return bool(np.median(off / (_OFF_PLANE + _BENT * away)) < 1.0)  # NaN behind the camera


def _cells(points: LatticePiece | PlacedLattice) -> Float[np.ndarray, "n 2"]:
    return np.stack([points.column, points.row], axis=1).astype(np.float64)
