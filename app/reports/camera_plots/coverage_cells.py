"""Coverage of the image by grid points, and the projection uncertainty, by cells and by nine areas with names."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

AREAS = (
    ("upper left corner", "upper edge", "upper right corner"),
    ("left edge", "centre", "right edge"),
    ("lower left corner", "lower edge", "lower right corner"),
)
"""Names of the thirds of the image, row by row from the top."""
BLANK_SHARE = 0.5
"""An area of which so large a share of the cells has no point is called blank."""
_PER_CELL = 10
_FEWEST, _MOST = 6, 16


@dataclass(frozen=True, slots=True)
class CoverageCells:
    """Square cells of the image from its upper left corner, `count` points in each; the last ones may exceed it."""

    width_px: int
    height_px: int
    size_px: float
    count: Int[np.ndarray, "r c"]

    @property
    def middle_px(self) -> Float[np.ndarray, "r c 2"]:
        """Return the middle (u, v) of what each cell has of the image."""
        rows, columns = self.count.shape
        u, v = (
            0.5 * (np.arange(k) * self.size_px + np.minimum((np.arange(k) + 1) * self.size_px, side)) - 0.5
            for k, side in ((columns, self.width_px), (rows, self.height_px))
        )
        return np.stack(np.meshgrid(u, v), axis=-1)

    @property
    def area(self) -> Int[np.ndarray, "r c"]:
        """Return the area that each cell is of, 0 to 8 in the order of `AREAS`."""
        thirds = np.floor(3.0 * (self.middle_px + 0.5) / (self.width_px, self.height_px)).astype(np.intp)
        return np.asarray(3 * thirds[..., 1] + thirds[..., 0])

    @property
    def covered_share(self) -> float:
        """Return the share of the cells that have a point."""
        return float(np.mean(self.count > 0))


@dataclass(frozen=True, slots=True)
class Area:
    """One of the nine: points in it, the share of its cells without any, and the largest uncertainty in it, px.

    `standard_uncertainty_px` is None where no cell of it has a direction.
    """

    name: str
    point_count: int
    blank_share: float
    standard_uncertainty_px: float | None

    @property
    def is_blank(self) -> bool:
        return self.blank_share >= BLANK_SHARE


@dataclass(frozen=True, slots=True)
class ProjectionField:
    """One focus group: its cells, and in each the standard uncertainty (px) of a projected point at infinity.

    `uncertainty_px` is that along the direction in which it is largest, at the cell's middle; NaN where the lens model
    has no direction.
    """

    focus_group: str
    images: int
    cells: CoverageCells
    uncertainty_px: Float[np.ndarray, "r c"]

    @property
    def largest_covered_px(self) -> float | None:
        """Return the largest uncertainty of cells that have points; None where none is known."""
        return _largest(self.uncertainty_px[self.cells.count > 0])

    @property
    def largest_blank_px(self) -> float | None:
        """Return the largest uncertainty of cells without points; None if nothing is known of them."""
        return _largest(self.uncertainty_px[self.cells.count == 0])

    @property
    def areas(self) -> list[Area]:
        """Return the nine areas, row by row from the top."""
        found = []
        for number, name in enumerate(name for row in AREAS for name in row):
            inside = self.cells.area == number
            count = self.cells.count[inside]
            blank = float(np.mean(count == 0)) if len(count) else 0.0
            found.append(Area(name, int(count.sum()), blank, _largest(self.uncertainty_px[inside])))
        return found


def _largest(values: Float[np.ndarray, " n"]) -> float | None:
    known = values[np.isfinite(values)]
    return float(known.max()) if len(known) else None


def coverage_cells(points_px: Float[np.ndarray, "n 2"], width_px: int, height_px: int) -> CoverageCells:
    """Count points by cells, so large that each would have some ten if they were spread evenly."""
    longest = max(width_px, height_px)
    wanted = math.sqrt(width_px * height_px * _PER_CELL / max(len(points_px), 1))
    size = longest / round(min(max(longest / wanted, _FEWEST), _MOST))
    columns, rows = (math.ceil(side / size - 1e-9) for side in (width_px, height_px))
    place = np.floor((points_px + 0.5) / size).astype(np.intp)
    place = np.clip(place, 0, [columns - 1, rows - 1])
    count = np.bincount(place[:, 1] * columns + place[:, 0], minlength=rows * columns)
    return CoverageCells(width_px, height_px, size, count.reshape(rows, columns))
