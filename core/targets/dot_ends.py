"""Whether a board of dots ends with the dots that were found, or they are cut out of a larger grid.

As many columns and rows as were asked for may be what a grille, or a larger board, shows beside something that covers
it. Then there are dots on the next line to one side at least, where a board has its margin: spots as dark or bright as
the dots, with lighter or darker places half-way between them.
"""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float, Int, Shaped

from core.targets.specification import TargetSpec

_LEAST_SITES = 3  # in view
_MOST = 0.6  # of those in view
_LIKE_DOTS = 0.4  # of the dots' usual contrast


def goes_on(
    image: Shaped[np.ndarray, "h w"],
    target: TargetSpec,
    column: Int[np.ndarray, " n"],
    row: Int[np.ndarray, " n"],
    centres_px: Float[np.ndarray, "n 2"],
    contrast: float,
) -> bool:
    """Tell whether the lattice of a board's dots goes on beyond it to any side.

    `contrast` is the grey of what is around the dots, less theirs.
    """
    H: np.ndarray | None = cv2.findHomography(_places(target, column, row), centres_px)[0]
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
    """Tell whether most sites of a line that are in view look like dots."""
    at = _levels(image, sites, H)
    between = _levels(image, 0.5 * (sites[1:] + sites[:-1]), H)
    around = np.full((2, len(sites)), np.nan)
    around[0, 1:], around[1, :-1] = between, between
    with np.errstate(invalid="ignore"):
        # the nearer to the dot's own grey of the two: a shadow's or a sheet's edge beside it makes no dot
        beside = np.nanmin(np.sign(contrast) * around, axis=0, initial=np.inf)
        darker = beside - np.sign(contrast) * at
    seen = np.isfinite(darker)
    likely = darker[seen] > _LIKE_DOTS * abs(contrast)
    return bool(seen.sum() >= _LEAST_SITES and likely.mean() >= _MOST)


def _levels(
    image: Shaped[np.ndarray, "h w"], places: Float[np.ndarray, "n 2"], H: Float[np.ndarray, "3 3"]
) -> Float[np.ndarray, " n"]:
    """Return the mean of nine pixels at each place; NaN outside the picture."""
    mapped = np.column_stack([places, np.ones(len(places))]) @ H.T
    u, v = np.rint(mapped[:, :2] / mapped[:, 2:]).T
    height, width = image.shape
    inside = (mapped[:, 2] * H[2, 2] > 0.0) & (u >= 1) & (v >= 1) & (u < width - 1) & (v < height - 1)
    levels = np.full(len(places), np.nan)
    for k in np.flatnonzero(inside):
        i, j = int(u[k]), int(v[k])
        levels[k] = image[j - 1 : j + 2, i - 1 : i + 2].mean()
    return levels
