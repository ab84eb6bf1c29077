"""Where the dots of a board lie, counted in its lines."""

from __future__ import annotations

import numpy as np

from core.targets import TargetSpec
from core.targets.grid_index import is_staggered


def sites_of(target: TargetSpec, column: np.ndarray, row: np.ndarray) -> np.ndarray:
    """Return the places (x, y), in lines, of grid points."""
    return np.stack([2 * column + row % 2 if is_staggered(target) else column, row], axis=1)
