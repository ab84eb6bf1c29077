"""Which corner of a chessboard is grid point (0, 0).

A grid is an array (rows, columns, 2) of pixels. Its lines were found in some order; which order is right
follows from:

1. **Handedness.** Seen from the front, x to the right and y down: the cross product of the x and the y
   direction in the image (u right, v down) is positive. A grid with a negative one is mirrored and has its
   columns reversed.
2. **Colour.** The outermost square diagonally beyond grid point (0, 0) is black. The square (i, j) between
   the points (i, j) and (i + 1, j + 1) is of the same colour as that one, square (-1, -1), if i + j is even.
   Turned by 180° the origin's square is the former square (columns - 2, rows - 2): columns + rows odd makes
   it white, so that exactly one of the two orders is right.
3. **Direction**, where colour cannot tell (columns + rows even): the order whose x axis points toward +u,
   with the warning `orientation_ambiguous`. It is continuous but for a vertical x axis. A board with as many
   columns as rows looks like a grid four ways round: with an odd number colour leaves two of them, with an
   even number none is ruled out. Of those left the one whose x axis points most nearly toward +u is taken.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from core.errors import Advisory

_AMBIGUOUS = Advisory(
    code="orientation_ambiguous",
    detail="This board looks the same when turned; its x axis was taken to point to the right in the image.",
    advice="Use a board whose inner corners have an odd sum of columns and rows, such as 9 x 6, for a fixed one.",
)


def right_handed(grid: Float[np.ndarray, "rows columns 2"]) -> Float[np.ndarray, "rows columns 2"]:
    """Return the grid, with its columns reversed if it was mirrored (rule 1)."""
    x, y = _directions(grid)
    return grid[:, ::-1] if x[0] * y[1] - x[1] * y[0] < 0.0 else grid


def orient(
    grid: Float[np.ndarray, "rows columns 2"], origin_is_black: bool
) -> tuple[Float[np.ndarray, "rows columns 2"], tuple[Advisory, ...]]:
    """Return a right-handed grid in its right order, and a warning where the board does not determine that
    order.

    Parameters
    ----------
    origin_is_black
        Whether the square (0, 0), between grid[0, 0] and grid[1, 1], is black in the order given.
    """
    rows, columns = grid.shape[:2]
    # after k quarter turns: is the origin's square of the other colour?
    changes = {0: 0, 1: columns % 2, 2: (columns + rows) % 2, 3: rows % 2}
    turns = [0, 1, 2, 3] if rows == columns else [0, 2]
    black = [k for k in turns if origin_is_black != bool(changes[k])]
    orders = [np.rot90(grid, k) for k in (black or turns)]
    best = max(orders, key=_rightward)
    return best, () if len(orders) == 1 else (_AMBIGUOUS,)


def _rightward(grid: Float[np.ndarray, "rows columns 2"]) -> float:
    """Return the cosine of the angle between the x axis and +u."""
    x, _ = _directions(grid)
    return float(x[0] / np.hypot(x[0], x[1]))


def _directions(
    grid: Float[np.ndarray, "rows columns 2"],
) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """Return the mean directions of the x and the y axis in the image, px over the whole board."""
    return (grid[:, -1] - grid[:, 0]).mean(axis=0), (grid[-1] - grid[0]).mean(axis=0)
