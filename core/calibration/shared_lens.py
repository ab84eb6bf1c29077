"""Many views, one lens: a pose for every view, with what the views share and what each has of its own told apart.

The step of all views at once is solved from equations in the shape of an arrow (`arrow`).

Robust in stages, as the solver of one image is: plain least squares, which is the answer where its residuals are the
noise that was stated and nothing stands out; else Cauchy weights by each view's own scale, then rejection of points
beyond 4 MAD (`inliers`) and of whole views whose residuals are far above the others', then plain least squares again.
Views left out are placed anew before the camera of the others, and are back if their residuals then are like theirs.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from core.calibration.arrow import Arrow, Sharing, arrow
from core.calibration.in_parts import in_two_parts
from core.calibration.inliers import find_repeats, inliers_of
from core.calibration.model import SMALLEST_NOISE_PX, Lens, camera_prior
from core.calibration.view_residuals import normal_equations
from core.calibration.view_stack import Placements, ViewStack, medians
from core.least_squares import (
    CAUCHY_C,
    EXPECTED_SCALE,
    MEDIAN_LENGTH,
    NEGLIGIBLE_STEP,
    OBSERVATIONS_PER_PARAMETER,
    PLAIN_ITERATIONS,
    ROBUST_STEP_TOLERANCE,
    STEP_TOLERANCE,
)
from core.transforms import rotations_from_vectors

ITERATIONS = 40
FOREIGN = 5.0
"""A view whose residuals are this many times the median view's is not one of the others' kind."""
DAMPING_AT_MOST = 1e6

CameraPrior = Callable[[Float[np.ndarray, "9"]], tuple[Float[np.ndarray, " q"], Float[np.ndarray, "q p"]]]


@dataclass(frozen=True, slots=True)
class Linearised:
    """Views at their placements: the products of `view_residuals.normal_equations` at unit scale; `residuals` in px,
    `squared` distances in stated uncertainties.
    """

    placements: Placements
    products: Float[np.ndarray, "m 15 15"]
    residuals: Float[np.ndarray, "2 n"]
    squared: Float[np.ndarray, " n"]
    cost: float

    @property
    def normal(self) -> Float[np.ndarray, "m 14 14"]:
        """Over the camera's first eight parameters, a rotation about the centroid and a translation."""
        return self.products[:, :14, :14]

    @property
    def gradient(self) -> Float[np.ndarray, "m 14"]:
        return self.products[:, :14, 14]

    @property
    def square_sums(self) -> Float[np.ndarray, " m"]:
        """Of the distances of the points that count."""
        return self.products[:, 14, 14]


@dataclass(frozen=True, slots=True)
class SharedLens:
    """What views with something in common amount to.

    `covariance` (9, 9) of the common camera parameters, in the order of `CAMERA_PARAMETERS`; what views have of their
    own is 0 there. `scale` is σ per unit of the points' stated uncertainty. `kept` is false for views left out, `used`
    for points. `converged` is false where the iteration did not come to its end: then this is no answer, but shows what
    could not be told.
    """

    at: Linearised
    covariance: Float[np.ndarray, "9 9"]
    used: Bool[np.ndarray, " n"]
    kept: Bool[np.ndarray, " m"]
    scale: float
    converged: bool


def fit_shared_lens(
    views: ViewStack,
    start: Placements,
    sharing: Sharing,
    *,
    lens: Lens | None = None,
    repeats: Int[np.ndarray, " m"] | None = None,
) -> SharedLens:
    """Fit all views at once from `start`; views of one label in `repeats` show one pose."""
    problem = _Problem(views, sharing, camera_prior(views.image_width_px, views.image_height_px, lens))
    everything = np.ones(len(views.column), dtype=np.bool_)
    every_view = np.ones(len(views), dtype=np.bool_)
    at, scale, converged = problem.plain(start, everything, every_view, EXPECTED_SCALE, PLAIN_ITERATIONS)
    poses = find_repeats(views, repeats)
    kept = problem.alike(at)
    used = inliers_of(views, poses, at.residuals, kept)
    clean = converged and bool(used.all())
    if clean and scale <= EXPECTED_SCALE and problem.redundant():
        return problem.summary(at, used, kept, scale, converged)
    of_all, scale_of_all = at, scale
    # Gross errors can pull a plain fit anywhere: then it is no start for the next stage either.
    at = problem.robust(at.placements if clean else start)
    kept = problem.alike(at)
    used = inliers_of(views, poses, at.residuals, kept)
    at, scale, converged = problem.plain(at.placements, used, kept)
    while converged and sharing.common and not kept.all():
        at = problem.placed_again(at, used, kept)
        known = problem.alike(at) & ~kept
        if known.any():
            kept = kept | known
            used = inliers_of(views, poses, at.residuals, kept)
            at, scale, converged = problem.plain(at.placements, used, kept)
        elif clean and scale > EXPECTED_SCALE and scale_of_all <= FOREIGN * scale:
            # All points of all views agreed. Without some the others are still far from their noise and not much nearer
            # to it: what does not fit is nothing of these views', but what all have in common, as a print's shape.
            used, kept = everything, every_view
            at, scale, converged = problem.plain(of_all.placements, used, kept)
        else:
            break
    return problem.summary(at, used, kept, scale, converged)


def linearise(
    views: ViewStack, placements: Placements, used: Bool[np.ndarray, " n"], *, robust: bool = False
) -> Linearised:
    """Evaluate every view over the points used; or robustly over all, each view by its own scale, which the cost is
    made of.
    """
    views_count, points = len(views), len(views.column)
    products, cost = np.zeros((views_count, 15, 15)), np.zeros(views_count)
    residuals, squared = np.empty((2, points)), np.empty(points)
    centroids, weight = views.centroids, views.weight

    def evaluate(begin: int, stop: int) -> None:
        normal_equations(
            views.first,
            views.points_target,
            centroids,
            views.points_px,
            weight,
            used,
            placements.parameters,
            placements.rotations,
            placements.translations_mm,
            robust,
            CAUCHY_C,
            MEDIAN_LENGTH[2],
            begin,
            stop,
            products,
            residuals,
            squared,
            cost,
        )

    in_two_parts(evaluate, views_count, points)
    return Linearised(placements, products, residuals, squared, float(cost.sum()))


@dataclass(frozen=True, slots=True)
class _Problem:
    views: ViewStack
    sharing: Sharing
    prior: CameraPrior

    def redundant(self) -> bool:
        """Whether every view has points enough that gross errors cannot hide in a plain fit."""
        least = 0.5 * OBSERVATIONS_PER_PARAMETER * len(self.sharing.local)
        return bool(np.all(self.views.counts >= least))

    def alike(self, at: Linearised) -> Bool[np.ndarray, " m"]:
        """Return which views are of the others' kind."""
        median = np.sqrt(medians(at.squared, self.views.first))
        floor = SMALLEST_NOISE_PX * np.sqrt(self.views.median_weight)
        return np.asarray(median <= FOREIGN * np.maximum(np.median(median), floor))

    def placed_again(
        self, at: Linearised, used: Bool[np.ndarray, " n"], kept: Bool[np.ndarray, " m"]
    ) -> Linearised:
        """Place the views left out anew, each before the camera that the others found.

        With Cauchy weights the views that fit best draw the camera to themselves; where the print is not flat and every
        pose asks for another camera, some are left behind. The next stage moves the camera, but not views left out:
        only once they are at their own best before it do their residuals tell whether they are foreign.
        """
        out = np.flatnonzero(~kept)
        alone = Sharing(common=(), own=self.sharing.own)
        found = fit_shared_lens(self.views.take(out), at.placements.take(out), alone).at.placements
        rotations, translations = at.placements.rotations.copy(), at.placements.translations_mm.copy()
        parameters = at.placements.parameters.copy()
        parameters[out], rotations[out], translations[out] = (
            found.parameters,
            found.rotations,
            found.translations_mm,
        )
        return linearise(self.views, Placements(parameters, rotations, translations), used)

    def robust(self, start: Placements) -> Linearised:
        """Iterate with Cauchy weights, σ from each view's own median, while residuals become smaller."""
        everything = np.ones(len(self.views.column), dtype=np.bool_)
        at = linearise(self.views, start, everything, robust=True)
        damping = 0.0
        for _ in range(ITERATIONS):
            common, own, length = self.step(at, 1.0, damping)
            candidate = linearise(self.views, self.moved(at.placements, common, own), everything, robust=True)
            if candidate.cost <= at.cost:
                at, damping = candidate, 0.1 * damping if damping > 1e-4 else 0.0
            else:
                damping = max(10.0 * damping, 1e-3)
            if length < ROBUST_STEP_TOLERANCE or damping > DAMPING_AT_MOST:
                break
        return at

    def plain(
        self,
        start: Placements,
        used: Bool[np.ndarray, " n"],
        kept: Bool[np.ndarray, " m"],
        largest: float = math.inf,
        limit: int = ITERATIONS,
    ) -> tuple[Linearised, float, bool]:
        """Iterate with the points `used`; return σ per unit of stated uncertainty and whether the end was reached.

        `largest` bounds the σ that steps are weighed with.
        """
        at = linearise(self.views, start, used)
        parameters = int(kept.sum()) * len(self.sharing.local) + len(self.sharing.common)
        freedom = max(2 * int(used.sum()) - parameters, 1)
        smallest = SMALLEST_NOISE_PX * math.sqrt(float(np.median(self.views.median_weight)))
        damping = 0.0
        for _ in range(limit):
            found = max(math.sqrt(at.cost / freedom), smallest)
            scale = min(found, largest)
            common, own, length = self.step(at, scale, damping)
            if length < NEGLIGIBLE_STEP and not damping:
                return at, found, True
            candidate = linearise(self.views, self.moved(at.placements, common, own), used)
            if self.total(candidate, scale) <= self.total(at, scale):
                at, damping = candidate, 0.1 * damping if damping > 1e-4 else 0.0
                if length < STEP_TOLERANCE and not damping:
                    return at, max(math.sqrt(at.cost / freedom), smallest), True
            elif length < STEP_TOLERANCE:  # the end, but for rounding errors
                return at, found, True
            else:
                damping = max(10.0 * damping, 1e-3)
                if damping > DAMPING_AT_MOST:
                    break
        return at, max(math.sqrt(at.cost / freedom), smallest), False

    def total(self, at: Linearised, scale: float) -> float:
        q, _ = self.prior(at.placements.parameters[0])
        return at.cost / scale**2 + (float(q @ q) if self.sharing.common else 0.0)

    def step(
        self, at: Linearised, scale: float, damping: float
    ) -> tuple[Float[np.ndarray, " s"], Float[np.ndarray, "m l"], float]:
        """Return the common step, the views' own, and the longest of them in units of its own uncertainty."""
        plain = self.arrow(at, scale)
        common, own = (plain if not damping else self.arrow(at, scale, damping)).solve()
        return common, own, plain.longest(common, own)

    def arrow(self, at: Linearised, scale: float, damping: float = 0.0) -> Arrow:
        prior = None
        if self.sharing.common:
            parameters = at.placements.parameters[0]
            q, Q = self.prior(parameters)
            Q = (Q @ coordinates(parameters))[:, self.sharing.common]
            prior = Q.T @ Q, Q.T @ q
        return arrow(at.products, at.placements.parameters, self.sharing, 1.0 / scale**2, prior, damping)

    def moved(
        self,
        placements: Placements,
        common: Float[np.ndarray, " s"],
        own: Float[np.ndarray, "m l"],
    ) -> Placements:
        step = np.zeros((len(placements), 8))
        step[:, list(self.sharing.common)] = common
        step[:, list(self.sharing.own)] = own[:, :-6]
        return moved(placements, step, own[:, -6:])

    def summary(
        self,
        at: Linearised,
        used: Bool[np.ndarray, " n"],
        kept: Bool[np.ndarray, " m"],
        scale: float,
        converged: bool,
    ) -> SharedLens:
        covariance = np.zeros((9, 9))
        if self.sharing.common:
            by_step = coordinates(at.placements.parameters[0])[:, list(self.sharing.common)]
            covariance[:8, :8] = by_step @ np.linalg.inv(self.arrow(at, scale).head) @ by_step.T
        return SharedLens(at, covariance, used, kept, scale, converged)


def coordinates(parameters: Float[np.ndarray, "9"]) -> Float[np.ndarray, "8 8"]:
    """Return the derivatives of the first eight camera parameters by the step's coordinates."""
    fx, fy = float(parameters[0]), float(parameters[1])
    change = np.eye(8)
    change[:2, :2] = [[fx, 0.5 * fx], [fy, -0.5 * fy]]
    return change


def moved(
    placements: Placements, step: Float[np.ndarray, "m 8"], pose: Float[np.ndarray, "m 6"]
) -> Placements:
    """Return the placements after a step of each view's camera, in the arrow's coordinates, and of its pose."""
    parameters = placements.parameters.copy()
    focal, ratio = np.clip(step[:, 0], -0.5, 0.5), np.clip(step[:, 1], -0.1, 0.1)
    parameters[:, 0] *= np.exp(focal + 0.5 * ratio)
    parameters[:, 1] *= np.exp(focal - 0.5 * ratio)
    parameters[:, 2:8] += step[:, 2:]
    translations = placements.translations_mm + pose[:, 3:]
    # A centroid never passes through the camera.
    depth = placements.translations_mm[:, 2]
    translations[:, 2] = depth * np.exp(np.clip(pose[:, 5] / depth, -0.7, 0.7))
    return Placements(parameters, rotations_from_vectors(pose[:, :3]) @ placements.rotations, translations)
