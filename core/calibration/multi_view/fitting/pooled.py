"""One camera estimated from several images together.

`fit_pooled` estimates the camera of a focus group, whose images may repeat one pose, contradict the stated lens or be
unusable. `calibrate_views` estimates the camera of views which all have to be fitted. Both fit by the same steps.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from core.calibration.multi_view.bundle_adjustment import BundleAdjustment, bundle_adjust
from core.calibration.multi_view.correlated_residuals import shared_variance_inflation
from core.calibration.multi_view.fitting.initialisation import (
    Fitted,
    RepeatGroups,
    accepted_fit,
    first_failure,
    group_repeats,
    initial_focals,
    initial_placements,
    placed_before,
)
from core.calibration.multi_view.planar_ambiguity import select_solutions
from core.calibration.multi_view.view_stack import ViewStack, stack_states, stack_views
from core.calibration.priors import LENS_PRIOR, Lens
from core.calibration.residuals import View
from core.calibration.result import MAX_DETERMINED_UNCERTAINTY, MAX_FOCAL_UNCERTAINTY
from core.calibration.single_image import calibrate_points
from core.calibration.state import image_centre, place_by_homography, pose_from_undistorted_points
from core.calibration.validity import check_lens
from core.errors import (
    ADVISED_TILT,
    Advisory,
    FocalNotObservable,
    GridposeError,
    InvalidArgument,
    NotConverged,
)
from core.geometry import AnyCamera, Camera, free_parameters, transform
from core.numerics import SHARED_CAMERA, free_focal, shared_camera
from core.targets import GridPoints

MIN_VIEWS_FOR_SUBSET = 200
"""Views from which on a part of them is fitted first."""
CONTRADICTION = 3.0
"""Standard uncertainties of their difference from which on images contradict the lens that was stated."""
MAX_CANDIDATES = 5
"""Views whose own cameras are tried as a start where no other start leads to an end."""


@dataclass(frozen=True, slots=True)
class PooledCalibration:
    """One camera from several views.

    `covariance` (9, 9) in the order of `CAMERA_PARAMETERS` (k3 held at 0), `inflation` by how much its standard
    uncertainties are larger than independent residuals would leave them, `T_camera_target` one (4, 4) per view,
    `residuals_px` and `used` per view; of a view unlike the others no point is used.
    """

    camera: Camera
    covariance: Float[np.ndarray, "9 9"]
    T_camera_target: tuple[Float[np.ndarray, "4 4"], ...]
    residuals_px: tuple[Float[np.ndarray, "_ 2"], ...]
    used: tuple[Bool[np.ndarray, " _"], ...]
    rms_px: float
    inflation: float


def calibrate_views(views: Sequence[GridPoints], *, lens: Lens | None = None) -> PooledCalibration:
    """Estimate one camera and a pose per view from the grid points of several images of the same size.

    Raises InvalidArgument for no views, mixed image sizes or points that make no sense, DegenerateGeometry for points
    on one line, NotConverged.
    """
    if not views:
        raise InvalidArgument("At least one view is needed.")
    size = (views[0].image_width_px, views[0].image_height_px)
    if any((v.image_width_px, v.image_height_px) != size for v in views):
        raise InvalidArgument(
            "All views must have the same image size.", "Pool images of one camera setting only."
        )
    stack = stack_views(views)
    found = fit_common_camera(stack, lens)
    if not found.converged:
        raise NotConverged("The pooled fit did not converge from any start.")
    growth = shared_variance_inflation(stack, found, np.arange(len(stack))).camera
    placements, residuals, used = found.at.placements, found.at.residuals, found.used
    origins = placements.translations_mm - np.einsum("kij,kj->ki", placements.rotations, stack.centroids)
    parts = [stack.part(i) for i in range(len(stack))]
    return PooledCalibration(
        camera=Camera.from_array(placements.parameters[0]),
        covariance=growth * found.covariance,
        T_camera_target=tuple(transform(R, t) for R, t in zip(placements.rotations, origins, strict=True)),
        residuals_px=tuple(np.ascontiguousarray(residuals[:, part].T) for part in parts),
        used=tuple(used[part] for part in parts),
        rms_px=float(np.sqrt(np.sum(residuals[:, used] ** 2) / max(int(used.sum()), 1))),
        inflation=math.sqrt(growth),
    )


def fit_pooled(
    views: ViewStack,
    labels: Int[np.ndarray, " m"],
    estimator: str,
    lens: Lens | None,
    failures: dict[int, GridposeError],
    start: AnyCamera | None = None,
    *,
    weak: bool = False,
) -> Fitted:
    """Fit one camera, with `pooled_free_focal` but for its focal length; add what cannot be fitted to `failures`.

    From a camera to `start` with the fit is of its lens model; else it is of Brown's, from closed forms. A `weak`
    camera is answered up to `MAX_FOCAL_UNCERTAINTY`.
    """
    groups = group_repeats(views, labels, least=6)
    failures |= groups.failures
    of_leader: dict[int, View] = {}
    if start is not None:
        groups, of_leader = placed_before(start, views, groups, failures)
    if not groups.usable:
        raise first_failure(failures)
    chosen = views.take(groups.usable)
    repeats = labels[groups.usable]
    if lens is not None:
        check_lens(lens, views.view(groups.usable[0]))
    if start is None:
        shared = _fit_from_closed_forms(views, groups, repeats, lens)
    else:
        sharing = shared_camera(free_parameters(len(start.as_array())))
        begin = initial_placements(groups, of_leader)
        shared = bundle_adjust(chosen, begin, sharing, lens=lens, repeats=repeats)
    free = shared.at.placements.free
    whole, but_focal = shared_camera(free), free_focal(free)
    warnings: tuple[Advisory, ...] = ()
    if lens is not None and shared.converged and _contradicts(shared, lens):
        shared = bundle_adjust(chosen, shared.at.placements, whole, repeats=repeats)
        warnings = (lens_warning(lens, _focal(shared)),)
        lens = None
    _check_focal(shared, MAX_FOCAL_UNCERTAINTY if weak else MAX_DETERMINED_UNCERTAINTY)
    if estimator == "pooled_free_focal":
        shared = bundle_adjust(chosen, shared.at.placements, but_focal, lens=lens, repeats=repeats)
    shared, evidence = select_solutions(
        chosen, shared, whole if estimator == "pooled" else but_focal, lens, repeats
    )
    if not shared.converged:
        raise NotConverged(
            "No common camera explains the images.",
            "Check that all images of the focus group show the session's targets, taken with one camera setting.",
        )
    accepted = accepted_fit(estimator, chosen, groups.usable, repeats, shared, failures, warnings, evidence)
    return replace(accepted, lens=lens)


def fit_common_camera(views: ViewStack, lens: Lens | None) -> BundleAdjustment:
    """Fit one camera to views of which each is a pose of its own and all have to be fitted.

    Raises InvalidArgument or DegenerateGeometry for a view whose points determine no pose.
    """
    groups = group_repeats(views, np.arange(len(views)), least=4)
    if groups.failures:
        raise first_failure(groups.failures)
    return _fit_from_closed_forms(views, groups, None, lens)


def _fit_from_closed_forms(
    views: ViewStack, groups: RepeatGroups, repeats: Int[np.ndarray, " m"] | None, lens: Lens | None
) -> BundleAdjustment:
    """Fit one camera to the views that can be fitted, from their own closed forms or, where none gives a focal length,
    from assumed ones; from the cameras of single views where none of these converges.
    """
    chosen = views.take(groups.usable)
    each = {i: views.view(i) for i in groups.homographies}
    some = views.view(groups.usable[0])
    focals = initial_focals([(H, each[i]) for i, H in groups.homographies.items()], lens)
    fits = []
    for focal in focals:
        camera = Camera(focal, focal, *image_centre(some))
        of_leader = {
            i: place_by_homography(H, each[i], camera, views.centroids[i])
            for i, H in groups.homographies.items()
        }
        of_leader = _fit_subset(views, groups, of_leader, lens)
        fits.append(
            bundle_adjust(
                chosen, initial_placements(groups, of_leader), SHARED_CAMERA, lens=lens, repeats=repeats
            )
        )
    if not any(f.converged for f in fits):
        fits += _from_single_images(chosen, repeats, groups, each, lens)
    return min(fits, key=lambda f: (not f.converged, -int(f.kept.sum()), f.scale))


def _fit_subset(
    views: ViewStack, groups: RepeatGroups, of_leader: dict[int, View], lens: Lens | None
) -> dict[int, View]:
    """Return placements of the leaders, fitted among themselves where they are few among many: the fit of all, which
    begins there, then is at its end in a step or two.
    """
    leaders = list(of_leader)
    if len(groups.usable) < MIN_VIEWS_FOR_SUBSET or len(leaders) > len(groups.usable) // 4:
        return of_leader
    part = bundle_adjust(
        views.take(leaders), stack_states(list(of_leader.values())), SHARED_CAMERA, lens=lens
    )
    if not (part.converged and part.kept.all()):
        return of_leader
    return {i: part.at.placements.view(k) for k, i in enumerate(leaders)}


def _focal(shared: BundleAdjustment) -> float:
    """Return the mean of fx and fy, px."""
    return 0.5 * float(shared.at.placements.parameters[0, :2].sum())


def _relative_uncertainty(shared: BundleAdjustment) -> float:
    """Return u(f)/f, infinite where the fit is so degenerate that its variance is not positive."""
    covariance = shared.covariance
    variance = 0.25 * float(covariance[0, 0] + 2.0 * covariance[0, 1] + covariance[1, 1])
    return math.sqrt(variance) / _focal(shared) if variance > 0.0 else math.inf


def _contradicts(shared: BundleAdjustment, lens: Lens) -> bool:
    """Return whether the images alone determine a focal length that contradicts the lens's.

    The fit weighed both, 1/u² = 1/u_images² + 1/u_lens² for the logarithm, from which the images' own part follows.
    """
    precision = 1.0 / _relative_uncertainty(shared) ** 2 - 1.0 / LENS_PRIOR**2
    if precision <= 0.1 / LENS_PRIOR**2:
        return False  # the images say next to nothing
    off = math.log(_focal(shared) / lens.focal_px) * (precision + 1.0 / LENS_PRIOR**2) / precision
    return abs(off) > CONTRADICTION * math.hypot(LENS_PRIOR, precision**-0.5)


def _from_single_images(
    chosen: ViewStack,
    repeats: Int[np.ndarray, " m"] | None,
    groups: RepeatGroups,
    each: Mapping[int, GridPoints],
    lens: Lens | None,
) -> list[BundleAdjustment]:
    """Start from the cameras of single views: where one pose is all there is, the way there is long and curved, and the
    fit of a single image follows it.
    """
    fits = []
    for i in list(groups.homographies)[:MAX_CANDIDATES]:
        try:
            camera = calibrate_points(each[i], lens=lens).camera
            of_leader = {k: pose_from_undistorted_points(camera, each[k]) for k in groups.homographies}
        except GridposeError:
            continue
        fits.append(
            bundle_adjust(
                chosen, initial_placements(groups, of_leader), SHARED_CAMERA, lens=lens, repeats=repeats
            )
        )
        if fits[-1].converged:
            break
    return fits


def lens_warning(lens: Lens, focal_px: float, share: str = "") -> Advisory:
    return Advisory(
        "focal_prior_inconsistent",
        f"The images say f = {focal_px:.0f} px, the stated lens {lens.focal_px:.0f} px; the lens was ignored{share}.",
        "Check the lens's focal length and the camera's pixel pitch (binning doubles it).",
    )


def _check_focal(shared: BundleAdjustment, limit: float) -> None:
    """Raise FocalNotObservable where all views together leave the focal length open."""
    u = _relative_uncertainty(shared)
    if u > limit:
        raise FocalNotObservable(
            f"Together the images leave the focal length uncertain by {100.0 * u:.1f} %; the limit is "
            f"{100.0 * limit:.2g} %."
            if math.isfinite(u)
            else "Together the images leave the focal length undetermined.",
            f"Add images with the target tilted by {ADVISED_TILT}, or give the session intrinsics and use "
            "estimator=given.",
        )
