"""Two stopping points: the cycles of a pose in two clusters along the main axis of their scatter.

Cycles x_1 ≤ ... ≤ x_n along the first principal axis are split in two; w is the sum of squares within both parts over
the whole, for the best split with parts of at least three cycles and a tenth of them. A normal sample has w near .33
and a sample of two equal clusters s apart, each of unit standard deviation, w = 1 / (1 + s² / 4). The limits hold for
the least w of five poses, whatever the shape of the scatter; with more poses they shrink as the lower tail of w does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from core.metrology.iso9283 import deviations
from core.metrology.resolution import find_resolution

MIN_CYCLES = 10
_LIMITS = {10: 0.029, 20: 0.067, 30: 0.093, 50: 0.121}
_POSES = 5
_TAIL = 4.0
"""The lower tail of w goes as its fourth power at ten cycles, and by higher powers with more."""
_LEAST_PART, _LEAST_SHARE = 3, 0.1
MIN_STEPS_APART = 2.0
"""Clusters nearer to one another than so many steps of the readings' resolution are not two stopping points."""


@dataclass(frozen=True, slots=True)
class TwoPoints:
    """A pose whose cycles form two clusters: its place in the list, w, and the clusters' distance (mm).

    `second` marks the visits of the smaller cluster (of two equal ones, that without the first visit).
    """

    pose: int
    within_share: float
    distance_mm: float
    second: Bool[np.ndarray, " n"]


def max_within_share(cycles: int, poses: int) -> float:
    """Return the limit of w for the least of so many poses."""
    n = np.array(list(_LIMITS), dtype=float)
    limit = float(np.interp(math.sqrt(cycles), np.sqrt(n), list(_LIMITS.values())))
    return limit * (_POSES / max(poses, _POSES)) ** (1.0 / _TAIL)


def find_two_points(positions_mm: Float[np.ndarray, "n 3"], pose: int, poses: int) -> TwoPoints | None:
    """Return the two clusters of a pose's cycles; None where they are one, or too few to say."""
    n = len(positions_mm)
    if n < MIN_CYCLES:
        return None
    d = deviations(positions_mm)
    along = d @ np.linalg.eigh(d.T @ d)[1][:, -1]
    order = np.argsort(along, kind="stable")
    total = float(along @ along)
    if total == 0.0:
        return None
    least = max(_LEAST_PART, math.ceil(_LEAST_SHARE * n))
    k = np.arange(least, n - least + 1)
    between = np.cumsum(along[order])[k - 1] ** 2 * n / (k * (n - k))
    best = int(np.argmax(between))
    share = max(1.0 - float(between[best]) / total, 0.0)
    if share > max_within_share(n, poses):
        return None
    second = np.zeros(n, dtype=bool)
    second[order[k[best] :]] = True
    if second.sum() * 2 > n or (second.sum() * 2 == n and second[0]):
        second = ~second
    distance = float(np.linalg.norm(d[second].mean(axis=0) - d[~second].mean(axis=0)))
    resolution = find_resolution(positions_mm)
    if resolution is not None and distance < MIN_STEPS_APART * float(np.linalg.norm(resolution.step_mm)):
        return None  # neighbouring values of a coarse display, between which nothing can be read
    return TwoPoints(pose, share, distance, second)
