"""Lens models fitted to the same points, and what speaks for one or another.

Of Brown's model and Kannala's and Brandt's, with N coordinates and the sums of squares χ²,

    w = N ln(χ²_Brown / χ²_KB)

is -2 log of the ratio of likelihoods, the noise's variance profiled out. Under Brown's model and independent noise it
is at most that of two further parameters, χ² with two degrees of freedom: w > 30 has a probability of 3e-7. Real prints
and lenses leave more than noise, so that a share is asked for too, w/N > 3 %, and both must hold with and without
sixteen departures of the board's shape as common parameters: a bent print imitates a lens.

Then the model has to explain images that it was not fitted to: with the images dealt into folds in their order, and the
camera fitted to the others, the pose alone is fitted to each image held out. The geometric mean over images of the
ratio of residual rms has to be below `MAX_HELD_OUT`. The mean of logarithms keeps one image of the edge from deciding.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from core.calibration.lens_selection.common_fit import (
    CommonCamera,
    fit_common_camera,
    held_out_rms,
    squared_distances,
)
from core.calibration.lens_selection.starts import fit_model, nearest_camera, with_camera
from core.calibration.multi_view import BundleAdjustment, Placements, ViewStack
from core.calibration.priors import Lens
from core.calibration.state import SMALLEST_NOISE_PX
from core.geometry import Camera, undistort_any

MIN_STATISTIC, MIN_SHARE = 30.0, 0.03
MAX_DISTANCE, MAX_REJECTED = 4.0, 0.01
"""Times the median distance, and the share of points beyond it, after the fit of Brown's model: up to it they are gross
errors, more of them are what the model lacks.
"""
MAX_HELD_OUT, MAX_RATIONAL = 0.95, 0.98
"""Ratios of held-out residuals, to Brown's and to Kannala's and Brandt's: a model with more has gained nothing."""
MIN_HELD_OUT_VIEWS, MIN_RATIONAL_VIEWS = 4, 7
WIDE_ANGLE = math.radians(75.0)
"""From the axis: further out the tangent of the angle, which Brown's model is made of, is no measure."""
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
class Comparison:
    """The lens models' fits to the points that the angular one uses; `brown` is None where it cannot be fitted."""

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
    ) -> Comparison:
        used = angular.used
        if at is not None:
            # Few points that Brown's fit leaves far off are gross errors, which the more flexible model follows
            # further; many are what it lacks.
            far = far_off(squared_distances(views, at))
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


def far_off(squared: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Return which points are about as far off as a robust fit rejects them, four times the median distance."""
    return squared > MAX_DISTANCE**2 * np.median(squared)
