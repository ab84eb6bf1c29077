"""The standard's test poses: five in a diagonal plane of a cube, in the order in which a robot visits them.

The cube's edges are parallel to the base frame's axes. Its corners are numbered C1 to C4 around the upper face, seen
from above counter-clockwise from the corner at +x, +y, and C5 to C8 below them in the same order. The test plane is one
of the four through two opposite edges. P1 is its centre, P2 to P5 lie on its diagonals, a tenth of a diagonal's length
from the corners in the plane's order.

Reference: ISO 9283:1998, 6.8 (test cube, planes and poses), 7.2 (order of the poses, 30 cycles), table 1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from core.errors import InvalidArgument

CYCLES = 30
"""Of pose accuracy and repeatability."""
CORNER_SHARE = 0.1
"""Of a diagonal, between its end and the pose; the standard allows .08 to .12."""
TEST_PLANES = {
    "C1-C2-C7-C8": (0, 1, 6, 7),
    "C2-C3-C8-C5": (1, 2, 7, 4),
    "C3-C4-C5-C6": (2, 3, 4, 5),
    "C4-C1-C6-C7": (3, 0, 5, 6),
}
VISITS = ("P5", "P4", "P3", "P2", "P1")
"""Of one cycle, which begins at P1."""
_CORNERS = 0.5 * np.array(
    [[x, y, z] for z in (1.0, -1.0) for x, y in ((1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0))]
)


@dataclass(frozen=True, slots=True)
class TestCube:
    """A test cube: centre (mm, base frame), length of an edge (mm), and the plane that the poses lie in."""

    __test__ = False  # no test of pytest's

    centre_mm: tuple[float, float, float]
    side_mm: float
    plane: str = "C1-C2-C7-C8"

    def __post_init__(self) -> None:
        if not (math.isfinite(self.side_mm) and self.side_mm > 0.0 and np.all(np.isfinite(self.centre_mm))):
            raise InvalidArgument("A test cube needs a centre, and an edge longer than 0 mm.")
        if self.plane not in TEST_PLANES:
            raise InvalidArgument(
                f"There is no plane {self.plane}.", f"Name one of {', '.join(TEST_PLANES)}."
            )

    @property
    def corners_mm(self) -> Float[np.ndarray, "8 3"]:
        """C1 to C8, mm, in the base frame."""
        return np.asarray(self.centre_mm + self.side_mm * _CORNERS)

    @property
    def positions_mm(self) -> Float[np.ndarray, "5 3"]:
        """P1 to P5, mm, in the base frame."""
        centre = np.asarray(self.centre_mm, dtype=np.float64)
        ends = self.corners_mm[list(TEST_PLANES[self.plane])]
        return np.vstack([centre, ends + 2.0 * CORNER_SHARE * (centre - ends)])
