"""Selection of a session's lens model: Brown's unless the images contradict it.

A single image cannot decide. Over one image of each pose, Brown's model and Kannala's and Brandt's are fitted to the
same points. With N coordinates and the sums of squares χ²,

    w = N ln(χ²_Brown / χ²_KB)

is -2 log of the ratio of likelihoods, the noise's variance profiled out. Under Brown's model and independent noise it
is at most that of two further parameters, χ² with two degrees of freedom: w > 30 has a probability of 3e-7. Real prints
and lenses leave more than noise, so that a share is asked for too, w/N > 3 %, and both must hold with and without
sixteen departures of the board's shape as common parameters: a bent print imitates a lens.

Then the model has to explain images that it was not fitted to: with the images dealt into folds in their order, and the
camera fitted to the others, the pose alone is fitted to each image held out. The geometric mean over images of the
ratio of residual rms has to be below `MAX_HELD_OUT`. The mean of logarithms keeps one image of the edge from deciding.

Most sessions are done after a first look: how much radial terms beyond Brown's would gain, to first order.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from core.calibration.lens_selection.common_fit import (
    CommonCamera,
    fit_common_camera,
    held_out_rms,
    radial_gain,
    squared_distances,
)
from core.calibration.lens_selection.starts import (
    fit_angular_from_grid,
    fit_model,
    nearest_camera,
    observed_radius_px,
    seen_radius,
    with_camera,
)
from core.calibration.multi_view import BundleAdjustment, GroupEstimate, Placements, ViewStack, evenly
from core.calibration.priors import Lens
from core.calibration.state import SMALLEST_NOISE_PX
from core.geometry import AnyCamera, Camera, LensModel, camera_from_array, fold_radius_px, undistort_any

MIN_STATISTIC, MIN_SHARE = 30.0, 0.03
FIRST_LOOK_SHARE = 0.02
"""Of the squares: where radial terms gain less to first order, Brown's model is not looked at further."""
GROSS = 30.0
"""Times the median distance: points further off are nothing of the lens."""
MAX_DISTANCE, MAX_REJECTED = 4.0, 0.01
"""Times the median distance, and the share of points beyond it, after the fit of Brown's model: up to it they are gross
errors, more of them are what the model lacks.
"""
MAX_HELD_OUT, MAX_RATIONAL = 0.95, 0.98
"""Ratios of held-out residuals, to Brown's and to Kannala's and Brandt's: a model with more has gained nothing."""
MIN_VIEWS, MIN_HELD_OUT_VIEWS, MIN_RATIONAL_VIEWS = 2, 4, 7
MAX_VIEWS = 30
WIDE_ANGLE = math.radians(75.0)
"""From the axis: further out the tangent of the angle, which Brown's model is made of, is no measure."""
FOLD_MARGIN = 1.05
MIN_POINTS = 8


@dataclass(frozen=True, slots=True)
class LensEvidence:
    """What speaks against Brown's model: w, its share w/N, and the ratio of held-out residuals of the best other model
    to Brown's; None where images were not held out.
    """

    statistic: float
    share: float
    held_out: float | None

    @property
    def beyond_brown(self) -> bool:
        """Return whether Brown's model is contradicted, and another explains images that it was not fitted to."""
        gained = self.held_out is None or self.held_out < MAX_HELD_OUT
        return self.statistic > MIN_STATISTIC and self.share > MIN_SHARE and gained


@dataclass(frozen=True, slots=True)
class LensChoice:
    """The lens model of a focus group. `start` is a camera to begin its fit with, None with Brown's; `evidence` is
    None where there are too few images for any.
    """

    model: LensModel
    start: AnyCamera | None
    evidence: LensEvidence | None


BROWN = LensChoice("brown", None, None)


def select_lens(
    views: ViewStack,
    labels: Int[np.ndarray, " m"],
    lens: Lens | None,
    brown: GroupEstimate | None,
    asked: LensModel | None = None,
) -> LensChoice:
    """Return the lens model of images taken with one camera setting.

    `labels` number the poses, `brown` is the estimate with Brown's model, None where it failed. A model that is
    `asked` for is returned, with the evidence if there is any and a start if it can be fitted.
    """
    rows = _one_of_each(views, labels, brown)
    if len(rows) < MIN_VIEWS and asked in (None, "brown"):
        return BROWN
    chosen = views.take(rows)
    at = None if brown is None else _placements(views, brown, rows)
    if at is not None:
        chosen = _with_misfit(chosen, at)
    evidence = None
    if at is not None and brown is not None and asked in (None, "brown"):
        evidence = _first_look(chosen, at, lens)
        if evidence is not None:
            return replace(BROWN, evidence=evidence)
    angular = _angular(chosen, at, lens)
    if angular is None:
        return BROWN
    found = _Comparison.of(chosen, at, angular, lens)
    evidence = found.evidence()
    if asked == "brown":
        return replace(BROWN, evidence=evidence)
    rational = (
        found.rational() if asked == "rational" or (asked is None and found.allows_rational()) else None
    )
    if asked is not None:
        fit = angular if asked == "kannala_brandt" else rational
        return LensChoice(asked, None if fit is None else _camera(fit), evidence)
    if not found.beyond_brown():
        return replace(BROWN, evidence=evidence)
    models: list[tuple[LensModel, BundleAdjustment]] = [("kannala_brandt", angular)]
    if rational is not None and found.prefers(rational):
        models.insert(0, ("rational", rational))
    for model, fit in models:
        if not folds(_camera(fit), chosen, fit.used):
            return LensChoice(model, _camera(fit), evidence)
    return replace(BROWN, evidence=evidence)


def folds(camera: AnyCamera, views: ViewStack, used: Bool[np.ndarray, " n"]) -> bool:
    """Return whether a model turns back within the radius that the points cover, or just beyond."""
    fold = fold_radius_px(camera)
    return fold is not None and fold < FOLD_MARGIN * observed_radius_px(views.points_px[used], camera)


def _one_of_each(views: ViewStack, labels: Int[np.ndarray, " m"], brown: GroupEstimate | None) -> list[int]:
    """Return the first image of each pose that has points enough, of those that were estimated."""
    rows = np.arange(len(views)) if brown is None else brown.images
    rows = rows[views.counts[rows] >= MIN_POINTS]
    _, first = np.unique(labels[rows], return_index=True)
    return evenly(sorted(rows[first].tolist()), MAX_VIEWS)


def _placements(views: ViewStack, brown: GroupEstimate, rows: list[int]) -> Placements:
    place = {int(image): k for k, image in enumerate(brown.images.tolist())}
    chosen = [place[i] for i in rows]
    rotations = np.ascontiguousarray(np.swapaxes(brown.rotations[chosen], 1, 2))
    arms = views.centroids[rows] - brown.positions_mm[chosen]
    return Placements(
        np.tile(brown.camera.as_array(), (len(rows), 1)), rotations, np.einsum("kij,kj->ki", rotations, arms)
    )


def _with_misfit(views: ViewStack, at: Placements) -> ViewStack:
    """Return the views with the variance that residuals have beyond what is stated added to every point's.

    What prints and lenses leave is the same however sharp an image is: by the stated uncertainties alone few sharp
    images would decide against all others, and w would count residuals that are no noise of theirs. The variance is the
    one with which squared distances have the mean that they should have (R. C. Paule, J. Mandel, Journal of Research of
    the NBS 87 (1982) 377-385, doi:10.6028/jres.087.022), without points far off.
    """
    stated = views.standard_uncertainty_px**2
    squared = squared_distances(views, at) * stated
    near = ~_far(squared / stated)
    u2, r2 = stated[near], squared[near]

    def excess(misfit: float) -> float:
        return float(np.mean(r2 / (u2 + misfit))) - 2.0

    if excess(0.0) <= 0.0:
        return views
    from scipy.optimize import brentq  # takes a tenth of a second to load, and most images need none

    most = float(np.mean(r2))
    while excess(most) > 0.0:
        most *= 2.0
    return replace(views, standard_uncertainty_px=np.sqrt(stated + brentq(excess, 0.0, most)))


def _far(squared: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Return which points are about as far off as a robust fit rejects them, four times the median distance."""
    return squared > MAX_DISTANCE**2 * np.median(squared)


def _first_look(views: ViewStack, at: Placements, lens: Lens | None) -> LensEvidence | None:
    """Return the evidence to first order where it already says that Brown's model holds, else None."""
    squared = squared_distances(views, at)
    median = float(np.median(squared))
    smallest = (SMALLEST_NOISE_PX / float(views.uncertainty.mean())) ** 2
    if median <= 2.0 * smallest:
        return LensEvidence(0.0, 0.0, None)  # what is left are rounding errors
    near = squared < GROSS**2 * median
    scale = math.sqrt(float(np.mean(squared[near])) / 2.0)
    cost, gain = radial_gain(views, at, near, scale, lens)
    share = -math.log1p(-min(gain / cost, 0.999))
    if share > FIRST_LOOK_SHARE or float(np.mean(_far(squared))) > MAX_REJECTED:
        return None
    return LensEvidence(2.0 * int(near.sum()) * share, share, None)


def _angular(views: ViewStack, at: Placements | None, lens: Lens | None) -> BundleAdjustment | None:
    """Fit Kannala's and Brandt's model from Brown's fit, or from a grid of focal lengths where that leads nowhere."""
    if at is not None:
        camera = camera_from_array(at.parameters[0])
        assert isinstance(camera, Camera)
        start = nearest_camera(camera, "kannala_brandt", seen_radius(views, camera))
        fitted = fit_model(views, with_camera(at, start), lens)
        if fitted is not None and fitted.converged and fitted.kept.all():
            return fitted
    return fit_angular_from_grid(views, lens)


def _camera(fit: BundleAdjustment) -> AnyCamera:
    return camera_from_array(fit.at.placements.parameters[0])


@dataclass(frozen=True, slots=True)
class _Comparison:
    """The models' fits to the points that the angular one uses; `brown` is None where it cannot be fitted."""

    views: ViewStack
    used: Bool[np.ndarray, " n"]
    scale: float
    lens: Lens | None
    brown: tuple[CommonCamera, CommonCamera] | None
    angular: tuple[CommonCamera, CommonCamera]
    held_out: float | None

    @classmethod
    def of(
        cls, views: ViewStack, at: Placements | None, angular: BundleAdjustment, lens: Lens | None
    ) -> _Comparison:
        used = angular.used
        if at is not None:
            # Few points that Brown's fit leaves far off are gross errors, which the more flexible model follows
            # further; many are what it lacks.
            far = _far(squared_distances(views, at))
            used = used & ~far if float(np.mean(far)) <= MAX_REJECTED else used
        enough = views.sums(used.astype(np.float64)) >= MIN_POINTS
        rows, points = np.flatnonzero(enough), views.spread(enough)
        views, used = views.take(rows), used[points]
        scale = max(angular.scale, SMALLEST_NOISE_PX / float(views.uncertainty.mean()))

        def both(start: Placements) -> tuple[CommonCamera, CommonCamera]:
            plain = fit_common_camera(views, start, used, scale, lens)
            return plain, fit_common_camera(views, plain.placements, used, scale, lens, shape=True)

        of_angular = both(angular.at.placements.take(rows))
        of_brown = None if at is None else both(at.take(rows))
        held = None
        if of_brown is not None and len(rows) >= MIN_HELD_OUT_VIEWS:
            ours = held_out_rms(views, of_angular[0].placements, used, scale, lens)
            browns = held_out_rms(views, of_brown[0].placements, used, scale, lens)
            held = math.exp(float(np.mean(np.log(ours / browns))))
        return cls(views, used, scale, lens, of_brown, of_angular, held)

    def evidence(self) -> LensEvidence | None:
        """Return the lesser of the evidence without and with the board's shape."""
        if self.brown is None:
            return None
        count = 2 * int(self.used.sum())
        pairs = zip(self.brown, self.angular, strict=True)
        share = min(math.log(max(b.chi2, 1e-300) / max(a.chi2, 1e-300)) for b, a in pairs)
        return LensEvidence(count * share, share, self.held_out)

    def beyond_brown(self) -> bool:
        evidence = self.evidence()
        return evidence is None or evidence.beyond_brown or self._angle() > WIDE_ANGLE

    def allows_rational(self) -> bool:
        return len(self.views) >= MIN_RATIONAL_VIEWS and self._angle() < WIDE_ANGLE and self.beyond_brown()

    def _angle(self) -> float:
        """Return the angle from the axis of the outermost point, rad; a right angle where it has no direction."""
        normalised = undistort_any(self.views.points_px[self.used], self.angular[0].camera)
        radius = np.hypot(*normalised.T)
        return 0.5 * math.pi if np.isnan(radius).any() else math.atan(float(radius.max()))

    def rational(self) -> BundleAdjustment | None:
        """Fit the rational model from Brown's."""
        if self.brown is None:
            return None
        camera = self.brown[0].camera
        assert isinstance(camera, Camera)
        start = with_camera(self.brown[0].placements, nearest_camera(camera, "rational", 1.0))
        fitted = fit_model(self.views, start, self.lens)
        return fitted if fitted is not None and fitted.converged else None

    def prefers(self, rational: BundleAdjustment) -> bool:
        """Return whether held-out images prefer the rational model to the angular one."""
        rms = [
            held_out_rms(self.views, at, self.used, self.scale, self.lens)
            for at in (rational.at.placements, self.angular[0].placements)
        ]
        return float(np.mean(np.log(rms[0] / rms[1]))) < math.log(MAX_RATIONAL)
