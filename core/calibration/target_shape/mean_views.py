"""Images of one pose as one view: the mean of their residuals, and the noise of repeated images about it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from core.calibration.multi_view import CommonFit
from core.calibration.state import SMALLEST_NOISE_PX

MIN_FREEDOM_OF_REPEATS = 200
"""Degrees of freedom below which repeated images do not determine their noise."""


@dataclass(frozen=True, slots=True)
class MeanView:
    """Mean of the images of one pose: their rows, the target, its points, pixels and roots of weights."""

    images: Int[np.ndarray, " j"]
    target: int
    cells: Int[np.ndarray, " n"]
    points_px: Float[np.ndarray, "2 n"]
    root: Float[np.ndarray, " n"]
    centroid: Float[np.ndarray, "3"]
    points_target: Float[np.ndarray, "3 n"]


def images_by_pose(fit: CommonFit) -> list[Int[np.ndarray, " _"]]:
    """Return the rows of the images of each pose before each target."""
    numbers = fit.pose * len(fit.views.targets) + fit.views.target
    return [np.flatnonzero(numbers == n) for n in np.unique(numbers)]


def _same_points(fit: CommonFit, images: Int[np.ndarray, " j"]) -> Int[np.ndarray, "j n"]:
    """Return where the points stand of those images that show what the first one shows."""
    views, first = fit.views, int(images[0])
    equal = images[views.counts[images] == views.counts[first]]
    points = views.first[equal][:, None] + np.arange(int(views.counts[first]))
    return points[np.all(views.cell[points] == views.cell[views.part(first)], axis=1)]


def noise_of(fit: CommonFit, groups: Sequence[Int[np.ndarray, " _"]]) -> tuple[float, bool]:
    """Return σ per unit of stated uncertainty, and whether repeated images give it."""
    squares, freedom = 0.0, 0
    for images in groups:
        points = _same_points(fit, images)
        if len(points) < 2:
            continue
        points = points[:, fit.used[points].all(axis=0)]
        about = np.take(fit.residuals, points, axis=1)
        about -= about.mean(axis=1, keepdims=True)
        about *= about
        about *= fit.views.weight[points]
        squares += float(about.sum())
        freedom += (len(points) - 1) * (2 * points.shape[1] - 6)
    if freedom >= MIN_FREEDOM_OF_REPEATS:
        return max(math.sqrt(squares / freedom), smallest_noise(fit)), True
    return max(fit.scale, smallest_noise(fit)), False


def smallest_noise(fit: CommonFit) -> float:
    """Return the least σ that points may have, per unit of stated uncertainty."""
    return SMALLEST_NOISE_PX / float(fit.views.uncertainty.mean())


def mean_view(fit: CommonFit, images: Int[np.ndarray, " j"], noise: float) -> MeanView:
    """Return the images of a pose as one, observed where their mean residual puts it from the first one's place."""
    views, first = fit.views, int(images[0])
    points, part = _same_points(fit, images), views.part(first)
    counts: Bool[np.ndarray, " n"] = fit.used[points].all(axis=0)
    mean = np.take(fit.residuals, points, axis=1).mean(axis=1)
    weight = views.weight[points].mean(axis=0) * len(points)
    return MeanView(
        images,
        int(views.target[first]),
        views.cell[part],
        np.ascontiguousarray(views.points_px[part].T - fit.residuals[:, part] + mean),
        np.where(counts, np.sqrt(weight) / noise, 0.0),
        views.centroids[first],
        np.ascontiguousarray(views.points_target[part].T),
    )
