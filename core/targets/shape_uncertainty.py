"""How far a print may depart from its nominal grid: standard uncertainties of low-order shapes and of its points."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from types import MappingProxyType

from core.errors import InvalidTarget


@dataclass(frozen=True, slots=True)
class ShapeUncertainty:
    """Standard uncertainties of a print's departures from its nominal grid.

    `aspect` is the length along x over that along y, less 1; `shear` the angle of the axes, less 90°, rad. `bow_mm`
    is how far the border of the grid stands out of the plane of its middle, along x and along y; `twist_mm` how far
    its corners do, two up and two down. `quadratic_mm` is how far the border departs in the plane by each quadratic
    form, `point_mm` each grid point by itself along x and y.
    """

    aspect: float = 5e-4
    shear: float = 5e-4
    bow_mm: float = 0.1
    twist_mm: float = 0.1
    quadratic_mm: float = 0.02
    point_mm: float = 0.01

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not (math.isfinite(value) and 0.0 <= value <= 100.0):
                raise InvalidTarget(
                    f"shape_standard_uncertainty: {field.name} must lie between 0 and 100, got {value!r}.",
                    field="shape_standard_uncertainty",
                )


PRINT_KINDS: Mapping[str, ShapeUncertainty] = MappingProxyType(
    {
        "paper": ShapeUncertainty(),
        "plate": ShapeUncertainty(2e-4, 2e-4, 0.1, 0.1, 0.01, 0.005),
        "glass": ShapeUncertainty(2e-5, 2e-5, 0.01, 0.01, 0.002, 0.001),
    }
)
"""By kind of print: paper glued to a board, ink on a rigid plate, chrome on glass."""
