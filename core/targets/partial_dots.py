"""A board of dots of which a part is in view: in which turns it can lie on the board.

Of a plain grid of dots nobody can say which part is seen, unless the larger dot at the origin is: then the part reaches
from there, and only one turn has it so. Without it the columns and rows count from the part's own corner, as on a part
of a chessboard (`core.targets.partial_board`), but that dots have no colours to mind. A part counts only where its
missing sides leave the picture: on the others the next line of dots would be in view, so the board ends there.

Staggered dots stand on every other place of twice as many lines (`core.targets.dot_sites`), and look the same after any
quarter turn. So a part of them has four turns to lie in as well, but where no dot stands at its corner it counts from
one line further out.
"""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from core.targets.dot_lattice import DotLattice
from core.targets.dot_sites import apart, cells_of, is_staggered, lines
from core.targets.specification import TargetSpec

_LEAST_DOTS, _ENOUGH_DOTS, _ENOUGH_OF_BOARD = 12, 25, 0.25
_LEAST_EXTENT = 2.0  # from the first line to the last, in distances of neighbours
_ENOUGH_SEEN = 0.75  # of the places in the picture
_ENOUGH_OF_SIDE = 0.5  # of the places of a line beyond a side: in the picture, so that it is an end
_NEAR_BORDER = 0.5  # of the distance of neighbours: nearer to it a dot may be cut off


def part_turns(
    lattice: DotLattice, points_px: Float[np.ndarray, "n 2"], shape: tuple[int, int], target: TargetSpec
) -> list[tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]]:
    """Return the turns in which a lattice may be a part of a board that ends with the picture, each as columns and rows
    of its dots from the part's corner on; none where it is no such part.

    Parameters
    ----------
    points_px
        The dots' centres in the full picture.
    shape
        Height and width of the picture.
    """
    places = along_lines(lattice, target)
    extent = places.max(axis=0) + 1
    enough = max(_LEAST_DOTS, min(_ENOUGH_DOTS, _ENOUGH_OF_BOARD * target.size))
    if len(places) < enough or min(extent) - 1 < _LEAST_EXTENT * apart(target):
        return []
    H: np.ndarray | None = cv2.findHomography(places.astype(np.float64), points_px)[0]
    if H is None:
        return []
    y, x = np.mgrid[-1 : extent[1] + 1, -1 : extent[0] + 1]
    is_site = (x + y - places[0].sum()) % 2 == 0 if is_staggered(target) else np.ones(x.shape, dtype=np.bool_)
    inside = _in_picture(H, x, y, shape, _NEAR_BORDER * apart(target))
    within = (inside & is_site)[1:-1, 1:-1]
    known = np.zeros(within.shape, dtype=np.bool_)
    known[places[:, 1], places[:, 0]] = True
    if np.count_nonzero(known & within) < _ENOUGH_SEEN * np.count_nonzero(within):
        return []
    beyond = (np.s_[0, 1:-1], np.s_[-1, 1:-1], np.s_[1:-1, 0], np.s_[1:-1, -1])
    top, bottom, left, right = (inside[line][is_site[line]].mean() >= _ENOUGH_OF_SIDE for line in beyond)
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


def along_lines(lattice: DotLattice, target: TargetSpec) -> Int[np.ndarray, "n 2"]:
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


def _in_picture(
    H: Float[np.ndarray, "3 3"],
    x: Int[np.ndarray, "h w"],
    y: Int[np.ndarray, "h w"],
    shape: tuple[int, int],
    near_border: float,
) -> Bool[np.ndarray, "h w"]:
    """Tell which places lie in the picture, so many lines from its border."""
    u, v, ahead = (H[k, 0] * x + H[k, 1] * y + H[k, 2] for k in range(3))
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v = u / ahead, v / ahead
        step = np.hypot(np.gradient(u, axis=1), np.gradient(v, axis=1))
        margin = near_border * np.maximum(step, np.hypot(np.gradient(u, axis=0), np.gradient(v, axis=0)))
        inside = (u > margin) & (v > margin) & (u < shape[1] - 1 - margin) & (v < shape[0] - 1 - margin)
    return np.asarray(inside & (ahead > 0.0))
