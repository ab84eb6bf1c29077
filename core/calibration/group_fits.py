"""The images of a focus group fitted: all with one camera, with a known one, or each with its own."""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from core.calibration.arrow import FREE_FOCAL, KNOWN, TIED
from core.calibration.fixed_centre import fit_fixed_centre
from core.calibration.group_starts import Alike, find_alike, placed, placed_before
from core.calibration.model import LENS_PRIOR, Lens, View, centred, image_centre
from core.calibration.same_points import fit_again, points_in_common
from core.calibration.shared_lens import Linearised, SharedLens, fit_shared_lens, linearise
from core.calibration.single_image import FOCAL_GATE, assumed_focals, calibrate_points, plausible_start
from core.calibration.validity import check_camera, check_lens
from core.calibration.view_stack import Placements, ViewStack, stack_states
from core.camera import Camera
from core.errors import (
    Advisory,
    DegenerateGeometry,
    EstimationError,
    FocalNotObservable,
    GridposeError,
    NotConverged,
)
from core.targets.specification import GridPoints

MANY = 200
"""Views from which on a part of them is fitted first."""
CONTRADICTION = 3.0
"""Standard uncertainties of their difference from which on images contradict the lens that was stated."""


@dataclass(frozen=True, slots=True)
class Fitted:
    """The views that could be fitted, at their placements, before their doubt is known.

    `images` says which of all views given they are, `labels` are theirs; `shared` is the fit of those that share a
    camera, left-out views included.
    """

    estimator: str
    images: list[int]
    views: ViewStack
    labels: list[Hashable]
    at: Linearised
    used: Bool[np.ndarray, " n"]
    shared: SharedLens | None
    warnings: tuple[Advisory, ...] = ()


def fit_pooled(
    views: ViewStack,
    labels: Sequence[Hashable],
    estimator: str,
    lens: Lens | None,
    failures: dict[int, GridposeError],
) -> Fitted:
    """Fit one camera, with `pooled_free_focal` but for its focal length; add what cannot be fitted to `failures`."""
    alike = find_alike(views, labels, least=6)
    failures |= alike.failures
    if not alike.usable:
        raise _first(failures)
    chosen = views.take(alike.usable)
    repeats = [labels[i] for i in alike.usable]
    each = {i: views.view(i) for i in alike.homographies}
    starts = [plausible_start(H, each[i]) for i, H in alike.homographies.items()]
    found = [start.camera.fx_px for start in starts if start is not None]
    some = views.view(alike.usable[0])
    if lens is not None:
        check_lens(lens, some)
    focals = [float(np.median(found))] if found else assumed_focals(some, lens)
    fits = []
    for focal in focals:
        camera = Camera(focal, focal, *image_centre(some))
        of_leader = {i: placed(H, each[i], camera) for i, H in alike.homographies.items()}
        of_leader = _fit_part(views, alike, of_leader, lens)
        fits.append(fit_shared_lens(chosen, _start(alike, of_leader), TIED, lens=lens, repeats=repeats))
    shared = min(fits, key=lambda f: (not f.converged, -int(f.kept.sum()), f.scale))
    warnings: tuple[Advisory, ...] = ()
    if lens is not None and shared.converged and _contradicts(shared, lens):
        shared = fit_shared_lens(chosen, shared.at.placements, TIED, repeats=repeats)
        warnings = (_contradiction(lens, _focal(shared)),)
        lens = None
    _check_focal(shared)
    if estimator == "pooled_free_focal":
        shared = fit_shared_lens(chosen, shared.at.placements, FREE_FOCAL, lens=lens, repeats=repeats)
    if not shared.converged:
        raise NotConverged(
            "No common camera explains the images.",
            "Check that all images of the focus group show the session's targets, taken with one camera setting.",
        )
    return _kept(estimator, chosen, alike.usable, repeats, shared, failures, warnings)


def _start(alike: Alike, of_leader: dict[int, View]) -> Placements:
    """Return for every usable view the placement of its leader."""
    place = {i: k for k, i in enumerate(of_leader)}
    return stack_states(list(of_leader.values())).take([place[alike.leader[i]] for i in alike.usable])


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
    covariance = shared.covariance
    u = math.sqrt(0.25 * float(covariance[0, 0] + 2.0 * covariance[0, 1] + covariance[1, 1]))
    return u / _focal(shared)


def _contradicts(shared: SharedLens, lens: Lens) -> bool:
    """Tell whether the images alone say a focal length that the lens's does not fit.

    The fit weighed both, 1/u² = 1/u_images² + 1/u_lens² for the logarithm, from which the images' own part follows.
    """
    precision = 1.0 / _relative_uncertainty(shared) ** 2 - 1.0 / LENS_PRIOR**2
    if precision <= 0.1 / LENS_PRIOR**2:
        return False  # the images say next to nothing
    off = math.log(_focal(shared) / lens.focal_px) * (precision + 1.0 / LENS_PRIOR**2) / precision
    return abs(off) > CONTRADICTION * math.hypot(LENS_PRIOR, precision**-0.5)


def _contradiction(lens: Lens, focal_px: float, share: str = "") -> Advisory:
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
            f"{100.0 * FOCAL_GATE:g} %.",
            "Add images with the target tilted by 15° or more, or give the session intrinsics and use estimator=given.",
        )


def fit_given(
    views: ViewStack, labels: Sequence[Hashable], camera: Camera, failures: dict[int, GridposeError]
) -> Fitted:
    """Fit the poses alone; add what cannot be fitted to `failures`."""
    check_camera(camera, views.view(0))
    alike = find_alike(views, labels, least=5)
    failures |= alike.failures
    of_leader: dict[int, View] = {}
    for i in alike.homographies:
        try:
            of_leader[i] = placed_before(camera, views.view(i))
        except EstimationError as failure:
            failures |= {k: failure for k in alike.usable if alike.leader[k] == i}
    usable = [i for i in alike.usable if alike.leader[i] in of_leader]
    if not usable:
        raise _first(failures)
    chosen, repeats = views.take(usable), [labels[i] for i in usable]
    alike = Alike(usable, alike.leader, alike.homographies, alike.failures)
    shared = fit_shared_lens(chosen, _start(alike, of_leader), KNOWN, repeats=repeats)
    return _kept("given", chosen, usable, repeats, shared, failures, ())


def fit_each(
    views: ViewStack,
    labels: Sequence[Hashable],
    estimator: str,
    lens: Lens | None,
    intrinsics: Camera | None,
    failures: dict[int, GridposeError],
) -> Fitted:
    """Fit every view by itself, then again with the points that its pose's views have in common."""
    images: list[int] = []
    states: list[View] = []
    used: list[Bool[np.ndarray, " _"]] = []
    contradicted: list[bool] = []
    for i in range(len(views)):
        points = views.view(i)
        try:
            if estimator == "per_image":
                found = calibrate_points(points, lens=lens)
                rotation = found.T_camera_target[:3, :3]
                centroid = rotation @ centred(points)[1] + found.T_camera_target[:3, 3]
                state, counted = View(found.camera.as_array(), rotation, centroid), found.used
                against = any(w.code == "lens_prior_contradicted" for w in found.warnings)
            else:
                state, counted, against = _fixed_centre(points, lens, intrinsics)
        except GridposeError as failure:
            failures[i] = failure
            continue
        images.append(i)
        states.append(state)
        used.append(counted)
        contradicted.append(against)
    if not images:
        raise _first(failures)
    warnings = _contradictions(lens, states, contradicted)
    chosen, repeats = views.take(images), [labels[i] for i in images]
    flat = np.concatenate(used)
    at = linearise(chosen, stack_states(states), flat)
    common = points_in_common(chosen, at, repeats)
    if np.array_equal(flat, common):
        return Fitted(estimator, images, chosen, repeats, at, flat, None, warnings)
    for k, i in enumerate(images):
        counted = common[chosen.part(k)]
        if np.array_equal(used[k], counted):
            continue
        try:
            states[k] = fit_again(
                chosen.view(k),
                states[k],
                counted,
                centre_held=estimator == "per_image_fixed_pp",
                lens=None if contradicted[k] else lens,
            )
        except NotConverged as failure:
            failures[i] = failure
    left = [k for k, i in enumerate(images) if i not in failures]
    if not left:
        raise _first(failures)
    flat = np.concatenate([common[chosen.part(k)] for k in left])
    rest = chosen.take(left)
    at = linearise(rest, stack_states([states[k] for k in left]), flat)
    return Fitted(
        estimator, [images[k] for k in left], rest, [repeats[k] for k in left], at, flat, None, warnings
    )


def _contradictions(
    lens: Lens | None, states: Sequence[View], contradicted: Sequence[bool]
) -> tuple[Advisory, ...]:
    if lens is None or not any(contradicted):
        return ()
    focals = [0.5 * float(v.parameters[:2].sum()) for v, c in zip(states, contradicted, strict=True) if c]
    share = f" of {len(focals)} of {len(states)} images"
    return (_contradiction(lens, float(np.median(focals)), share),)


def _fixed_centre(
    points: GridPoints, lens: Lens | None, intrinsics: Camera | None
) -> tuple[View, Bool[np.ndarray, " n"], bool]:
    """Return the view, the points that count, and whether it contradicts the lens."""
    centre = image_centre(points) if intrinsics is None else (intrinsics.cx_px, intrinsics.cy_px)
    result = fit_fixed_centre(points, centre, lens)
    focal = float(result.state.parameters[0])
    u = math.sqrt(max(float(result.covariance[0, 0]), 0.0)) / focal
    if u > FOCAL_GATE:
        raise FocalNotObservable(
            f"The focal length is uncertain by {100.0 * u:.1f} % in this view; the limit is {100.0 * FOCAL_GATE:g} %."
        )
    against = lens is not None and abs(math.log(lens.focal_px / focal)) > CONTRADICTION * math.hypot(
        LENS_PRIOR, u
    )
    return result.state, result.used, against


def _first(failures: dict[int, GridposeError]) -> GridposeError:
    return failures[min(failures)]


def _kept(
    estimator: str,
    views: ViewStack,
    usable: list[int],
    labels: list[Hashable],
    shared: SharedLens,
    failures: dict[int, GridposeError],
    warnings: tuple[Advisory, ...],
) -> Fitted:
    """Leave out views that do not fit the common camera or lie behind it."""
    at, used = shared.at, shared.used
    share = views.sums(used.astype(np.float64)) / views.counts
    before = at.placements.translations_mm[:, 2] > 0
    sound = shared.kept & (share >= 0.5) & before
    for j in np.flatnonzero(~sound).tolist():
        if not shared.kept[j]:
            medians = [float(np.median(at.squared[views.part(k)])) for k in range(len(views))]
            ratio = math.sqrt(medians[j] / float(np.median(medians)))
            failures[usable[j]] = NotConverged(
                f"The residuals of this image are {ratio:.0f} times those of the others of its focus group.",
                "Look at its overlay; an image taken with another focus or zoom needs a focus_group of its own.",
            )
        elif share[j] < 0.5:
            failures[usable[j]] = NotConverged(
                f"Only {100.0 * share[j]:.0f} % of the grid points of this image fit one pose.",
                "Look at its overlay: reflections, dirt or something in front of the grid are the usual causes.",
            )
        else:
            failures[usable[j]] = DegenerateGeometry("The best fit puts the grid behind the camera.")
    kept = np.flatnonzero(sound)
    if not len(kept):
        raise _first(failures)
    if not sound.all():
        points = views.spread(sound)
        at = Linearised(
            at.placements.take(kept),
            at.products[kept],
            at.residuals[:, points],
            at.squared[points],
            at.cost,
        )
        used = used[points]
    images = [usable[j] for j in kept]
    return Fitted(estimator, images, views.take(kept), [labels[j] for j in kept], at, used, shared, warnings)
