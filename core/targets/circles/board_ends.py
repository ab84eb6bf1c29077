"""Whether a board of dots ends with the dots that were found, or they are cut out of a larger grid.

As many columns and rows as were asked for may be what a grille, or a larger board, shows next to something that covers
it. Then there are dots on the next line to one side at least, where a board has its margin: spots as dark or bright as
the dots, with lighter or darker places half-way between them.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int, Shaped

from core.geometry import find_homography, map_in_front
from core.targets.specification import TargetSpec
from core.targets.subpixel import nearest_levels

_MIN_SITES = 3  # in view
_MAJORITY = 0.6  # of those in view
_LIKE_DOTS = 0.4  # of the dots' usual contrast


def extends_beyond(
    image: Shaped[np.ndarray, "h w"],
    target: TargetSpec,
    column: Int[np.ndarray, " n"],
    row: Int[np.ndarray, " n"],
    centres_px: Float[np.ndarray, "n 2"],
    contrast: float,
) -> bool:
    """Return whether the lattice of a board's dots continues beyond it on any side.

    `contrast` is the grey of what is around the dots, less theirs.
    """
    H = find_homography(_places(target, column, row), centres_px)
    if H is None:
        return False
    across, down = np.arange(target.columns), np.arange(target.rows)
    sides = [
        (across, np.full(target.columns, -1)),
        (across, np.full(target.columns, target.rows)),
        (np.full(target.rows, -1), down),
        (np.full(target.rows, target.columns), down),
    ]
    return any(_has_dots(image, _places(target, i, j), H, contrast) for i, j in sides)


def _places(
    target: TargetSpec, column: Int[np.ndarray, " n"], row: Int[np.ndarray, " n"]
) -> Float[np.ndarray, "n 2"]:
    return np.ascontiguousarray(target.points_target(column, row)[:, :2] / target.pitch_mm)


def _has_dots(
    image: Shaped[np.ndarray, "h w"],
    sites: Float[np.ndarray, "n 2"],
    H: Float[np.ndarray, "3 3"],
    contrast: float,
) -> bool:
    """Return whether most sites of a line that are in view look like dots."""
    at = nearest_levels(image, map_in_front(H, sites), 1)
    between = nearest_levels(image, map_in_front(H, 0.5 * (sites[1:] + sites[:-1])), 1)
    around = np.full((2, len(sites)), np.nan)
    around[0, 1:], around[1, :-1] = between, between
    with np.errstate(invalid="ignore"):
        # the nearer to the dot's own grey of the two: a shadow's or a sheet's edge next to it makes no dot
        surround = np.nanmin(np.sign(contrast) * around, axis=0, initial=np.inf)
        darker = surround - np.sign(contrast) * at
    seen = np.isfinite(darker)
    likely = darker[seen] > _LIKE_DOTS * abs(contrast)
    return bool(seen.sum() >= _MIN_SITES and likely.mean() >= _MAJORITY)
