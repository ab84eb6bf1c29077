"""Visits whose board was counted from another of its points.

A grid that is labelled some columns and rows off leaves no residual: the pose is as good as any other, and off by as
many pitches. A visit lies so far from its own pose, by its scatter s (`misplaced_visits`), and by whole steps of the
grid in the board's plane:

    |x - c| > `MIN_FAR` s,   |x - c - (i p, j p, 0)| < `MAX_NEAR` s.

Where `MAX_NEAR` s is more than a quarter of the pitch, every place is near such a step, and nothing is said.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from core.metrology.repeatability.misplaced_visits import MAX_NEAR, MIN_CENTRE, MIN_FAR

_MAX_SHARE = 0.25
"""Of the shortest step."""


def find_label_shifts(
    positions_mm: Float[np.ndarray, "n 3"], grid_mm: Float[np.ndarray, "k 3"]
) -> dict[int, tuple[float, float]]:
    """Return by how much (mm, along the board's x and y) the boards of visits were counted off, by place in the list.

    Parameters
    ----------
    positions_mm
        Of the visits to one pose, in axes that are the board's.
    grid_mm
        The board's points in its frame.
    """
    if len(positions_mm) < MIN_CENTRE:
        return {}
    off = positions_mm - np.median(positions_mm, axis=0)
    distances = np.linalg.norm(off, axis=1)
    near = MAX_NEAR * float(np.median(distances))
    far = np.flatnonzero(distances > max(MIN_FAR / MAX_NEAR * near, 1e-9))
    if len(far) == 0:
        return {}
    places = grid_mm[:, :2]
    tree = cKDTree(places)
    if near > _MAX_SHARE * float(tree.query(places, k=2)[0][:, 1].min()):
        return {}
    found = {}
    for k in far.tolist():
        # A step of the grid takes some of its points to others; all pairs of a large board would be too many.
        apart, reached = tree.query(places + off[k, :2])
        start = int(np.argmin(apart))
        if math.hypot(float(apart[start]), float(off[k, 2])) < near:
            step = np.round(places[reached[start]] - places[start], 6)
            found[k] = float(step[0]), float(step[1])
    return found
