"""Whether refined corners of a board with markers, or centres of dots, are where their neighbours have them.

The edge of a hand, or print next to a board, may make a corner that the refiner accepts. A lens bends the image of a
plane smoothly: the residuals of the corners after one homography are locally linear. So each corner is predicted
from those nearest to it, without itself. An outlier spoils its neighbours' predictions too; hence the worst corners
are first excluded, a few at a time, and readmitted if the remaining ones predict them near their places: near in
terms of their own uncertainty, and of how well the corners around them and on the whole board are predicted, which
measures how strongly the lens bends.

References: P. J. Rousseeuw, A. M. Leroy, "Robust regression and outlier detection" (1987), chapter 6, on deletion and
masking; R. Hartley, A. Zisserman, "Multiple view geometry" (2004), section 4.1, for the homography.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from core.targets.subpixel.smooth_map import grid_basis, grid_shape

_NEAREST = 8  # corners that predict one: those around it
_MIN_CORNERS = 7  # corners: with fewer, predictions say nothing
_UNCERTAIN = 8.0  # times the median of the stated uncertainties
_SUSPECT = 2.5  # times the median of what predictions leave: excluded for the time being
_MAX_SUSPECTS = 0.25  # of the corners
_ASTRAY = 8.0  # times what predictions leave around the corner, and on the board
_ASTRAY_SIGMAS = 6.0  # of the prediction's and the corner's uncertainty
_MANY = 40  # corners: enough for a map, of which a single one is a small part
_BENT_IN_PLANE, _BENT_IN_MAP = 0.04, 0.01  # of the distance to the farthest that predicts: what a lens may do
_MAX_LEVERAGE = 25.0  # a prediction with so much more variance than a corner is rejected


def neighbour_inliers(
    places: Float[np.ndarray, "n 2"],
    points_px: Float[np.ndarray, "n 2"],
    standard_uncertainty_px: Float[np.ndarray, " n"],
    trusted: Bool[np.ndarray, " n"],
    *,
    most_uncertain: float = _UNCERTAIN,
) -> Bool[np.ndarray, " n"]:
    """Return which of the trusted points are where their neighbours predict them, and not more than `most_uncertain`
    times as uncertain as their median.

    `places` are the points' on the print, in pitches or gaps; `points_px` and `standard_uncertainty_px` refined.
    """
    kept = trusted.copy()
    if not kept.any():
        return kept
    kept &= standard_uncertainty_px <= most_uncertain * np.median(standard_uncertainty_px[trusted])
    members = np.flatnonzero(kept)
    if len(members) < _MIN_CORNERS or not is_well_distributed(places[members]):
        return kept
    kept[members] = _are_predicted(places[members], points_px[members], standard_uncertainty_px[members])
    return kept


def _are_predicted(
    places: Float[np.ndarray, "n 2"],
    points_px: Float[np.ndarray, "n 2"],
    uncertainty: Float[np.ndarray, " n"],
) -> Bool[np.ndarray, " n"]:
    count = len(places)
    sure = np.ones(count, dtype=np.bool_)
    while True:
        left, spread, nearest = _left(places, points_px, sure)
        typical = float(np.median(left[sure]))
        reach = np.linalg.norm(points_px[nearest] - points_px[:, None], axis=2).max(axis=1)
        least = (_BENT_IN_MAP if count >= _MANY else _BENT_IN_PLANE) * reach
        suspect = sure & (left > np.maximum(_SUSPECT * typical, least))
        # of neighbours that look wrong the worst one makes the others so
        suspect &= left >= np.where(sure[nearest], left[nearest], 0.0).max(axis=1)
        allowed = min(int(_MAX_SUSPECTS * count), count - _MIN_CORNERS + 1) - int(np.count_nonzero(~sure))
        worst = np.flatnonzero(suspect)
        worst = worst[np.argsort(-left[worst], kind="stable")][: max(allowed, 0)]
        rest = sure.copy()
        rest[worst] = False
        if len(worst) == 0 or not is_well_distributed(places[rest]):
            break
        sure = rest
    around = np.median(left[nearest], axis=1)  # the nearest are sure ones
    scale = np.maximum(around, typical)
    noise = np.hypot(uncertainty, np.median(uncertainty[sure]))
    tolerance = np.maximum(np.maximum(_ASTRAY * scale, _ASTRAY_SIGMAS * noise), least)
    return sure | (left <= tolerance) | (spread > _MAX_LEVERAGE)


def is_well_distributed(places: Float[np.ndarray, "n 2"]) -> bool:
    """Return whether places of a grid, (n, 2), determine a plane's image: two rows with two of them each have four of
    which no three lie on a line."""
    _, counts = np.unique(np.round(places[:, 1], 1), return_counts=True)  # certified places: nearly in line
    return bool(np.count_nonzero(counts >= 2) >= 2)


def _left(
    places: Float[np.ndarray, "n 2"], points_px: Float[np.ndarray, "n 2"], sure: Bool[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Int[np.ndarray, "n k"]]:
    """Return how far (px) corners are from where the nearest sure ones but themselves predict them, divided by the root
    of 1 + `spread`; `spread`, the prediction's variance in that of one corner; and these nearest ones."""
    weights = sure.astype(np.float64)
    basis = grid_basis(places, points_px, weights)
    if len(places) >= _MANY:
        smooth = grid_shape(basis, points_px, weights).points_px
    else:
        smooth = basis.projected[0] * basis.size_px + basis.middle_px
    rest = points_px - smooth
    members = np.flatnonzero(sure)
    count = min(_NEAREST, len(members) - 1)
    _, found = KDTree(places[members]).query(places, k=count + 1)
    nearest = members[found]
    own = nearest == np.arange(len(places))[:, None]
    own[~own.any(axis=1), -1] = True  # for excluded ones, the farthest is dropped
    nearest = nearest[~own].reshape(len(places), count)
    apart = places[nearest] - places[:, None]
    apart /= np.linalg.norm(apart, axis=2).max(axis=1)[:, None, None]
    X = np.concatenate([np.ones((*apart.shape[:2], 1)), apart], axis=2)
    inverse = np.linalg.inv(X.transpose(0, 2, 1) @ X + 1e-6 * np.eye(3))
    spread = inverse[:, 0, 0]  # at the corner itself the linear terms are zero
    predicted = np.einsum("nk,nmk,nmd->nd", inverse[:, 0], X, rest[nearest])
    off = np.linalg.norm(rest - predicted, axis=1)
    return off / np.sqrt(1.0 + spread), spread, nearest
