"""Where grid points lie in counts of lines, x across and y down, by which a grid may be shifted and turned.

On most grids these are columns and rows. On `asymmetric_circles` a column is two lines wide: every other row stands one
line further right, so that x = 2 column + row mod 2 and only places with x + y even hold a dot. Quarter turns, and
shifts by an even x + y, bring dots to such places again. Columns are not kept: a shift by an odd number of rows parts
the points of one.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Int

from core.targets.specification import TargetSpec


def is_staggered(target: TargetSpec) -> bool:
    """Return whether every other row of the grid is offset."""
    return target.kind == "asymmetric_circles"


def lines(target: TargetSpec) -> tuple[int, int]:
    """Return how many lines the whole grid has across and down."""
    return (2 if is_staggered(target) else 1) * target.columns, target.rows


def apart(target: TargetSpec) -> float:
    """Return how far neighbouring grid points stand apart, in lines."""
    return math.sqrt(2.0) if is_staggered(target) else 1.0


def cells_of(
    target: TargetSpec, sites: Int[np.ndarray, "n 2"]
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Return the columns and rows of grid points from their places (x, y), in lines."""
    x, y = sites.T
    return np.ascontiguousarray((x - y % 2) // 2 if is_staggered(target) else x), np.ascontiguousarray(y)
