"""One camera from all views of a focus group, whatever a single one of them tells of it."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from core.calibration.arrow import FREE_FOCAL, TIED
from core.calibration.group_fits import Fitted, first_failure, fitted_together, start_of
from core.calibration.group_starts import Alike, find_alike, placed, placed_before, start_focals
from core.calibration.group_two_fold import with_better_tilts
from core.calibration.model import LENS_PRIOR, Lens, View, image_centre
from core.calibration.shared_lens import SharedLens, fit_shared_lens
from core.calibration.single_image import FOCAL_GATE, calibrate_points
from core.calibration.validity import check_lens
from core.calibration.view_stack import ViewStack, stack_states
from core.camera import Camera
from core.errors import Advisory, FocalNotObservable, GridposeError, NotConverged
from core.targets.specification import GridPoints

MANY = 200
"""Views from which on a part of them is fitted first."""
CONTRADICTION = 3.0
"""Standard uncertainties of their difference from which on images contradict the lens that was stated."""
TRIED = 5
"""Views whose own cameras are tried as a start where no other start leads to an end."""


def fit_pooled(
    views: ViewStack,
    labels: Int[np.ndarray, " m"],
    estimator: str,
    lens: Lens | None,
    failures: dict[int, GridposeError],
) -> Fitted:
    """Fit one camera, with `pooled_free_focal` but for its focal length; add what cannot be fitted to `failures`."""
    alike = find_alike(views, labels, least=6)
    failures |= alike.failures
    if not alike.usable:
        raise first_failure(failures)
    chosen = views.take(alike.usable)
    repeats = labels[alike.usable]
    each = {i: views.view(i) for i in alike.homographies}
    some = views.view(alike.usable[0])
    if lens is not None:
        check_lens(lens, some)
    focals = start_focals([(H, each[i]) for i, H in alike.homographies.items()], lens)
    fits = []
    for focal in focals:
        camera = Camera(focal, focal, *image_centre(some))
        of_leader = {i: placed(H, each[i], camera, views.centroids[i]) for i, H in alike.homographies.items()}
        of_leader = _fit_part(views, alike, of_leader, lens)
        fits.append(fit_shared_lens(chosen, start_of(alike, of_leader), TIED, lens=lens, repeats=repeats))
    if not any(f.converged for f in fits):
        fits += _from_single_images(views, chosen, repeats, alike, each, lens)
    shared = min(fits, key=lambda f: (not f.converged, -int(f.kept.sum()), f.scale))
    warnings: tuple[Advisory, ...] = ()
    if lens is not None and shared.converged and _contradicts(shared, lens):
        shared = fit_shared_lens(chosen, shared.at.placements, TIED, repeats=repeats)
        warnings = (lens_contradiction(lens, _focal(shared)),)
        lens = None
    _check_focal(shared)
    if estimator == "pooled_free_focal":
        shared = fit_shared_lens(chosen, shared.at.placements, FREE_FOCAL, lens=lens, repeats=repeats)
    shared, evidence = with_better_tilts(
        chosen, shared, TIED if estimator == "pooled" else FREE_FOCAL, lens, repeats
    )
    if not shared.converged:
        raise NotConverged(
            "No common camera explains the images.",
            "Check that all images of the focus group show the session's targets, taken with one camera setting.",
        )
    return fitted_together(estimator, chosen, alike.usable, repeats, shared, failures, warnings, evidence)


def _fit_part(
    views: ViewStack, alike: Alike, of_leader: dict[int, View], lens: Lens | None
) -> dict[int, View]:
    """Return placements of the leaders, fitted among themselves where they are few among many: the fit of all, which
    begins there, then is at its end in a step or two.
    """
    leaders = list(of_leader)
    if len(alike.usable) < MANY or len(leaders) > len(alike.usable) // 4:
        return of_leader
    part = fit_shared_lens(views.take(leaders), stack_states(list(of_leader.values())), TIED, lens=lens)
    if not (part.converged and part.kept.all()):
        return of_leader
    return {i: part.at.placements.view(k) for k, i in enumerate(leaders)}


def _focal(shared: SharedLens) -> float:
    """Return the mean of fx and fy, px."""
    return 0.5 * float(shared.at.placements.parameters[0, :2].sum())


def _relative_uncertainty(shared: SharedLens) -> float:
    """Return u(f)/f, infinite where the fit is so degenerate that its covariance is none."""
    covariance = shared.covariance
    variance = 0.25 * float(covariance[0, 0] + 2.0 * covariance[0, 1] + covariance[1, 1])
    return math.sqrt(variance) / _focal(shared) if variance > 0.0 else math.inf


def _contradicts(shared: SharedLens, lens: Lens) -> bool:
    """Tell whether the images alone say a focal length that the lens's does not fit.

    The fit weighed both, 1/u² = 1/u_images² + 1/u_lens² for the logarithm, from which the images' own part follows.
    """
    precision = 1.0 / _relative_uncertainty(shared) ** 2 - 1.0 / LENS_PRIOR**2
    if precision <= 0.1 / LENS_PRIOR**2:
        return False  # the images say next to nothing
    off = math.log(_focal(shared) / lens.focal_px) * (precision + 1.0 / LENS_PRIOR**2) / precision
    return abs(off) > CONTRADICTION * math.hypot(LENS_PRIOR, precision**-0.5)


def _from_single_images(
    views: ViewStack,
    chosen: ViewStack,
    repeats: Int[np.ndarray, " m"],
    alike: Alike,
    each: Mapping[int, GridPoints],
    lens: Lens | None,
) -> list[SharedLens]:
    """Start from the cameras of single views: where one pose is all there is, the way there is long and curved, and the
    fit of a single image follows it.
    """
    fits = []
    for i in list(alike.homographies)[:TRIED]:
        try:
            camera = calibrate_points(each[i], lens=lens).camera
            of_leader = {k: placed_before(camera, each[k]) for k in alike.homographies}
        except GridposeError:
            continue
        fits.append(fit_shared_lens(chosen, start_of(alike, of_leader), TIED, lens=lens, repeats=repeats))
        if fits[-1].converged:
            break
    return fits


def lens_contradiction(lens: Lens, focal_px: float, share: str = "") -> Advisory:
    return Advisory(
        "lens_prior_contradicted",
        f"The images say f = {focal_px:.0f} px, the stated lens {lens.focal_px:.0f} px; the lens was left out{share}.",
        "Check the lens's focal length and the camera's pixel pitch (binning doubles it).",
    )


def _check_focal(shared: SharedLens) -> None:
    """Raise FocalNotObservable where all views together leave the focal length open."""
    u = _relative_uncertainty(shared)
    if u > FOCAL_GATE:
        raise FocalNotObservable(
            f"Together the images leave the focal length uncertain by {100.0 * u:.1f} %; the limit is "
            f"{100.0 * FOCAL_GATE:g} %."
            if math.isfinite(u)
            else "Together the images leave the focal length undetermined.",
            "Add images with the target tilted by 15° or more, or give the session intrinsics and use estimator=given.",
        )
