"""A board of dots of which a part is in view: in which turns it can lie on the board.

Of a plain grid of dots nobody can say which part is seen, unless the larger dot at the origin is: then the part reaches
from there, and only one turn has it so. Without it the columns and rows count from the part's own corner, as on a part
of a chessboard (`core.targets.partial_board`), but that dots have no colours to mind. A part counts only where its
missing sides leave the picture: on the others the next line of dots would be in view, so the board ends there.
"""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from core.targets.dot_lattice import DotLattice
from core.targets.specification import TargetSpec

_LEAST_DOTS, _ENOUGH_DOTS, _ENOUGH_OF_BOARD = 12, 25, 0.25
_LEAST_LINES = 3
_ENOUGH_SEEN = 0.75  # of the places in the picture
_ENOUGH_OF_SIDE = 0.5  # of the places of a line beyond a side: in the picture, so that it is an end
_NEAR_BORDER = 0.5  # of a step: nearer to it a dot may be cut off


def part_turns(
    lattice: DotLattice, points_px: Float[np.ndarray, "n 2"], shape: tuple[int, int], target: TargetSpec
) -> list[tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]]:
    """Return the turns in which a lattice may be a part of a board of `circles` that ends with the picture, each as
    columns and rows of its dots from the part's corner on; none where it is no such part.

    Parameters
    ----------
    points_px
        The dots' centres in the full picture.
    shape
        Height and width of the picture.
    """
    places = lattice.places - lattice.places.min(axis=0)
    extent = places.max(axis=0) + 1
    enough = max(_LEAST_DOTS, min(_ENOUGH_DOTS, _ENOUGH_OF_BOARD * target.size))
    if target.kind != "circles" or len(places) < enough or min(extent) < _LEAST_LINES:
        return []
    H: np.ndarray | None = cv2.findHomography(places.astype(np.float64), points_px)[0]
    if H is None:
        return []
    q, p = np.mgrid[-1 : extent[1] + 1, -1 : extent[0] + 1]
    inside = _in_picture(H, p, q, shape)
    within = inside[1:-1, 1:-1]
    known = np.zeros(within.shape, dtype=np.bool_)
    known[places[:, 1], places[:, 0]] = True
    if np.count_nonzero(known & within) < _ENOUGH_SEEN * np.count_nonzero(within):
        return []
    lines = (inside[0, 1:-1], inside[-1, 1:-1], inside[1:-1, 0], inside[1:-1, -1])
    top, bottom, left, right = (bool(line.mean() >= _ENOUGH_OF_SIDE) for line in lines)
    if top and bottom and left and right:
        return []
    found = []
    ends = (left and right, top and bottom)
    for _ in range(4):
        sizes = (target.columns, target.rows)
        count = places.max(axis=0) + 1
        if all(n == size if whole else n <= size for n, size, whole in zip(count, sizes, ends, strict=True)):
            found.append((places[:, 0].astype(np.intp), places[:, 1].astype(np.intp)))
        places = np.stack([places[:, 1].max() - places[:, 1], places[:, 0]], axis=1)
        ends = (ends[1], ends[0])
    return found


def _in_picture(
    H: Float[np.ndarray, "3 3"], p: Int[np.ndarray, "h w"], q: Int[np.ndarray, "h w"], shape: tuple[int, int]
) -> Bool[np.ndarray, "h w"]:
    """Tell which places of a lattice lie in the picture, half a step from its border."""
    u, v, ahead = (H[k, 0] * p + H[k, 1] * q + H[k, 2] for k in range(3))
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v = u / ahead, v / ahead
        step = np.hypot(np.gradient(u, axis=1), np.gradient(v, axis=1))
        margin = _NEAR_BORDER * np.maximum(step, np.hypot(np.gradient(u, axis=0), np.gradient(v, axis=0)))
        inside = (u > margin) & (v > margin) & (u < shape[1] - 1 - margin) & (v < shape[0] - 1 - margin)
    return np.asarray(inside & (ahead > 0.0))
