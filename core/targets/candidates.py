"""From the patches of a level to whole lattices: the loop that chessboards, ChArUco boards and AprilGrids share."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from jaxtyping import Float, Int

from core.numerics import median
from core.targets.lattice import MAX_REACH, Lattice, Level, Patches, Saddles, grow_lattice

_MIN_CORNERS = 4  # of a patch or a lattice: one closed cell

PatchCorners = tuple[Float[np.ndarray, "n 2"], Int[np.ndarray, "n 2"]]
"""A patch's corners in pixels of the full image, and their columns and rows in the patch."""


def patch_corners(level: Level, saddles: Saddles, patches: Patches, limit: int) -> Iterator[PatchCorners]:
    """Yield the corners of each of a level's patches with a closed cell, largest first, `limit` of them at most."""
    for number in range(min(len(patches.sizes), limit)):
        if patches.sizes[number] < _MIN_CORNERS:
            return
        members = np.flatnonzero(patches.patch == number)
        yield level.to_full(saddles.points[members]), patches.place[members]


def whole_lattices(
    image: np.ndarray,
    corners: Iterator[PatchCorners],
    max_distance_px: Callable[[Float[np.ndarray, "n 2"], Lattice], float],
    reach: float = MAX_REACH,
    known: Sequence[Lattice] = (),
) -> Iterator[Lattice]:
    """Yield the lattices that patches grow to on the full image, each once.

    A patch belongs to a lattice that was grown already where most of its corners lie nearer to that lattice's than
    `max_distance_px` of the patch's corners and the lattice. `reach` is that of `grow_lattice`; `known` are lattices
    that were grown before, and are not yielded again.
    """
    grown: list[Lattice] = list(known)
    for points, place in corners:
        if any(_distance_px(points, lattice) < max_distance_px(points, lattice) for lattice in grown):
            continue
        lattice = grow_lattice(image, points, place, reach)
        if np.count_nonzero(lattice.known) >= _MIN_CORNERS:
            grown.append(lattice)
            yield lattice


def _distance_px(points: Float[np.ndarray, "n 2"], lattice: Lattice) -> float:
    """Return the median distance of a few of a patch's corners from the nearest corner of a lattice."""
    known = lattice.grid[lattice.known]
    few = points[:: max(1, len(points) // 5)]
    u, v = (np.subtract.outer(few[:, k], known[:, k]) for k in range(2))
    return median(np.sqrt((u * u + v * v).min(axis=1)))
