"""A partial view of a board of dots: in which turns it can lie on the board.

The larger dot at the origin determines which part of the board is in view: the part reaches from there, and only one
turn has it so. Without it a partial view is rejected. A part counts only where its missing sides leave the image: on
the others the next line of dots would be in view, so the board ends there.

Staggered dots stand on every other place of twice as many lines (`core.targets.grid_index`), and look the
same after any quarter turn. So a part of them has four turns to lie in as well, but where no dot stands at
its corner it counts from one line further out.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from core.geometry import find_homography, map_in_front
from core.targets.circles.lattice import DotLattice
from core.targets.grid_index import apart, cells_of, is_staggered, lines
from core.targets.specification import TargetSpec

_MIN_DOTS, _SUFFICIENT_DOTS, _MIN_BOARD_SHARE = 12, 25, 0.25
_MIN_EXTENT = 2.0  # from the first line to the last, in distances of neighbours
_MIN_SEEN_SHARE = 0.75  # of the places in the image
_MIN_SIDE_SHARE = 0.5  # of the places of a line beyond a side: in the image, so that it is an end
_NEAR_BORDER = 0.5  # of the distance of neighbours: nearer to it a dot may be cut off


def candidate_orientations(
    lattice: DotLattice, points_px: Float[np.ndarray, "n 2"], shape: tuple[int, int], target: TargetSpec
) -> list[tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]]:
    """Return the turns in which a lattice may be a part of a board that ends with the image, each as columns and rows
    of its dots from the part's corner on; none if it is no such part.

    Parameters
    ----------
    points_px
        The dots' centres in the full image.
    shape
        Height and width of the image.
    """
    places = along_grid_lines(lattice, target)
    extent = places.max(axis=0) + 1
    enough = max(_MIN_DOTS, min(_SUFFICIENT_DOTS, _MIN_BOARD_SHARE * target.size))
    if len(places) < enough or min(extent) - 1 < _MIN_EXTENT * apart(target):
        return []
    H = find_homography(places.astype(np.float64), points_px)
    if H is None:
        return []
    inside, is_site = _around(places, H, shape, target)
    within = (inside & is_site)[1:-1, 1:-1]
    known = np.zeros(within.shape, dtype=np.bool_)
    known[places[:, 1], places[:, 0]] = True
    if np.count_nonzero(known & within) < _MIN_SEEN_SHARE * np.count_nonzero(within):
        return []
    top, bottom, left, right = _sides_in_image(inside, is_site)
    if top and bottom and left and right:
        return []
    found = []
    ends = (bool(left and right), bool(top and bottom))
    for _ in range(4):
        counted = _counted(places, ends, target)
        if counted is not None:
            found.append(cells_of(target, counted))
        places = np.stack([places[:, 1].max() - places[:, 1], places[:, 0]], axis=1)
        ends = (ends[1], ends[0])
    return found


def ends_in_image(
    lattice: DotLattice, points_px: Float[np.ndarray, "n 2"], shape: tuple[int, int], target: TargetSpec
) -> bool:
    """Return whether the next line would be in the image on all four sides of a lattice; parameters as above."""
    places = along_grid_lines(lattice, target)
    H = find_homography(places.astype(np.float64), points_px) if places.max(axis=0).min() > 1 else None
    return H is not None and all(_sides_in_image(*_around(places, H, shape, target)))


def _around(
    places: Int[np.ndarray, "n 2"], H: Float[np.ndarray, "3 3"], shape: tuple[int, int], target: TargetSpec
) -> tuple[Bool[np.ndarray, "h w"], Bool[np.ndarray, "h w"]]:
    """Return which places from one line before a lattice to one after it lie in the image, and which may have dots."""
    extent = places.max(axis=0) + 1
    y, x = np.mgrid[-1 : extent[1] + 1, -1 : extent[0] + 1]
    is_site = (x + y - places[0].sum()) % 2 == 0 if is_staggered(target) else np.ones(x.shape, dtype=np.bool_)
    return in_image(H, x, y, shape, target), is_site


def _sides_in_image(inside: Bool[np.ndarray, "h w"], is_site: Bool[np.ndarray, "h w"]) -> tuple[bool, ...]:
    """Return whether the line beyond the top, bottom, left and right of a lattice is in the image."""
    beyond = (np.s_[0, 1:-1], np.s_[-1, 1:-1], np.s_[1:-1, 0], np.s_[1:-1, -1])
    return tuple(bool(inside[line][is_site[line]].mean() >= _MIN_SIDE_SHARE) for line in beyond)


def along_grid_lines(lattice: DotLattice, target: TargetSpec) -> Int[np.ndarray, "n 2"]:
    """Return the dots' places in lines across and down, from the lattice's corner on."""
    p, q = lattice.places.T
    places = np.stack([p - q, p + q], axis=1) if is_staggered(target) else lattice.places
    return (places - places.min(axis=0)).astype(np.intp)


def _counted(
    places: Int[np.ndarray, "n 2"], ends: tuple[bool, bool], target: TargetSpec
) -> Int[np.ndarray, "n 2"] | None:
    """Return the places as the board has dots on them, if it is large enough; as large where both ends are in view."""
    sizes, count = lines(target), places.max(axis=0) + 1
    if not all(n == size if whole else n <= size for n, size, whole in zip(count, sizes, ends, strict=True)):
        return None
    if not is_staggered(target) or places[0].sum() % 2 == 0:
        return places
    for axis in range(2):
        if count[axis] < sizes[axis]:
            return places + np.eye(2, dtype=np.intp)[axis]
    return None


def in_image(
    H: Float[np.ndarray, "3 3"],
    x: Int[np.ndarray, "h w"],
    y: Int[np.ndarray, "h w"],
    shape: tuple[int, int],
    target: TargetSpec,
) -> Bool[np.ndarray, "h w"]:
    """Return which places lie in the image, so far from its border that no dot is cut off."""
    u, v = map_in_front(H, np.stack([x.ravel(), y.ravel()], axis=1)).T.reshape(2, *x.shape)
    step = np.hypot(np.gradient(u, axis=1), np.gradient(v, axis=1))
    margin = (
        _NEAR_BORDER
        * apart(target)
        * np.maximum(step, np.hypot(np.gradient(u, axis=0), np.gradient(v, axis=0)))
    )
    return np.asarray((u > margin) & (v > margin) & (u < shape[1] - 1 - margin) & (v < shape[0] - 1 - margin))
