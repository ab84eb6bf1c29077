"""Which corner of a chessboard is grid point (0, 0).

A grid is an array (rows, columns, 2) of pixels. Its lines were found in some order; which order is right
follows from:

1. **Handedness.** Seen from the front, x to the right and y down: the cross product of the x and the y
   direction in the image (u right, v down) is positive. Lattices are found in such an order, and only turned.
2. **Colour.** The outermost square diagonally beyond grid point (0, 0) is black. The square (i, j) between
   the points (i, j) and (i + 1, j + 1) is of the same colour as that one, square (-1, -1), if i + j is even.
   Turned by 180° the origin's square is the former square (columns - 2, rows - 2): columns + rows odd makes
   it white, so that exactly one of the two orders is right.
3. **Direction**, where colour does not determine it (columns + rows even): the order whose x axis points toward +u,
   with the warning `board_symmetry_unresolved`. It is continuous but for a vertical x axis. A board with as many
   columns as rows looks like a grid four ways round: with an odd number colour leaves two of them, with an
   even number none is ruled out. Of those left the one whose x axis points most nearly toward +u is taken.
"""

from __future__ import annotations

import numpy as np

from core.errors import Advisory
from core.targets.lattice import Lattice

_AMBIGUOUS = Advisory(
    code="board_symmetry_unresolved",
    detail="This board looks the same when turned; its x axis was taken to point to the right in the image.",
    advice="Use a board whose inner corners have an odd sum of columns and rows, such as 9 x 6, for a fixed one.",
)


def orient(lattice: Lattice) -> tuple[Lattice, tuple[Advisory, ...]]:
    """Return a lattice of the target's rows and columns in its right order, and a warning where the board does not
    determine that order."""
    turns = [lattice]
    for _ in range(3):
        turns.append(turns[-1].quarter_turn())
    orders = [turn for turn in turns if turn.gap.shape == lattice.gap.shape]
    black = [order for order in orders if not order.origin_is_bright]
    if len(black) == 1:
        return black[0], ()
    return max(black or orders, key=rightward), (_AMBIGUOUS,)


def rightward(lattice: Lattice) -> float:
    """Return the cosine of the angle between the x axis and +u: of the mean step over the whole board."""
    steps = np.diff(lattice.grid, axis=1)
    u, v = steps[np.isfinite(steps[..., 0])].mean(axis=0)
    return float(u / np.hypot(u, v))
