"""Bundle adjustment of many views of one lens: a pose per view, with shared and per-view camera parameters.

One step for all views is solved from normal equations of arrow shape (`core.numerics.schur`).

The fit is robust in stages, as the solver of one image is: plain least squares, which is the answer where its
residuals are the noise that was stated and nothing stands out; else Cauchy weights by each view's own scale, then
rejection of points beyond 4 MAD (`repeat_consistency`) and of views whose residuals are far above the others', then
plain least squares again. Rejected views are placed anew before the camera of the others, and are used again if
their residuals then are similar.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from core.calibration.multi_view.linearisation import Linearised, linearise
from core.calibration.multi_view.repeat_consistency import find_repeats, inliers_of
from core.calibration.multi_view.view_stack import Placements, ViewStack, coordinates, medians, moved
from core.calibration.priors import CameraPrior, Lens, camera_prior
from core.calibration.state import SMALLEST_NOISE_PX
from core.numerics import (
    EXPECTED_SCALE,
    NEGLIGIBLE_STEP,
    OBSERVATIONS_PER_PARAMETER,
    PLAIN_ITERATIONS,
    ROBUST_STEP_TOLERANCE,
    STEP_TOLERANCE,
    ArrowheadEquations,
    Sharing,
    arrow,
)

ITERATIONS = 300  # a bowed print seen from one orientation: f, depths and tilts move together, by little
MAX_MEDIAN_RATIO = 5.0
"""A view whose residuals are this many times the median view's is not one of the others' kind."""
MIN_DAMPING, MAX_DAMPING = 1e-9, 1e6


@dataclass(frozen=True, slots=True)
class Damping:
    """Damping of the steps, relative to the diagonal (H. B. Nielsen, "Damping parameter in Marquardt's method", 1999).

    Images of one orientation leave focal length and depths along a long narrow valley, which bends: the whole step
    leaves it, and one that is damped by a thousandth hardly moves. So damping begins small, and grows the faster the
    more steps in a row were rejected.
    """

    value: float = 0.0
    growth: float = 2.0

    def relaxed(self) -> Damping:
        """Return the damping after a step that was accepted."""
        return Damping(self.value / 3.0 if self.value > 3.0 * MIN_DAMPING else 0.0)

    def tightened(self) -> Damping:
        """Return the damping after a step that was rejected."""
        return Damping(max(self.growth * self.value, MIN_DAMPING), 2.0 * self.growth)


@dataclass(frozen=True, slots=True)
class BundleAdjustment:
    """Result of fitting views that share camera parameters.

    `covariance` of the common camera parameters, in the order of the model's `LENS_PARAMETERS`; what views have of
    their own is 0 there. `scale` is σ per unit of the points' stated uncertainty. `kept` is false for rejected views,
    `used` for rejected points. `converged` is false where the iteration did not converge: then the values
    only show what is not observable.
    """

    at: Linearised
    covariance: Float[np.ndarray, "s s"]
    used: Bool[np.ndarray, " n"]
    kept: Bool[np.ndarray, " m"]
    scale: float
    converged: bool


def bundle_adjust(
    views: ViewStack,
    start: Placements,
    sharing: Sharing,
    *,
    lens: Lens | None = None,
    repeats: Int[np.ndarray, " m"] | None = None,
) -> BundleAdjustment:
    """Fit all views at once from `start`; views of one label in `repeats` show one pose."""
    size = start.parameters.shape[1]
    prior = camera_prior(views.image_width_px, views.image_height_px, lens, model_size=size)
    problem = _Problem(views, sharing, prior)
    everything = np.ones(len(views.column), dtype=np.bool_)
    every_view = np.ones(len(views), dtype=np.bool_)
    at, scale, converged = problem.plain(start, everything, every_view, EXPECTED_SCALE, PLAIN_ITERATIONS)
    poses = find_repeats(views, repeats)
    kept = problem.consistent_views(at)
    used = inliers_of(views, poses, at.residuals, kept)
    clean = converged and bool(used.all())
    if clean and scale <= EXPECTED_SCALE and problem.redundant():
        return problem.summary(at, used, kept, scale, converged)
    of_all, scale_of_all = at, scale
    # Gross errors can pull a plain fit anywhere: then it is no start for the next stage either.
    at = problem.robust(at.placements if clean else start)
    kept = problem.consistent_views(at)
    used = inliers_of(views, poses, at.residuals, kept)
    at, scale, converged = problem.plain(at.placements, used, kept)
    while converged and sharing.common and not kept.all():
        at = problem.placed_again(at, used, kept)
        known = problem.consistent_views(at) & ~kept
        if known.any():
            kept = kept | known
            used = inliers_of(views, poses, at.residuals, kept)
            at, scale, converged = problem.plain(at.placements, used, kept)
        elif clean and scale > EXPECTED_SCALE and scale_of_all <= MAX_MEDIAN_RATIO * scale:
            # All points of all views agreed. Without some the others are still far from their noise and not much nearer
            # to it: what does not fit is nothing of these views', but what all have in common, as a print's shape.
            used, kept = everything, every_view
            at, scale, converged = problem.plain(of_all.placements, used, kept)
        else:
            break
    return problem.summary(at, used, kept, scale, converged)


@dataclass(frozen=True, slots=True)
class _Problem:
    views: ViewStack
    sharing: Sharing
    prior: CameraPrior

    def redundant(self) -> bool:
        """Whether every view has points enough that gross errors cannot hide in a plain fit."""
        least = 0.5 * OBSERVATIONS_PER_PARAMETER * len(self.sharing.local)
        return bool(np.all(self.views.counts >= least))

    def consistent_views(self, at: Linearised) -> Bool[np.ndarray, " m"]:
        """Return which views' median residuals are consistent with the others'."""
        median = np.sqrt(medians(at.squared, self.views.first))
        floor = SMALLEST_NOISE_PX * np.sqrt(self.views.median_weight)
        return np.asarray(median <= MAX_MEDIAN_RATIO * np.maximum(np.median(median), floor))

    def placed_again(
        self, at: Linearised, used: Bool[np.ndarray, " n"], kept: Bool[np.ndarray, " m"]
    ) -> Linearised:
        """Place the rejected views anew, each before the camera that the others found.

        With Cauchy weights the views that fit best draw the camera to themselves; where the print is not flat and every
        pose asks for another camera, some are left behind. The next stage moves the camera, but not rejected views.
        Their residuals show whether they are outliers only at their own best placement before that camera.
        """
        out = np.flatnonzero(~kept)
        alone = Sharing((), self.sharing.own, self.sharing.camera)
        found = bundle_adjust(self.views.take(out), at.placements.take(out), alone).at.placements
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
        damping = Damping()
        for _ in range(ITERATIONS):
            common, own, length = self.step(at, 1.0, damping.value)
            candidate = linearise(self.views, self.moved(at.placements, common, own), everything, robust=True)
            if candidate.cost <= at.cost:
                at, damping = candidate, damping.relaxed()
            else:
                damping = damping.tightened()
            if length < ROBUST_STEP_TOLERANCE or damping.value > MAX_DAMPING:
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
        damping = Damping()
        for _ in range(limit):
            found = max(math.sqrt(at.cost / freedom), smallest)
            scale = min(found, largest)
            common, own, length = self.step(at, scale, damping.value)
            if length < NEGLIGIBLE_STEP and not damping.value:
                return at, found, True
            candidate = linearise(self.views, self.moved(at.placements, common, own), used)
            if self.total(candidate, scale) <= self.total(at, scale):
                at, damping = candidate, damping.relaxed()
                if length < STEP_TOLERANCE and not damping.value:
                    return at, max(math.sqrt(at.cost / freedom), smallest), True
            elif length < STEP_TOLERANCE:  # the end, but for rounding errors
                return at, found, True
            else:
                damping = damping.tightened()
                if damping.value > MAX_DAMPING:
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

    def arrow(self, at: Linearised, scale: float, damping: float = 0.0) -> ArrowheadEquations:
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
        step = np.zeros((len(placements), self.sharing.camera))
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
    ) -> BundleAdjustment:
        size, free = at.placements.parameters.shape[1], self.sharing.camera
        covariance = np.zeros((size, size))
        if self.sharing.common:
            by_step = coordinates(at.placements.parameters[0])[:, list(self.sharing.common)]
            covariance[:free, :free] = by_step @ np.linalg.inv(self.arrow(at, scale).head) @ by_step.T
        return BundleAdjustment(at, covariance, used, kept, scale, converged)
