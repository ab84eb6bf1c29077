"""The parts of one ChArUco board that a picture shows, joined.

What stands in front of a board may leave several lattices of it. They are joined if they are of one board: they have
markers in common, at the same places, or lie where the plane through the part with most markers has them, within what a
lens may bend. The same marker at two places means two boards; one much smaller is a picture or a reflection of a board.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Int

from core.errors import TargetMismatch
from core.targets.charuco_lattice import PlacedLattice, are_enough
from core.targets.charuco_layout import CharucoLayout
from core.targets.marker_codes import MarkerCodes
from core.targets.specification import TargetSpec

_SAME = 0.5  # of a marker's side: what is nearer is the same marker
_OFF_PLANE, _BENT = 0.5, 0.15  # squares; the latter for each square of distance, as lenses bend
_LEAST_EXTENT = 0.25  # of the larger board's: a smaller one does not count beside it


@dataclass(frozen=True, slots=True)
class Part:
    """Grid points of a board and where they are in the picture, to some px, row by row; and the markers (px) by id."""

    column: Int[np.ndarray, " n"]
    row: Int[np.ndarray, " n"]
    points_px: Float[np.ndarray, "n 2"]
    markers: Mapping[int, Float[np.ndarray, "4 2"]]

    def __len__(self) -> int:
        return len(self.column)


def joined(lattices: Sequence[PlacedLattice], layout: CharucoLayout, codes: MarkerCodes) -> Part | None:
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
            if lattice.verdict == "placed" and _extent_px(lattice) > _LEAST_EXTENT * _extent_px(usable[0]):
                raise TargetMismatch(
                    f"{len(common)} of the ChArUco board's markers are in view more than once.",
                    "Cover the other boards with the same markers, and mirrors.",
                )
            continue
        if _belongs(lattice, usable[0], markers):
            parts.append(lattice)
            markers = {**lattice.markers, **markers}
    if not are_enough(markers, layout, codes) or any(
        _belongs(lattice, parts[0], markers) for lattice in lattices if lattice.verdict == "contradicted"
    ):
        return None
    return _union(parts, markers, layout.target)


def corners_in_view(part: Part, target: TargetSpec, shape: Sequence[int]) -> int:
    """Return how many of the board's corners should be in the picture, by the plane through those of a part."""
    if len(part) == target.size:
        return target.size
    H = _plane(part.column, part.row, part.points_px)
    if H is None:
        return target.size
    row, column = (a.ravel() for a in np.mgrid[0 : target.rows, 0 : target.columns])
    places, ahead = _mapped(H, column, row)
    inside = ahead & np.all(places >= 1.0, axis=1) & np.all(places <= np.array(shape[1::-1]) - 2.0, axis=1)
    return int(np.count_nonzero(inside))


def _belongs(
    lattice: PlacedLattice, first: PlacedLattice, markers: Mapping[int, Float[np.ndarray, "4 2"]]
) -> bool:
    """Tell whether a lattice is of the same board: it shares markers, or all it reads has it in the first one's plane.

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
) -> Part:
    """Return all corners, each where the first part that has it has it."""
    column, row = (np.concatenate([getattr(part, name) for part in parts]) for name in ("column", "row"))
    points = np.concatenate([part.points_px for part in parts])
    _, first = np.unique(row * target.columns + column, return_index=True)
    return Part(
        column[first], row[first], points[first], {number: markers[number] for number in sorted(markers)}
    )


def _apart(one: Float[np.ndarray, "4 2"], other: Float[np.ndarray, "4 2"]) -> bool:
    """Tell whether two markers are at different places."""
    side = float(np.linalg.norm(np.diff(one, axis=0), axis=1).min())
    return bool(np.linalg.norm(one.mean(axis=0) - other.mean(axis=0)) > _SAME * side)


def _extent_px(lattice: PlacedLattice) -> float:
    return float(np.max(np.ptp(lattice.points_px, axis=0))) if len(lattice.points_px) else 0.0


def _is_in_plane(lattice: PlacedLattice, first: PlacedLattice) -> bool:
    """Tell whether a lattice lies where the plane through the first one has it."""
    H = _plane(first.column, first.row, first.points_px)
    if H is None or len(lattice.column) == 0:
        return False
    places, ahead = _mapped(H, lattice.column, lattice.row)
    beside, _ = _mapped(H, lattice.column + 1, lattice.row)
    below, _ = _mapped(H, lattice.column, lattice.row + 1)
    square = np.maximum(np.linalg.norm(beside - places, axis=1), np.linalg.norm(below - places, axis=1))
    away = np.maximum(
        np.abs(np.subtract.outer(lattice.column, first.column)),
        np.abs(np.subtract.outer(lattice.row, first.row)),
    ).min(axis=1)
    off = np.linalg.norm(lattice.points_px - places, axis=1) / square
    return bool(np.all(ahead) and np.median(off / (_OFF_PLANE + _BENT * away)) < 1.0)


def _plane(
    column: Int[np.ndarray, " n"], row: Int[np.ndarray, " n"], points_px: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "3 3"] | None:
    """Return the homography from grid indices to pixels, None where the corners do not tell it."""
    if len(column) < 4 or np.ptp(column) == 0 or np.ptp(row) == 0:
        return None
    H, _ = cv2.findHomography(np.stack([column, row], axis=1).astype(np.float64), points_px)
    return None if H is None or not np.all(np.isfinite(H)) else np.asarray(H, np.float64)


def _mapped(
    H: Float[np.ndarray, "3 3"], column: Int[np.ndarray, " n"], row: Int[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "n 2"], np.ndarray]:
    """Return the pixels of grid points, and which lie before the camera (of a plane of which most does)."""
    image = np.stack([column, row, np.ones(len(column))], axis=1) @ H.T
    ahead = image[:, 2] > 1e-9
    return image[:, :2] / np.where(ahead, image[:, 2], 1.0)[:, None], ahead
