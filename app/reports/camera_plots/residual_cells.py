"""Residuals of the lens model by cells of the image, and the figures that the plot of them prints."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

MIN_POINTS_IN_CELL = 3
_PER_CELL = 25
_CHANCE = 0.01
_CHI2 = -2.0 * math.log(_CHANCE)  # the quantile of χ² with two degrees of freedom


@dataclass(frozen=True, slots=True)
class ResidualField:
    """The residuals (observed - predicted, px) of one focus group's points, at the places where they were observed."""

    focus_group: str
    images: int
    width_px: int
    height_px: int
    points_px: Float[np.ndarray, "n 2"]
    residuals_px: Float[np.ndarray, "n 2"]
    outliers: int


@dataclass(frozen=True, slots=True)
class Cells:
    """Residuals by square cells of the image: of each that has points enough its middle, mean, rms and count.

    `stands_out`: the mean is longer than chance lets it be in one cell of a hundred, n |m|² / σ² > χ²₂.
    """

    size_px: float
    middle_px: Float[np.ndarray, "c 2"]
    mean_px: Float[np.ndarray, "c 2"]
    rms_px: Float[np.ndarray, " c"]
    count: Int[np.ndarray, " c"]

    @property
    def stands_out(self) -> Float[np.ndarray, " c"]:
        # Of what scatters within the cells; a cell's own would be too uncertain.
        within = self.count * (self.rms_px**2 - np.sum(self.mean_px**2, axis=1))
        freedom = 2.0 * float(np.sum(self.count - 1))
        variance = max(float(within.sum()) / max(freedom, 1.0), 1e-30)
        return np.asarray(self.count * np.sum(self.mean_px**2, axis=1) / variance > _CHI2)


def cells_of(field: ResidualField) -> Cells:
    """Sort the residuals into cells, so large that each has some 25 points where the image is full."""
    wanted = math.sqrt(field.width_px * field.height_px * _PER_CELL / max(len(field.points_px), 1))
    longest = max(field.width_px, field.height_px)
    size = longest / round(min(max(longest / wanted, 6.0), 26.0))
    columns = math.ceil(field.width_px / size)
    place = np.floor((field.points_px + 0.5) / size).astype(np.intp)
    place = np.clip(place, 0, [columns - 1, math.ceil(field.height_px / size) - 1])
    index = place[:, 1] * columns + place[:, 0]
    found, inverse, count = np.unique(index, return_inverse=True, return_counts=True)
    sums = [np.bincount(inverse, weights=field.residuals_px[:, axis]) for axis in (0, 1)]
    squares = np.bincount(inverse, weights=np.sum(field.residuals_px**2, axis=1))
    full = count >= MIN_POINTS_IN_CELL
    middle = np.stack([found % columns + 0.5, found // columns + 0.5], axis=1) * size - 0.5
    return Cells(
        size,
        middle[full],
        (np.stack(sums, axis=1) / count[:, None])[full],
        np.sqrt(squares / count)[full],
        count[full],
    )


@dataclass(frozen=True, slots=True)
class ResidualFigures:
    """What the plot of a focus group's residuals prints.

    `point_count` points count, `rms_px` is the root mean square of their residual distances, `cells` the cells with
    points enough, `cells_beyond_chance` those whose mean residual chance explains in one cell of a hundred at most,
    `cells_by_chance` how many such cells chance alone gives; `mean_rms_px` is of the cells' mean residuals.
    """

    point_count: int
    outlier_count: int
    rms_px: float
    cells: int
    cells_beyond_chance: int
    cells_by_chance: float
    mean_rms_px: float


def residual_figures(field: ResidualField, cells: Cells) -> ResidualFigures:
    """Return the figures of a focus group's residuals; zero where there is nothing."""
    count = len(cells.count)
    return ResidualFigures(
        len(field.points_px),
        field.outliers,
        math.sqrt(float(np.mean(np.sum(field.residuals_px**2, axis=1)))) if len(field.points_px) else 0.0,
        count,
        int(np.count_nonzero(cells.stands_out)) if count else 0,
        _CHANCE * count,
        math.sqrt(float(np.mean(np.sum(cells.mean_px**2, axis=1)))) if count else 0.0,
    )
