"""Visits whose board was counted from another of its points.

A grid that is labelled some columns and rows off leaves no residual: the pose is as good as any other, and off by as
many pitches. A visit lies so far from its own pose, by its scatter s (`misplaced_visits`), and by whole steps of the
grid in the board's plane:

    |x - c| > `MIN_FAR` s,   |x - c - (i p, j p, 0)| < `MAX_NEAR` s.

Where `MAX_NEAR` s is more than a quarter of the pitch, every place is near such a step, and nothing is said.
"""

from __future__ import annotations

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
    steps = np.unique(np.round((places[:, None] - places).reshape(-1, 2), 6), axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    if near > _MAX_SHARE * float(lengths[lengths > 0.0].min()):
        return {}
    apart, step = cKDTree(steps).query(off[far, :2])
    found = far[(np.hypot(apart, off[far, 2]) < near) & (lengths[step] > 0.0)]
    chosen = dict(zip(far.tolist(), steps[step].tolist(), strict=True))
    return {int(k): (chosen[k][0], chosen[k][1]) for k in found.tolist()}
