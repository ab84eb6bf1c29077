"""One image: starts, MAP refinement, the refusal, and the doubt of what is left.

One planar view separates focal length and principal point from depth only through tilt and distortion, so
weak priors (METHOD: what lenses are like) regularise the fit, and a view whose predicted u(f)/f still exceeds
2 % is refused: its residual would be as small as ever while its pose is millimetres off.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float, Int

from core.calibration import closed_form
from core.calibration.homography import estimate_homography
from core.calibration.model import (
    FREE,
    LENS_PRIOR,
    POSE,
    PRINCIPAL_POINT_PRIOR,
    RADIAL_PRIORS,
    SMALLEST_NOISE_PX,
    TANGENTIAL_PRIOR,
    Lens,
    View,
    centred,
    image_centre,
    retract,
    retract_pose,
    view_of,
    view_prior,
    view_residuals,
)
from core.calibration.result import Calibration, Observability
from core.calibration.uncertainty import camera_pose, correlation_inflation, remarks, reprojection
from core.camera import CAMERA_PARAMETERS, Camera, undistort_points
from core.errors import Advisory, DegenerateGeometry, FocalNotObservable, NotConverged
from core.least_squares import Fit, Prior, fit
from core.targets.specification import GridPoints
from core.transforms import hat, transform

FOCAL_GATE = 0.02
"""Largest predicted u(f)/f that is reported as a measurement."""
UNTRUSTED = 10.0  # times the median uncertainty
START_FACTORS = (0.6, 1.0, 1.8)  # of the image width, where no closed form is plausible
PLAUSIBLE_START = (0.3, 10.0)
RIVAL_COST = 9.0  # three sigmas: a fit whose cost is within this of the best explains the points as well


def calibrate_points(
    points: GridPoints, *, lens: Lens | None = None, intrinsics: Camera | None = None
) -> Calibration:
    """Estimate camera and pose from the grid points of one image.

    With `intrinsics` given only the pose is estimated (estimator "given") and they are taken as exact; else
    all is (estimator "per_image"), with a 5 % prior on the focal length if `lens` is given.

    Raises DegenerateGeometry for too few or collinear points, NotConverged, and FocalNotObservable where the
    predicted u(f)/f exceeds 2 % and no lens is stated; each carries the points.
    """
    try:
        if intrinsics is not None:
            rivals: list[float] = []
            start, view_fit = "nominal", _fit_pose(points, intrinsics)
            indices, gate = POSE, math.inf
        else:
            start, view_fit, rivals = _fit_all(points, lens)
            indices, gate = FREE, FOCAL_GATE if lens is None else math.inf
        return _conclude(points, start, view_fit, rivals, indices, gate, lens)
    except (DegenerateGeometry, NotConverged, FocalNotObservable) as failure:
        failure.points = points
        raise


def plausible_focal(H: Float[np.ndarray, "3 3"], points: GridPoints) -> float | None:
    """Return the focal length of closed form B1, px, or None where the view gives none or an absurd one."""
    try:
        focal = closed_form.from_homography(H, points, image_centre(points), single_focal=True).camera.fx_px
    except DegenerateGeometry:
        return None  # no failure: a near fronto-parallel view has no closed form
    low, high = (factor * points.image_width_px for factor in PLAUSIBLE_START)
    return focal if low < focal < high else None


def assumed_focals(points: GridPoints, lens: Lens | None) -> list[float]:
    """Focal lengths to start from where no view gives one: the lens's own, else wide, normal and long."""
    return (
        [lens.focal_px] if lens is not None else [factor * points.image_width_px for factor in START_FACTORS]
    )


def _starts(points: GridPoints, lens: Lens | None) -> list[tuple[str, closed_form.ClosedForm]]:
    """Closed form B1 where plausible; otherwise, and beside it where a lens is stated, assumed focal lengths."""
    H = estimate_homography(points.points_target[:, :2], points.points_px)
    focal, centre = plausible_focal(H, points), image_centre(points)
    named = [("vanishing_point", focal)] if focal is not None else []
    if focal is None or lens is not None:
        named += [("nominal", assumed) for assumed in assumed_focals(points, lens)]
    return [(name, closed_form.nominal(H, points, Camera(f, f, *centre))) for name, f in named]


def _fit_all(points: GridPoints, lens: Lens | None) -> tuple[str, Fit[View], list[float]]:
    """Refine every start; return the name and fit of least cost, and the focal lengths (px) of its rivals: fits from
    other starts that explain the points as well.
    """
    if len(points) < 8:
        raise DegenerateGeometry(f"Camera and pose need at least 8 grid points, {len(points)} were found.")
    evaluate, prior = view_residuals(points, free=True), view_prior(points, lens)
    fits = [
        (
            name,
            fit(
                evaluate,
                retract,
                view_of(start, points),
                points.standard_uncertainty_px,
                prior=prior,
                smallest_scale=SMALLEST_NOISE_PX,
            ),
        )
        for name, start in _starts(points, lens)
    ]
    ranked = sorted(fits, key=lambda item: (not item[1].converged, _total(item[1], points, prior)))
    name, best = ranked[0]
    near = _total(best, points, prior) + RIVAL_COST
    rivals = [f for _, f in ranked[1:] if f.converged and _total(f, points, prior) < near]
    return name, best, [0.5 * (f.state.camera.fx_px + f.state.camera.fy_px) for f in rivals]


def _total(result: Fit[View], points: GridPoints, prior: Prior[View]) -> float:
    """Twice the negative log posterior, comparable between fits of the same points with different σ and rejections:
    a fit that leaves points out pays for each as much as it saves.
    """
    distance = np.sqrt(np.sum(result.residuals**2, axis=0))
    scale = max(result.scale, SMALLEST_NOISE_PX)
    data = 4.0 * len(points) * math.log(scale) + float(np.sum(np.minimum((distance / scale) ** 2, 32.0)))
    q, _ = prior(result.state)
    return data + float(q @ q)


def _fit_pose(points: GridPoints, camera: Camera) -> Fit[View]:
    if len(points) < 5:
        raise DegenerateGeometry(f"A pose needs at least 5 grid points, {len(points)} were found.")
    # The homography of undistorted points, so that a strong lens does not spoil the start.
    normalised = undistort_points(points.points_px, camera)
    H = camera.matrix @ estimate_homography(points.points_target[:, :2], normalised)
    start = closed_form.nominal(H, points, camera)
    return fit(
        view_residuals(points, free=False),
        retract_pose,
        view_of(start, points),
        points.standard_uncertainty_px,
    )


def _conclude(
    points: GridPoints,
    start: str,
    result: Fit[View],
    rivals: list[float],
    indices: Int[np.ndarray, " p"],
    gate: float,
    lens: Lens | None,
) -> Calibration:
    """Turn a fit into a Calibration, or refuse it."""
    if result.status == "singular":
        raise DegenerateGeometry("The grid points found do not determine the camera and its pose.")
    view = result.state
    target, centroid = centred(points)
    depth = target @ view.rotation[2] + view.translation_mm[2]
    if np.any(depth <= 0):
        raise DegenerateGeometry("The best fit puts grid points behind the camera.")
    residuals = np.ascontiguousarray(result.residuals.T)
    # A point that the detector itself calls ten times as uncertain as the rest had a hundredth of their weight: it is
    # reported as what it was, left out, and does not stand in the statistics as if it had been believed.
    uncertainty = points.standard_uncertainty_px
    used = result.used & (uncertainty <= UNTRUSTED * np.median(uncertainty))
    if result.scale > SMALLEST_NOISE_PX:
        inflation, rho = correlation_inflation(points, result)
    else:
        inflation, rho = 1.0, 0.0  # what is left are rounding errors
    # From the centroid to the target's origin: t = t_c - R c, so d = d_c + [R c]× w.
    origin = -view.rotation @ centroid
    to_origin = np.eye(15)
    to_origin[12:, 9:12] = -hat(origin)
    covariance = np.zeros((15, 15))
    # All of it, the priors' part too: a print that is longer one way breaks fx = fy as it breaks the residuals.
    covariance[np.ix_(indices, indices)] = result.covariance * inflation**2
    covariance = to_origin @ covariance @ to_origin.T
    translation = view.translation_mm + origin
    if points.target.pitch_standard_uncertainty_mm:
        # A print 1 % too large is taken for one 1 % nearer: the same relative error in every length. It is
        # common to all images of the target, so it belongs to the absolute pose, not the conditional one.
        relative = points.target.pitch_standard_uncertainty_mm / points.target.pitch_mm
        covariance[12:, 12:] += relative**2 * np.outer(translation, translation)
    conditional = np.linalg.inv(result.information[-6:, -6:]) * inflation**2
    conditional = to_origin[9:, 9:] @ conditional @ to_origin[9:, 9:].T
    focal, focal_uncertainty = _focal(view.camera, covariance)
    # Where focal length cannot be told the cost is a flat valley, on which the solver may walk on without
    # end: that is the refusal's case too, not a failure to converge.
    if focal_uncertainty > gate:
        raise FocalNotObservable(
            f"The focal length is not observable in this view: its predicted standard uncertainty is "
            f"{100 * focal_uncertainty:.1f} % of {focal:.0f} px, more than {100 * gate:.0f} %."
        )
    if not result.converged:
        raise NotConverged(f"The fit did not converge within {result.iterations} iterations.")
    pose = camera_pose(view.rotation, translation, covariance[9:, 9:], conditional)
    statistics = reprojection(residuals, used)
    chi = result.scale / float(np.mean(points.standard_uncertainty_px))
    warnings = remarks(points, pose, statistics, chi, inflation, rho)
    if len(indices) == len(POSE):
        warnings.append(
            Advisory(
                "intrinsics_taken_as_exact",
                "The session's intrinsics were used as given; the pose's uncertainty does not contain theirs.",
            )
        )
    if any(abs(rival - focal) > 3.0 * focal_uncertainty * focal for rival in rivals):
        warnings.append(
            Advisory(
                "starts_disagree",
                f"Other focal lengths explain this view as well: {', '.join(f'{f:.0f} px' for f in rivals)}.",
                "Tilt the target more, or give the session's intrinsics.",
            )
        )
    if (
        lens is not None
        and len(indices) == len(FREE)
        and abs(math.log(lens.focal_px / focal)) > 3.0 * LENS_PRIOR
    ):
        warnings.append(
            Advisory(
                "lens_prior_contradicted",
                f"The image says f = {focal:.0f} px, the stated lens {lens.focal_px:.0f} px.",
                "Check the lens's focal length and the camera's pixel pitch (binning doubles it).",
            )
        )
    return Calibration(
        estimator="given" if len(indices) == len(POSE) else "per_image",
        start=start,
        image_width_px=points.image_width_px,
        image_height_px=points.image_height_px,
        camera=view.camera,
        T_camera_target=transform(view.rotation, translation),
        covariance=covariance,
        pose=pose,
        reprojection=statistics,
        observability=Observability(
            focal_relative_uncertainty=focal_uncertainty,
            condition_number=result.condition_number,
            tilt=math.acos(min(1.0, max(-1.0, float(view.rotation[2, 2])))),
            prior_dominated=_prior_dominated(points, view.camera, covariance, lens)
            if len(indices) == len(FREE)
            else (),
        ),
        warnings=tuple(warnings),
        points=points,
        residuals_px=residuals,
        used=used,
    )


def _focal(camera: Camera, covariance: Float[np.ndarray, "15 15"]) -> tuple[float, float]:
    """Return the mean focal length and its relative standard uncertainty."""
    focal = 0.5 * (camera.fx_px + camera.fy_px)
    variance = 0.25 * float(covariance[0, 0] + 2.0 * covariance[0, 1] + covariance[1, 1])
    return focal, math.sqrt(max(variance, 0.0)) / focal


def _prior_dominated(
    points: GridPoints, camera: Camera, covariance: Float[np.ndarray, "15 15"], lens: Lens | None
) -> tuple[str, ...]:
    """Name the parameters of which the prior tells more than the image: posterior variance over half the
    prior's.
    """
    sigma = np.full(9, np.inf)
    sigma[2:4] = PRINCIPAL_POINT_PRIOR * points.image_width_px
    sigma[4:6] = RADIAL_PRIORS
    sigma[6:8] = TANGENTIAL_PRIOR
    if lens is not None:
        sigma[:2] = LENS_PRIOR * camera.fx_px, LENS_PRIOR * camera.fy_px
    dominated = np.diag(covariance)[:9] > 0.5 * sigma**2
    return tuple(name for name, flag in zip(CAMERA_PARAMETERS, dominated, strict=True) if flag)
