"""All views at their placements: residuals, costs, and the products that normal equations are made of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from core.calibration.multi_view.view_stack import Placements, ViewStack
from core.calibration.residuals import (
    BROWN_SIZE,
    normal_equations,
    products_of_view,
    residuals_with_jacobian,
)
from core.numerics import CAUCHY_C, MEDIAN_LENGTH


@dataclass(frozen=True, slots=True)
class Linearised:
    """Views at their placements: products of `residuals.normal_equations` at unit scale; `residuals` in px,
    `squared` distances in stated uncertainties.
    """

    placements: Placements
    products: Float[np.ndarray, "m q q"]
    residuals: Float[np.ndarray, "2 n"]
    squared: Float[np.ndarray, " n"]
    cost: float

    @property
    def normal(self) -> Float[np.ndarray, "m p p"]:
        """Over the camera's free parameters, a rotation about the centroid and a translation."""
        return self.products[:, :-1, :-1]

    @property
    def of_poses(self) -> Float[np.ndarray, "m 6 6"]:
        """Over the pose alone."""
        return self.products[:, -7:-1, -7:-1]

    @property
    def square_sums(self) -> Float[np.ndarray, " m"]:
        """Of the distances of the points that count."""
        return self.products[:, -1, -1]


def linearise(
    views: ViewStack, placements: Placements, used: Bool[np.ndarray, " n"], *, robust: bool = False
) -> Linearised:
    """Evaluate every view over the points used, or robustly over all points: then each view by its own scale, of which
    the cost is made.
    """
    if placements.parameters.shape[1] != BROWN_SIZE:
        return _linearise_wide(views, placements, used, robust=robust)
    views_count, points = len(views), len(views.column)
    size = placements.free + 7
    products, cost = np.zeros((views_count, size, size)), np.zeros(views_count)
    residuals, squared = np.empty((2, points)), np.empty(points)
    normal_equations(
        views.first,
        views.points_target,
        views.centroids,
        views.points_px,
        views.weight,
        used,
        placements.parameters,
        placements.rotations,
        placements.translations_mm,
        robust,
        CAUCHY_C,
        MEDIAN_LENGTH[2],
        products,
        residuals,
        squared,
        cost,
    )
    return Linearised(placements, products, residuals, squared, float(cost.sum()))


def _linearise_wide(
    views: ViewStack, placements: Placements, used: Bool[np.ndarray, " n"], *, robust: bool
) -> Linearised:
    """Evaluate every view as `linearise`, before a camera of any lens model."""
    size, points = placements.free + 7, len(views.column)
    products, cost = np.zeros((len(views), size, size)), np.zeros(len(views))
    residuals, squared = np.empty((2, points)), np.empty(points)
    for i in np.flatnonzero(views.counts).tolist():
        part = views.part(i)
        left, jacobian = residuals_with_jacobian(*views.centred(i, part), placements.view(i), placements.free)
        residuals[:, part] = left
        products[i], squared[part], cost[i] = products_of_view(
            left, jacobian, views.weight[part], used[part], robust=robust
        )
    return Linearised(placements, products, residuals, squared, float(cost.sum()))
