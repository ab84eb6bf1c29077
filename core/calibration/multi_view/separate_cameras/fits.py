"""Each view of a focus group with a camera of its own.

Each image is fitted alone, with its own choice of points. Where the images of a pose use different points, their poses
differ by the systematic errors of those points (see `repeat_consistency`). Such images are fitted again with the points
that they have in common.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from core.calibration.fixed_principal_point import STEP_EMBEDDING, fit_fixed_centre, radial_prior
from core.calibration.multi_view.fitting import CONTRADICTION, Fitted, first_failure, lens_warning
from core.calibration.multi_view.linearisation import Linearised, linearise
from core.calibration.multi_view.repeat_consistency import find_repeats, inliers_of
from core.calibration.multi_view.separate_cameras.image_fit import ImageFit
from core.calibration.multi_view.separate_cameras.session_prior import (
    SessionPrior,
    fit_with_prior,
    refit_with_prior,
    session_priors,
)
from core.calibration.multi_view.view_stack import ViewStack, stack_states
from core.calibration.priors import LENS_PRIOR, Lens, view_prior
from core.calibration.residuals import View
from core.calibration.result import MAX_DETERMINED_UNCERTAINTY, focal_weakly_observable
from core.calibration.single_image import calibrate_points
from core.calibration.state import SMALLEST_NOISE_PX, centred, image_centre, retract, view_residuals
from core.errors import (
    ADVISED_TILT,
    Advisory,
    FocalNotObservable,
    FocalWeaklyObservable,
    GridposeError,
    NotConverged,
)
from core.geometry import AnyCamera, Camera
from core.numerics import Fit, Prior, fit
from core.targets import GridPoints

MAX_WITH_LENS = 2.0 * LENS_PRIOR
"""Largest median u(f)/f of a pose's images where a lens is stated; its prior alone leaves 5 %."""


def fit_each(
    views: ViewStack,
    labels: Int[np.ndarray, " m"],
    estimator: str,
    lens: Lens | None,
    intrinsics: Camera | None,
    failures: dict[int, GridposeError],
    lens_start: AnyCamera | None = None,
    *,
    weak: bool = False,
) -> Fitted:
    """Fit every view by itself, then again with what its pose's views have in common.

    With `per_image_session_prior` the lens of the other images is each view's prior (`session_prior`), of the model of
    `lens_start`, or Brown's. Images that `per_image` finds weak are answered, if `weak`, where no other is.

    Common are the points used and, over all views, the weight of the priors: with a weight of its own each, images of a
    pose would be pulled to the priors by different amounts, and that would be scatter.
    """
    alone: dict[int, ImageFit] = {}
    priors: dict[int, SessionPrior] = {}
    if estimator == "per_image_session_prior":
        priors = session_priors(views, labels, lens, lens_start, failures)
    for i in range(len(views)):
        try:
            if i in failures:
                continue
            if i in priors:
                alone[i] = fit_with_prior(views.view(i), priors[i])
            elif estimator == "per_image":
                alone[i] = _free(views.view(i), lens)
            else:
                alone[i] = _fixed_centre(views.view(i), lens, intrinsics)
        except GridposeError as failure:
            failures[i] = failure
    if estimator == "per_image":
        determined, weakly = dict(alone), dict(failures)
        _exclude_weak_poses(determined, labels, lens, weakly)
        if determined or not weak:
            alone = determined
            failures |= weakly
    if not alone:
        raise first_failure(failures)
    images, each = list(alone), list(alone.values())
    warnings = _contradictions(lens, [one.state for one in each], [one.contradicts_lens for one in each])
    if weak and estimator == "per_image":
        warnings += _weak_warnings(each)
    chosen, repeats = views.take(images), labels[images]
    states, factor = [one.state for one in each], float(np.median([one.prior_factor for one in each]))
    current = [one.used if one.prior_factor == factor else None for one in each]
    flat = usual_points(chosen, np.concatenate([one.used for one in each]), repeats)
    # Twice: residuals of one pose can be compared where they are of fits to the same points.
    for decide in (False, True):
        if decide:
            flat = shared_points(chosen, linearise(chosen, stack_states(states), flat), repeats)
        for k, (i, one) in enumerate(zip(images, each, strict=True)):
            counted = flat[chosen.part(k)]
            before = current[k]
            if i in failures or (before is not None and np.array_equal(before, counted)):
                continue
            try:
                if i in priors:
                    again = refit_with_prior(chosen.view(k), states[k], counted, priors[i], factor)
                    states[k] = _converged(again)
                else:
                    states[k] = refit(
                        chosen.view(k),
                        states[k],
                        counted,
                        centre_held=estimator == "per_image_fixed_pp",
                        lens=None if one.contradicts_lens else lens,
                        prior_factor=factor,
                    )
                current[k] = counted
            except NotConverged as failure:
                failures[i] = failure
    left = [k for k, i in enumerate(images) if i not in failures]
    if not left:
        raise first_failure(failures)
    flat = np.concatenate([flat[chosen.part(k)] for k in left])
    rest = chosen.take(left)
    return Fitted(
        estimator,
        [images[k] for k in left],
        rest,
        repeats[left],
        linearise(rest, stack_states([states[k] for k in left]), flat),
        flat,
        None,
        warnings,
        lens=None if np.mean([one.contradicts_lens for one in each]) > 0.5 else lens,
        prior_factor=factor,
        own_priors=_information([priors[images[k]] for k in left], [states[k] for k in left], factor)
        if priors
        else None,
    )


def _information(
    priors: Sequence[SessionPrior], states: Sequence[View], factor: float
) -> Float[np.ndarray, "k l l"]:
    """Return the priors' information on each view's camera and pose."""
    found = []
    for prior, state in zip(priors, states, strict=True):
        _, Q = prior.of_view(factor)(state)
        found.append(Q.T @ Q)
    return np.array(found)


def _exclude_weak_poses(
    alone: dict[int, ImageFit],
    labels: Int[np.ndarray, " m"],
    lens: Lens | None,
    failures: dict[int, GridposeError],
) -> None:
    """Move the images of poses whose single images determine the focal length weakly to `failures`.

    A weak image has a pose, but one that scatters by u(f) along the line of sight, which would be read as the robot's.
    Whole poses go, by the median of their images: images chosen one by one would be those of a short f, and scatter
    less than the pose's do.
    """
    for label in np.unique(labels):
        of_pose = np.flatnonzero(labels == label).tolist()
        answers = [alone[i] for i in of_pose if i in alone]
        unanswered = sum(isinstance(failures.get(i), FocalNotObservable) for i in of_pose)
        u = float(np.median([one.focal_uncertainty for one in answers] + [math.inf] * unanswered or [0.0]))
        with_lens = lens is not None and not all(one.contradicts_lens for one in answers)
        limit = MAX_WITH_LENS if with_lens else MAX_DETERMINED_UNCERTAINTY
        if u <= limit:
            continue
        for i in of_pose:
            if i in alone:
                own = 100.0 * alone.pop(i).focal_uncertainty
                failures[i] = FocalWeaklyObservable(
                    f"The image by itself leaves the focal length uncertain by {own:.1f} %; poses measured image by "
                    f"image need {100.0 * limit:g} % in half of their images."
                )


def _weak_warnings(each: Sequence[ImageFit]) -> tuple[Advisory, ...]:
    u = float(np.median([one.focal_uncertainty for one in each]))
    if u <= MAX_DETERMINED_UNCERTAINTY:
        return ()
    return (
        focal_weakly_observable(
            "The images by themselves leave",
            u,
            f"Use the estimator pooled, or tilt the target by {ADVISED_TILT}.",
        ),
    )


def _contradictions(
    lens: Lens | None, states: Sequence[View], contradicted: Sequence[bool]
) -> tuple[Advisory, ...]:
    if lens is None or not any(contradicted):
        return ()
    focals = [0.5 * float(v.parameters[:2].sum()) for v, c in zip(states, contradicted, strict=True) if c]
    share = f" of {len(focals)} of {len(states)} images"
    return (lens_warning(lens, float(np.median(focals)), share),)


def _free(points: GridPoints, lens: Lens | None) -> ImageFit:
    found = calibrate_points(points, lens=lens)
    rotation = found.T_camera_target[:3, :3]
    centroid = rotation @ centred(points)[1] + found.T_camera_target[:3, 3]
    return ImageFit(
        View(found.camera.as_array(), rotation, centroid),
        found.used,
        found.observability.focal_relative_uncertainty,
        found.inflation,
        any(w.code == "focal_prior_inconsistent" for w in found.warnings),
    )


def _fixed_centre(points: GridPoints, lens: Lens | None, intrinsics: Camera | None) -> ImageFit:
    centre = image_centre(points) if intrinsics is None else (intrinsics.cx_px, intrinsics.cy_px)
    result = fit_fixed_centre(points, centre, lens)
    focal = float(result.state.parameters[0])
    u = math.sqrt(max(float(result.covariance[0, 0]), 0.0)) / focal
    if u > MAX_DETERMINED_UNCERTAINTY:
        raise FocalNotObservable(
            f"The focal length is uncertain by {100.0 * u:.1f} % in this view; the limit is "
            f"{100.0 * MAX_DETERMINED_UNCERTAINTY:g} %."
        )
    against = lens is not None and abs(math.log(lens.focal_px / focal)) > CONTRADICTION * math.hypot(
        LENS_PRIOR, u
    )
    return ImageFit(result.state, result.used, u, 1.0, against)


def shared_points(views: ViewStack, at: Linearised, labels: Int[np.ndarray, " m"]) -> Bool[np.ndarray, " n"]:
    """Return which points count, decided for all views of a label together."""
    everyone = np.ones(len(views), dtype=np.bool_)
    return inliers_of(views, find_repeats(views, labels), at.residuals, everyone)


def usual_points(
    views: ViewStack, used: Bool[np.ndarray, " n"], labels: Int[np.ndarray, " m"]
) -> Bool[np.ndarray, " n"]:
    """Return `used` as most images of a label have it, for each grid point."""
    usual = np.empty(len(used), dtype=np.bool_)
    for pose in find_repeats(views, labels):
        at = np.concatenate([np.arange(views.first[i], views.first[i + 1]) for i in pose])
        cell = views.cell[at]
        usual[at] = (2.0 * np.bincount(cell, used[at]) >= np.bincount(cell))[cell]
    return usual


def refit(
    points: GridPoints,
    start: View,
    used: Bool[np.ndarray, " n"],
    *,
    centre_held: bool,
    lens: Lens | None,
    prior_factor: float,
) -> View:
    """Fit one image plainly with the points `used`; everything free, or f, k1, k2 and the pose alone.

    `prior_factor` is the weight of the priors of a free fit.

    Raises NotConverged.
    """
    step = STEP_EMBEDDING if centre_held else np.eye(14)
    of_view = view_residuals(points, free=True)
    prior: Prior[View] = radial_prior if centre_held else view_prior(points, lens, prior_factor)

    def evaluate(view: View) -> tuple[Float[np.ndarray, "2 n"], Float[np.ndarray, "p 2 n"]]:
        residuals, jacobian = of_view(view)
        return residuals, np.tensordot(step.T, jacobian, axes=1)

    found = fit(
        evaluate,
        lambda view, by: retract(view, step @ by),
        start,
        points.standard_uncertainty_px,
        prior=prior,
        smallest_scale=SMALLEST_NOISE_PX,
        used=used,
    )
    return _converged(found)


def _converged(found: Fit[View]) -> View:
    if not found.converged:
        raise NotConverged(
            "The grid points that this image shares with the others of its pose do not determine it.",
            "Look at its overlay: reflections, dirt or something in front of the grid are the usual causes.",
        )
    return found.state
