"""Visits that lie at another pose than the one that they are stated to be of.

A visit x of pose i, whose other visits are about c_i, is one of pose j where it lies far from its own pose and near the
other one, both by their scatter:

    |x - c_i| > `MIN_FAR` s,   |x - c_j| < `MAX_NEAR` s,   s = max(s_i, s_j).

Centres are medians and s_i median distances from them, at least the median of those of all poses, so that visits of
another pose shift neither. Poses that are nearer to one another than that have no such visits: there, a mistake
looks as scatter does. Gaussian scatter of one size along three axes has s = 1.54 standard deviations, and
`MAX_NEAR` is 8, `MIN_FAR` 31 of them.

Two visits of a pose that are far apart have no centre. One of them is another pose's where it lies near another pose,
and the other does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

MIN_FAR = 20.0
MAX_NEAR = 5.0
MIN_CENTRE = 3
"""Visits whose median one that is mistaken does not shift."""
_FAR_OF_TWO = 5.0
"""Two visits have to lie so many times as far apart: nothing says which of them is the pose's own."""


@dataclass(frozen=True, slots=True)
class MisplacedVisit:
    """A visit by the places of its pose and of itself, the place of the pose where it lies, and how far from its own
    pose's median it is, mm; None where two visits have none.
    """

    pose: int
    visit: int
    likely_pose: int
    distance_mm: float | None


def find_misplaced_visits(
    positions_mm: Sequence[Float[np.ndarray, "_ 3"]], frames: Sequence[int]
) -> tuple[MisplacedVisit, ...]:
    """Return the visits that lie at another pose of their frame, in the order of the poses."""
    sizes = np.array([len(one) for one in positions_mm])
    if len(sizes) < 2 or sizes.min() < 1 or sizes.max() < 2:
        return ()
    centres = np.array([np.median(one, axis=0) for one in positions_mm])
    spreads = np.array(
        [
            np.median(np.linalg.norm(one - centre, axis=1)) if len(one) > 1 else np.nan
            for one, centre in zip(positions_mm, centres, strict=True)
        ]
    )
    scale = np.where(sizes >= MIN_CENTRE, spreads, 0.0)
    scale = np.maximum(scale, np.nanmedian(spreads))
    # Of two visits far apart the middle is nobody's place.
    placed = (sizes >= MIN_CENTRE) | ~(spreads > MAX_NEAR * scale)
    of_frame = np.asarray(frames)
    found = []
    for i, visits in enumerate(positions_mm):
        several = int(sizes[i]) >= MIN_CENTRE
        if several:
            own = np.linalg.norm(visits - centres[i], axis=1)
            suspect = np.flatnonzero(own > MIN_FAR * scale[i])
        else:
            own = np.full(len(visits), np.linalg.norm(visits[0] - visits[-1]) / _FAR_OF_TWO)
            suspect = np.arange(len(visits)) if len(visits) == 2 else np.arange(0)
        others = np.flatnonzero((of_frame == of_frame[i]) & placed & (np.arange(len(sizes)) != i))
        if len(suspect) == 0 or len(others) == 0 or not own[suspect].max() > MIN_FAR * scale[i]:
            continue
        limits = np.maximum(scale[i], scale[others])
        away = np.linalg.norm(visits[suspect, None] - centres[others], axis=2)
        taken = (away < MAX_NEAR * limits) & (own[suspect, None] > MIN_FAR * limits)
        if not several and taken.any(axis=1).all():
            continue
        for k in np.flatnonzero(taken.any(axis=1)):
            likely = int(others[np.argmin(np.where(taken[k], away[k], np.inf))])
            visit = int(suspect[k])
            found.append(MisplacedVisit(i, visit, likely, float(own[visit]) if several else None))
    return tuple(found)
