"""Inflation of uncertainties by correlated residuals: print errors, lenses beyond the model.

Corner noise is independent from point to point and from image to image. What a bowed print or a lens beyond five
coefficients leaves in the residuals is not: it resembles its neighbour's, it is the same in every image of a pose, and
it pulls the camera one way in one pose and another way in the next. Two estimates of the growth of a common camera's
variance, of which the larger counts:

- Between poses. Each pose's images, by themselves, would have a camera of their own; one step toward it lessens their
  squared residuals by gᵀ S⁺ g (Rao's score test), χ² under noise alone. The ratio of the sum over poses to its
  expectation is the growth, as in R. T. Birge, Phys. Rev. 40 (1932) 207 (doi:10.1103/PhysRev.40.207).
- Between neighbours. With correlations ρ^|i| ρ^|j| over the grid, the variance of a smooth combination of residuals is
  ((1 + ρ)/(1 - ρ))² that of white noise; ρ is that of the mean residuals of each pose, and where that mean holds more
  than the noise of n images, the ratio of n times its variance to the noise's counts as well. One pose alone gives
  only this estimate.

A pose's own covariance grows by the neighbours' factor of single images. The fit itself makes residuals correlate by
-J C Jᵀ, which is taken off, and chance is shrunk away by Wiener's factor z²/(1 + z²), z in standard errors.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from core.calibration.multi_view.bundle_adjustment import BundleAdjustment
from core.calibration.multi_view.linearisation import Linearised
from core.calibration.multi_view.schur_blocks import SchurBlocks, reduced, score_test
from core.calibration.multi_view.view_stack import ViewStack, evenly, groups_of, segment_sums
from core.calibration.residuals import residuals_with_jacobian
from core.calibration.state import SMALLEST_NOISE_PX
from core.calibration.uncertainty import MAX_CORRELATION, neighbours

MAX_SAMPLES = 30
"""Images, and poses, evenly chosen, from which the correlation of neighbours is estimated."""
MIN_PAIRS = 20


@dataclass(frozen=True, slots=True)
class VarianceInflation:
    """Factors of variances: of the common camera's, and of what each image has of its own."""

    camera: float
    own: float


@dataclass(frozen=True, slots=True)
class _Pose:
    """Images of one pose that show the same points, the residuals' mean and the points that count in all of them."""

    images: Int[np.ndarray, " n"]
    residuals: Float[np.ndarray, "2 p"]
    used: Bool[np.ndarray, " p"]


def variance_inflation(
    views: ViewStack,
    at: Linearised,
    used: Bool[np.ndarray, " n"],
    labels: Int[np.ndarray, " k"],
    parts: SchurBlocks,
    own: Float[np.ndarray, "k p l"] | None,
    scale: Float[np.ndarray, " k"],
    shared: Float[np.ndarray, "c c"] | None,
    common: int,
) -> VarianceInflation:
    """Return the factors by which correlated residuals inflate variances.

    Parameters: `own` and `parts` as for `schur_blocks.reduced`; `scale` is the noise of each view per unit of stated
    uncertainty; `shared` is the covariance of the common camera at that noise, None without a common camera, of which
    `common` parameters were fitted.
    """
    if np.all(scale * views.uncertainty <= SMALLEST_NOISE_PX * (1.0 + 1e-9)):
        return VarianceInflation(1.0, 1.0)  # what is left are rounding errors
    free = at.placements.free
    unit = np.zeros((free, free)) if shared is None else shared / float(np.mean(scale**2))
    context = _Context(views, at, parts, own, scale, unit)
    single = _field(
        context,
        [
            _Pose(np.array([i]), at.residuals[:, views.part(i)], used[views.part(i)])
            for i in evenly(list(range(len(views))), MAX_SAMPLES)
        ],
    )
    if not common:
        return VarianceInflation(1.0, single.growth)
    of_means = single.growth
    poses = _poses(views, at, used, labels)
    if any(len(p.images) > 1 for p in poses):
        means = _field(context, poses)
        if single.freedom > 0 and means.freedom > 0 and single.variance > 0:
            # Of means over n images n times the variance is the noise's; there is more where all n share something.
            ratio = means.variance / single.variance
            of_means = means.growth * _beyond_chance(ratio, math.sqrt(2.0 / means.freedom))
    return VarianceInflation(
        max(of_means, _between_poses(views, at, used, labels, parts, common)), single.growth
    )


def shared_variance_inflation(
    views: ViewStack, shared: BundleAdjustment, labels: Int[np.ndarray, " k"]
) -> VarianceInflation:
    """Return the inflation for a camera common to all views, each with a pose of its own."""
    kept = np.flatnonzero(shared.kept)
    points = views.spread(shared.kept)
    at = Linearised(
        shared.at.placements.take(kept),
        shared.at.products[kept],
        shared.at.residuals[:, points],
        shared.at.squared[points],
        shared.at.cost,
    )
    free = at.placements.free
    return variance_inflation(
        views.take(kept),
        at,
        shared.used[points],
        labels[kept],
        reduced(at.products, None),
        None,
        np.full(len(kept), shared.scale),
        shared.covariance[:free, :free],
        free,
    )


def _between_poses(
    views: ViewStack,
    at: Linearised,
    used: Bool[np.ndarray, " n"],
    labels: Int[np.ndarray, " k"],
    parts: SchurBlocks,
    common: int,
) -> float:
    """Return the inflation that follows from the poses' disagreement over the camera; 1 where it cannot be tested."""
    order = np.argsort(labels, kind="stable")
    bounds = np.concatenate([[0], np.cumsum(np.unique(labels, return_counts=True)[1])])

    def summed(of_views: np.ndarray) -> np.ndarray:
        return segment_sums(of_views[order], bounds)

    gain, rank = score_test(summed(parts.S), summed(parts.g), 1.0 / np.sqrt(summed(1.0 / parts.unit**2)))
    squares = summed(at.square_sums)
    left = summed(2.0 * views.sums(used.astype(np.float64)) - parts.L.shape[1]) - rank
    enough = left > 0
    freedom = int(rank[enough].sum()) - common
    if freedom <= 0:
        return 1.0
    variance = np.maximum(squares - gain, 1e-12 * squares + 1e-300) / np.maximum(left, 1.0)
    ratio = float(np.sum((gain / variance)[enough])) / freedom
    return _beyond_chance(ratio, math.sqrt(2.0 / freedom))


@dataclass(frozen=True, slots=True)
class _Context:
    views: ViewStack
    at: Linearised
    parts: SchurBlocks
    own: Float[np.ndarray, "k p l"] | None
    scale: Float[np.ndarray, " k"]
    unit: Float[np.ndarray, "c c"]
    """The common camera's covariance at unit noise."""


@dataclass(frozen=True, slots=True)
class _Field:
    """Correlation of residuals over grids: growth of a smooth combination's variance; variance times n of each mean."""

    growth: float
    variance: float
    freedom: float


def _field(context: _Context, poses: Sequence[_Pose]) -> _Field:
    views, at = context.views, context.at
    products = leverage = squares = freedom = 0.0
    pairs = 0
    for pose in poses:
        i = int(pose.images[0])
        part = views.part(i)
        target = views.targets[int(views.target[i])]
        index = np.full((target.grid_rows, target.grid_columns), -1)
        index[views.row[part][pose.used], views.column[part][pose.used]] = np.arange(int(pose.used.sum()))
        first, second = neighbours(index)
        root = np.sqrt(views.weight[part])[pose.used] / context.scale[i]
        r = pose.residuals[:, pose.used] * root
        points = part.start + np.flatnonzero(pose.used)
        _, J = residuals_with_jacobian(*views.centred(i, points), at.placements.view(i), len(context.unit))
        J *= root * context.scale[i]
        spread = np.tensordot(_covariance(context, i, len(pose.images)), J, axes=1)
        count = len(pose.images)
        products += count * float(np.sum(r[:, first] * r[:, second]))
        leverage += count * float(np.sum(spread[:, :, first] * J[:, :, second]))
        squares += count * float(np.sum(r * r))
        freedom += r.size - count * float(np.sum(spread * J))
        pairs += 2 * len(first)
    if pairs < MIN_PAIRS or freedom <= 0.0 or squares <= 0.0:
        return _Field(1.0, 0.0, 0.0)
    variance = squares / freedom
    rho = (products + leverage) / (pairs * variance)
    z_squared = rho**2 * pairs
    bounded = min(max(rho, 0.0) * z_squared / (1.0 + z_squared), MAX_CORRELATION)
    return _Field(((1.0 + bounded) / (1.0 - bounded)) ** 2, variance, freedom)


def _covariance(context: _Context, i: int, count: int) -> Float[np.ndarray, "p p"]:
    """Return that of camera and pose at unit noise: the image's own, a mean over `count`, and the common camera's."""
    parts, free = context.parts, len(context.unit)
    along = np.eye(free + 6)[:, free:] if context.own is None else context.own[i]
    follows = np.eye(free + 6)[:, :free] - along @ parts.by_camera[i]
    return np.asarray(
        along @ np.linalg.inv(parts.L[i]) @ along.T / count + follows @ context.unit @ follows.T
    )


def _beyond_chance(ratio: float, standard_error: float) -> float:
    """Return a ratio that is 1 under noise alone, freed of what chance alone would add; never below 1."""
    excess = max(ratio - 1.0, 0.0)
    z_squared = (excess / standard_error) ** 2
    return 1.0 + excess * z_squared / (1.0 + z_squared)


def _poses(
    views: ViewStack, at: Linearised, used: Bool[np.ndarray, " n"], labels: Int[np.ndarray, " k"]
) -> list[_Pose]:
    """Return the mean residuals of each label's images that show what its first one shows."""
    poses = []
    for group in evenly(groups_of(labels * len(views.targets) + views.target), MAX_SAMPLES):
        first = int(group[0])
        count, cells = int(views.counts[first]), views.cell[views.part(first)]
        equal = group[views.counts[group] == count]
        points = views.first[equal][:, None] + np.arange(count)
        same = np.all(views.cell[points] == cells, axis=1)
        equal, points = equal[same], points[same]
        mean = np.take(at.residuals, points, axis=1).mean(axis=1)
        poses.append(_Pose(equal, mean, used[points].all(axis=0)))
    return poses
