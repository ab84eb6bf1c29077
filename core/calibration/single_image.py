"""Calibration from one image: initialisation, MAP refinement, refusal, and covariance.

One planar view separates focal length and principal point from depth only through tilt and distortion, so weak priors
(what lenses are like) regularise the fit. The predicted u(f)/f grades the answer, and beyond a bound the view is
refused (`result.grade`): its residual would be as small as ever while its pose may be anywhere.

The fit has two passes. Residuals that resemble their neighbours' say that the data are worth less than independent
noise would be, by an inflation of their uncertainties (`uncertainty.correlation_inflation`). It belongs to the data,
not to the priors: the fit is repeated with all prior residuals multiplied by it, and then the covariance is inflated.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from jaxtyping import Float

from core.calibration import closed_form
from core.calibration.planar_ambiguity import (
    SecondPose,
    better_start,
    is_nearer_to_first,
    needed_evidence,
    second_of_two_fits,
    second_pose,
)
from core.calibration.priors import LENS_PRIOR, Lens, view_prior
from core.calibration.residuals import View
from core.calibration.result import MAX_DETERMINED_UNCERTAINTY, MAX_FOCAL_UNCERTAINTY, Calibration
from core.calibration.state import (
    FREE,
    POSE,
    SMALLEST_NOISE_PX,
    centred,
    image_centre,
    pose_from_undistorted_points,
    retract,
    retract_pose,
    view_of,
    view_residuals,
)
from core.calibration.summary import FitSummary, calibration_of, relative_focal_uncertainty, summarise_fit
from core.calibration.validity import check_camera, check_lens, check_points
from core.errors import DegenerateGeometry, GridposeError
from core.geometry import Camera, estimate_homography
from core.numerics import Fit, Prior, fit
from core.targets import GridPoints

START_FACTORS = (0.6, 1.0, 1.8)  # of the image width, where no closed form is plausible
PLAUSIBLE_START = (0.3, 10.0)
ITERATIONS, TRIAL_ITERATIONS = 300, 10
MAX_START_UNCERTAINTY = 3.0 * MAX_FOCAL_UNCERTAINTY  # no valley brings more down to what is answered
MIN_REFIT_INFLATION = 1.05  # below it a second pass moves the estimate by far less than its uncertainty
SUBSET = 500  # points enough to choose a start by
MIN_REDUNDANCY = 30  # with fewer beyond the parameters, residuals alone do not determine the noise


def calibrate_points(
    points: GridPoints, *, lens: Lens | None = None, intrinsics: Camera | None = None
) -> Calibration:
    """Estimate camera and pose from the grid points of one image.

    With `intrinsics` given only the pose is estimated (estimator "given") and they are taken as exact; else
    all is (estimator "per_image"). A stated `lens` is a 5 % prior on the focal length, unless the image by itself
    determines it and contradicts the lens; then the lens is ignored, with a warning.

    Raises InvalidArgument for arguments no camera has, DegenerateGeometry for too few or collinear points,
    NotConverged where no camera explains them, and FocalNotObservable where the predicted u(f)/f exceeds
    `MAX_FOCAL_UNCERTAINTY`; each carries the points.
    """
    try:
        check_points(points)
        located = dataclasses.replace(points, measured_points_target=points.points_target)  # computed once
        if intrinsics is not None:
            return calibration_of(
                points, _fit_with_known_camera(located, intrinsics), max_focal_uncertainty=math.inf
            )
        free = _fit_free(located, None)
        if lens is None:
            return calibration_of(
                points, _with_other(located, free, None), max_focal_uncertainty=MAX_FOCAL_UNCERTAINTY
            )
        check_lens(lens, points)
        u = free.focal_relative_uncertainty
        distance = abs(math.log(lens.focal_px / free.focal_px))
        if free.fit.converged and distance > 3.0 * math.hypot(LENS_PRIOR, u):
            return calibration_of(
                points,
                _with_other(located, free, None),
                max_focal_uncertainty=MAX_FOCAL_UNCERTAINTY,
                contradicted=lens,
            )
        summary = _with_other(located, _fit_free(located, lens), lens)
        return calibration_of(points, summary, max_focal_uncertainty=MAX_FOCAL_UNCERTAINTY, lens=lens)
    except GridposeError as failure:
        failure.points = points
        raise
    except (np.linalg.LinAlgError, ArithmeticError) as error:
        # The checks above leave only inputs without meaning to come here.
        raise DegenerateGeometry(
            "The grid points found do not determine the camera and its pose.", points=points
        ) from error


def closed_form_start(H: Float[np.ndarray, "3 3"], points: GridPoints) -> closed_form.ClosedForm | None:
    """Return closed form B1, or None where the view gives none or an absurd focal length."""
    try:
        start = closed_form.from_homography(H, points, image_centre(points), single_focal=True)
    except DegenerateGeometry:
        return None  # no failure: a near fronto-parallel view has no closed form
    low, high = (factor * points.image_width_px for factor in PLAUSIBLE_START)
    return start if low < start.camera.fx_px < high else None


def candidate_focals(points: GridPoints, lens: Lens | None) -> list[float]:
    """Focal lengths to start from where no view gives one: the lens's own, else wide, normal and long."""
    return (
        [lens.focal_px] if lens is not None else [factor * points.image_width_px for factor in START_FACTORS]
    )


def _starts(points: GridPoints, lens: Lens | None) -> list[tuple[str, View]]:
    """Closed form B1 where plausible; otherwise, and also where a lens is stated, assumed focal lengths."""
    H = estimate_homography(points.points_target[:, :2], points.points_px)
    plausible, centre = closed_form_start(H, points), image_centre(points)
    named = [("vanishing_point", plausible)] if plausible is not None else []
    if plausible is None or lens is not None:
        named += [
            ("nominal", closed_form.nominal(H, points, Camera(f, f, *centre)))
            for f in candidate_focals(points, lens)
        ]
    return [(name, view_of(start, points)) for name, start in named]


def _fit_free(points: GridPoints, lens: Lens | None) -> FitSummary:
    """Refine every start and keep the one of least cost; of large grids the start is chosen on a part."""
    if len(points) < 8:
        raise DegenerateGeometry(f"Camera and pose need at least 8 grid points, {len(points)} were found.")
    starts = _starts(points, lens)
    if len(points) > 2 * SUBSET:
        part = _part(points, SUBSET)
        # A part has a centroid of its own, to which a view's translation refers.
        starts = [(name, _recentred(view, points, part)) for name, view in starts]
        name, chosen = _best_fit(part, lens, starts)
        starts = [(name, _recentred(chosen.state, part, points))]
    return _fit_twice(points, lens, starts)


def _fit_twice(points: GridPoints, lens: Lens | None, starts: list[tuple[str, View]]) -> FitSummary:
    """Fit, take the inflation that the residuals call for, and fit again with it in the priors' weight."""
    name, first = _best_fit(points, lens, starts)
    scale = smallest_scale(points, len(FREE))
    summary = summarise_fit(points, name, first, FREE, scale)
    if not first.converged or summary.inflation < MIN_REFIT_INFLATION:
        return summary
    again = fit(
        view_residuals(points, free=True),
        retract,
        first.state,
        points.standard_uncertainty_px,
        prior=view_prior(points, lens, summary.inflation),
        smallest_scale=scale,
        iteration_limit=ITERATIONS,
        used=first.used,
    )
    return dataclasses.replace(summarise_fit(points, name, again, FREE, scale), inflation=summary.inflation)


def _best_fit(points: GridPoints, lens: Lens | None, starts: list[tuple[str, View]]) -> tuple[str, Fit[View]]:
    """Refine every start a little, and the one of least cost to the end."""
    evaluate, prior = view_residuals(points, free=True), view_prior(points, lens)
    scale, uncertainty = smallest_scale(points, len(FREE)), points.standard_uncertainty_px

    def refined(start: View, iterations: int) -> Fit[View]:
        return fit(
            evaluate,
            retract,
            start,
            uncertainty,
            prior=prior,
            smallest_scale=scale,
            iteration_limit=iterations,
        )

    if len(starts) == 1:
        name, start = starts[0]
        return name, refined(start, ITERATIONS)
    tried = [(name, refined(start, TRIAL_ITERATIONS)) for name, start in starts]
    name, best = min(tried, key=lambda item: _rank(item[1], points, prior))
    hopeless = relative_focal_uncertainty(best) > MAX_START_UNCERTAINTY
    return name, best if best.converged or hopeless else refined(best.state, ITERATIONS)


def _rank(result: Fit[View], points: GridPoints, prior: Prior[View]) -> tuple[bool, bool, float]:
    """The smaller the better; costs equal to within a thousandth are the same minimum, and the first start's."""
    return result.status == "singular", not result.converged, round(_total(result, points, prior), 3)


def smallest_scale(points: GridPoints, parameters: int) -> float:
    """The least noise assumed, px: the detector's own figure where residuals are too few to estimate it."""
    if 2 * len(points) - parameters < MIN_REDUNDANCY:
        return max(SMALLEST_NOISE_PX, float(np.mean(points.standard_uncertainty_px)))
    return SMALLEST_NOISE_PX


def _part(points: GridPoints, count: int) -> GridPoints:
    """Return `count` of the grid points, scattered without pattern (a regular step may fall on a single column) and
    the same ones every time.
    """
    return points.take(np.sort(np.random.default_rng(0).permutation(len(points))[:count]))


def _recentred(view: View, of: GridPoints, to: GridPoints) -> View:
    """Return the same view with its translation at the centroid of other points of the grid."""
    shift = centred(to)[1] - centred(of)[1]
    return dataclasses.replace(view, translation_mm=view.translation_mm + view.rotation @ shift)


def _total(result: Fit[View], points: GridPoints, prior: Prior[View]) -> float:
    """Twice the negative log posterior, comparable between fits of the same points with different σ and rejections:
    a fit that leaves points out pays for each as much as it saves.
    """
    distance = np.sqrt(np.sum(result.residuals**2, axis=0))
    scale = max(result.scale, SMALLEST_NOISE_PX)
    data = 4.0 * len(points) * math.log(scale) + float(np.sum(np.minimum((distance / scale) ** 2, 32.0)))
    q, _ = prior(result.state)
    return data + float(q @ q)


def _fit_with_known_camera(points: GridPoints, camera: Camera) -> FitSummary:
    if len(points) < 5:
        raise DegenerateGeometry(f"A pose needs at least 5 grid points, {len(points)} were found.")
    check_camera(camera, points)
    start = pose_from_undistorted_points(camera, points)
    summary = _fit_pose(points, start)
    if not summary.fit.converged:
        summary = _fit_pose(points, better_start(points, summary.fit.state))
    other = other_minimum(points, summary)
    if other is not None and other.cost < other.first_cost:
        summary = _fit_pose(points, other.view)
        other = other_minimum(points, summary)
    return dataclasses.replace(summary, other=other)


def _fit_pose(points: GridPoints, start: View) -> FitSummary:
    scale = smallest_scale(points, len(POSE))
    result = fit(
        view_residuals(points, free=False),
        retract_pose,
        start,
        points.standard_uncertainty_px,
        smallest_scale=scale,
    )
    return summarise_fit(points, "nominal", result, POSE, scale)


def other_minimum(points: GridPoints, summary: FitSummary) -> SecondPose | None:
    """Return the pose of the opposite tilt before the same camera, if it is a minimum of its own."""
    result, uncertainty = summary.fit, points.standard_uncertainty_px
    if not result.converged:
        return None
    cost = float(np.sum((result.residuals[:, result.used] / uncertainty[result.used]) ** 2))
    variance = (summary.inflation * result.scale / float(np.mean(uncertainty))) ** 2
    return second_pose(points, result.state, result.used, cost, variance)


def _with_other(points: GridPoints, summary: FitSummary, lens: Lens | None) -> FitSummary:
    """Return the better of a free fit's two minima, with the other.

    If the image by itself determines the focal length, its perspective rules the other pose out. If a stated lens
    determines it, camera and pose together may follow the wrong tilt: then the fit is repeated from the other tilt, and
    the two are compared with all priors.
    """
    other = other_minimum(points, summary)
    if other is None:
        return summary
    needed = needed_evidence(summary.fit.degrees_of_freedom)
    if summary.focal_relative_uncertainty <= MAX_DETERMINED_UNCERTAINTY and other.evidence >= needed:
        return dataclasses.replace(summary, other=other)
    again = _fit_twice(points, lens, [(summary.start, other.view)])
    if not again.fit.converged or is_nearer_to_first(again.fit.state, summary.fit.state, other.view):
        return dataclasses.replace(summary, other=other)
    prior = view_prior(points, lens, summary.inflation)
    better, worse = sorted((summary, again), key=lambda one: _total(one.fit, points, prior))
    return dataclasses.replace(
        better, other=second_of_two_fits(points, better.fit, worse.fit, lens, better.inflation)
    )
