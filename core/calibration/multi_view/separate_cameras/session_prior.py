"""One image with the lens of the session's other images as its prior, its focal length its own.

The images are dealt into folds, all of one pose into the same. The camera that the other folds' images determine
together, with its covariance Σ (grown by the disagreement of the poses, `correlated_residuals`), is the prior of each
image of a fold:

    Σ' = Σ + diag((0.6)², 0, s², s², 0, ...),   s = 0.3 % of the image's longer side,

over log √(fx fy), log(fx/fy), cx, cy and the distortion: the focal length is free but for what is known of any lens,
and lenses that refocus move their principal point by about s. So an image keeps its own focal length, and what no
single image determines, distortion and principal point, is the session's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from core.calibration.multi_view.covariance import multi_view_covariance
from core.calibration.multi_view.fitting import fit_pooled
from core.calibration.multi_view.separate_cameras.image_fit import ImageFit
from core.calibration.multi_view.view_stack import ViewStack, coordinates, evenly
from core.calibration.planar_ambiguity import is_nearer_to_first, needed_evidence
from core.calibration.priors import FOCAL_PRIOR, LENS_PRIOR, Lens
from core.calibration.residuals import View
from core.calibration.result import MAX_FOCAL_UNCERTAINTY
from core.calibration.single_image import ITERATIONS, MIN_REFIT_INFLATION, other_minimum, smallest_scale
from core.calibration.state import bounded_logarithm, centred, pose_from_undistorted_points, residuals_over
from core.calibration.summary import MAX_RESIDUAL, FitSummary, grid_step_px, summarise_fit
from core.calibration.uncertainty import reprojection
from core.calibration.validity import check_points
from core.errors import ADVISED_TILT, DegenerateGeometry, FocalNotObservable, GridposeError, NotConverged
from core.geometry import AnyCamera, camera_from_array, so3_exp
from core.numerics import Fit, Prior, fit
from core.targets import GridPoints

MAX_FOLDS = 20
MAX_VIEWS = 30
"""Of the other folds, evenly chosen: more images make the prior narrower by less than what they have in common."""
REFOCUS_SHIFT = 0.003  # of the image's longer side, of the principal point
MIN_POINTS = 6


@dataclass(frozen=True, slots=True)
class SessionPrior:
    """The lens that other images determine: its parameters, and W with W Σ' Wᵀ = 1 over the coordinates above."""

    camera: AnyCamera
    root: Float[np.ndarray, "c c"]

    def of_camera(
        self, parameters: Float[np.ndarray, " s"]
    ) -> tuple[Float[np.ndarray, " c"], Float[np.ndarray, "c c"]]:
        """Return residuals in their σ, and the derivatives of the state's side by the free camera parameters."""
        free = len(self.root)
        off = _coordinates(self.camera.as_array()[:free]) - _coordinates(parameters[:free])
        return self.root @ off, self.root @ np.linalg.inv(coordinates(parameters))

    def of_view(self, factor: float) -> Prior[View]:
        """Return the prior over the step of one view, its residuals times `factor` (`state.view_prior`)."""
        free = len(self.root)

        def prior(view: View) -> tuple[Float[np.ndarray, " c"], Float[np.ndarray, "c p"]]:
            q, Q = self.of_camera(view.parameters)
            return factor * q, np.hstack([factor * Q, np.zeros((free, 6))])

        return prior


def session_priors(
    views: ViewStack,
    labels: Int[np.ndarray, " m"],
    lens: Lens | None,
    start: AnyCamera | None,
    failures: dict[int, GridposeError],
) -> dict[int, SessionPrior]:
    """Return each view's prior; views whose others determine no camera are in `failures`.

    `labels` number the poses, `lens` is the stated one, `start` a camera of the lens model that the session takes; None
    is Brown's.
    """
    places = np.unique(labels, return_inverse=True)[1]
    if places.max(initial=0) == 0:
        places = np.arange(len(views))  # of one pose alone, the other images are what there is
    folds = places % MAX_FOLDS
    priors: dict[int, SessionPrior] = {}
    for fold in range(int(folds.max(initial=0)) + 1):
        members = np.flatnonzero(folds == fold).tolist()
        others = evenly(np.flatnonzero(folds != fold).tolist(), MAX_VIEWS)
        try:
            prior = _determined_by(views, labels, others, lens, start)
        except GridposeError as failure:
            failures |= dict.fromkeys(members, failure)
            continue
        priors |= dict.fromkeys(members, prior)
    return priors


def _determined_by(
    views: ViewStack,
    labels: Int[np.ndarray, " m"],
    others: list[int],
    lens: Lens | None,
    start: AnyCamera | None,
) -> SessionPrior:
    if not others:
        raise FocalNotObservable(
            "The session has no other image that determines the lens.",
            f"Add images of the target at other poses, tilted by {ADVISED_TILT}; or use estimator=per_image.",
        )
    fitted = fit_pooled(views.take(others), labels[others], "pooled", lens, {}, start, weak=True)
    parameters = fitted.at.placements.parameters[0]
    change = np.linalg.inv(coordinates(parameters))
    free = len(change)
    covariance = change @ multi_view_covariance(fitted).camera_covariance[:free, :free] @ change.T
    longer = max(views.image_width_px, views.image_height_px)
    covariance[0, 0] += (FOCAL_PRIOR[1] if fitted.lens is None else LENS_PRIOR) ** 2
    covariance[[2, 3], [2, 3]] += (REFOCUS_SHIFT * longer) ** 2
    return SessionPrior(camera_from_array(parameters), _inverse_root(covariance))


def fit_with_prior(points: GridPoints, prior: SessionPrior) -> ImageFit:
    """Fit one image's focal length and pose, and the session's lens within its prior, by two passes (`single_image`).

    Raises DegenerateGeometry for too few points, FocalNotObservable where u(f)/f exceeds `MAX_FOCAL_UNCERTAINTY`,
    NotConverged where the session's lens does not explain the points.
    """
    check_points(points)
    if len(points) < MIN_POINTS:
        raise DegenerateGeometry(
            f"Focal length and pose need at least {MIN_POINTS} grid points, {len(points)} were found."
        )
    summary = _fit_twice(points, prior, pose_from_undistorted_points(prior.camera, points))
    other = other_minimum(points, summary)
    if other is not None and other.evidence < needed_evidence(summary.fit.degrees_of_freedom):
        again = _fit_twice(points, prior, other.view)
        if (
            again.fit.converged
            and not is_nearer_to_first(again.fit.state, summary.fit.state, other.view)
            and _cost(again, prior, summary) < _cost(summary, prior, summary)
        ):
            summary = again
    _check(points, summary)
    return ImageFit(
        summary.fit.state,
        summary.fit.used,
        summary.focal_relative_uncertainty,
        summary.inflation,
        contradicts_lens=False,
    )


def refit_with_prior(
    points: GridPoints, start: View, used: np.ndarray, prior: SessionPrior, factor: float
) -> Fit[View]:
    """Fit again plainly with the points `used`, and the priors weighed by `factor`."""
    return fit(
        residuals_over(points, len(prior.root)),
        retract_any,
        start,
        points.standard_uncertainty_px,
        prior=prior.of_view(factor),
        smallest_scale=smallest_scale(points, len(prior.root) + 6),
        iteration_limit=ITERATIONS,
        used=used,
    )


def _fit_twice(points: GridPoints, prior: SessionPrior, start: View) -> FitSummary:
    free = len(prior.root)
    scale, indices = smallest_scale(points, free + 6), np.arange(free + 6)
    first = fit(
        residuals_over(points, free),
        retract_any,
        start,
        points.standard_uncertainty_px,
        prior=prior.of_view(1.0),
        smallest_scale=scale,
        iteration_limit=ITERATIONS,
    )
    summary = summarise_fit(points, "nominal", first, indices, scale)
    if not first.converged or summary.inflation < MIN_REFIT_INFLATION:
        return summary
    again = refit_with_prior(points, first.state, first.used, prior, summary.inflation)
    second = summarise_fit(points, "nominal", again, indices, scale)
    return FitSummary("nominal", again, indices, summary.inflation, second.neighbour_correlation)


def _cost(of: FitSummary, prior: SessionPrior, by: FitSummary) -> float:
    """Return the cost of a fit, at the points, noise and inflation of another."""
    q, _ = prior.of_view(by.inflation)(of.fit.state)
    return float(np.sum(of.fit.residuals[:, by.fit.used] ** 2)) / by.fit.scale**2 + float(q @ q)


def _check(points: GridPoints, summary: FitSummary) -> None:
    result, (target, _) = summary.fit, centred(points)
    u = summary.focal_relative_uncertainty
    if not u <= MAX_FOCAL_UNCERTAINTY:
        raise FocalNotObservable(
            f"With the session's lens the focal length of this view is uncertain by {100.0 * u:.1f} %; the limit is "
            f"{100.0 * MAX_FOCAL_UNCERTAINTY:.0f} %."
        )
    if not result.converged:
        raise NotConverged(f"The fit did not converge within {result.iterations} iterations.")
    if np.any(target @ result.state.rotation[2] + result.state.translation_mm[2] <= 0.0):
        raise DegenerateGeometry("The best fit puts grid points behind the camera.")
    statistics = reprojection(np.ascontiguousarray(result.residuals.T), result.used)
    if statistics.rms_px > MAX_RESIDUAL * grid_step_px(points, target):
        raise NotConverged(
            f"With the session's lens the best fit leaves residuals of {statistics.rms_px:.1f} px.",
            "An image taken with another lens needs a focus_group of its own.",
        )


def retract_any(view: View, step: Float[np.ndarray, " p"]) -> View:
    """Move a view of any lens model as `state.retract` does; the distortion, which its prior holds, does not follow."""
    free = len(step) - 6
    parameters = view.parameters.copy()
    scales = np.array([math.exp(bounded_logarithm(step[i] / parameters[i])) for i in range(2)])
    depth = view.translation_mm[2]
    new_depth = depth * math.exp(bounded_logarithm(step[-1] / depth))
    # The centroid's image f·x/z keeps its first-order motion, however far f and depth go.
    tangent = view.translation_mm[:2] / depth
    image = parameters[:2] * (tangent + (step[-3:-1] - tangent * step[-1]) / depth) + step[:2] * tangent
    ratio = bounded_logarithm(0.5 * float(np.sum(step[:2] / parameters[:2])))
    parameters[:2] *= scales
    parameters[2:free] += step[2:free]
    growth = math.expm1(ratio) / ratio if abs(ratio) > 1e-8 else 1.0
    translation = np.append(image / parameters[:2] * new_depth, new_depth)
    return View(parameters, so3_exp(growth * step[free : free + 3]) @ view.rotation, translation)


def _coordinates(parameters: Float[np.ndarray, " c"]) -> Float[np.ndarray, " c"]:
    fx, fy = parameters[:2].tolist()
    return np.concatenate([[0.5 * math.log(fx * fy), math.log(fx / fy)], parameters[2:]])


def _inverse_root(covariance: Float[np.ndarray, "c c"]) -> Float[np.ndarray, "c c"]:
    """Return W with W Σ Wᵀ = 1, by the correlations: pixels and coefficients differ by many powers of ten."""
    unit = np.sqrt(np.diag(covariance))
    lower = np.linalg.cholesky(covariance / np.outer(unit, unit) + 1e-9 * np.eye(len(unit)))
    return np.asarray(np.linalg.inv(lower) / unit)
