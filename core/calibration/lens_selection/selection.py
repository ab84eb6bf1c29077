"""Selection of a session's lens model: Brown's unless the images contradict it.

A single image cannot decide. Over one image of each pose, Brown's model and Kannala's and Brandt's are fitted to the
same points; `comparison` says what decides between them.

Most sessions are done after a first look: how much radial terms beyond Brown's would gain, to first order.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Int

from core.calibration.lens_selection.common_fit import radial_gain, squared_distances
from core.calibration.lens_selection.comparison import (
    MAX_REJECTED,
    MIN_POINTS,
    Comparison,
    LensEvidence,
    far_off,
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
from core.geometry import AnyCamera, Camera, LensModel, camera_from_array, fold_radius_px

FIRST_LOOK_SHARE = 0.02
"""Of the squares: where radial terms gain less to first order, Brown's model is not looked at further."""
GROSS = 30.0
"""Times the median distance: points further off are nothing of the lens."""
MIN_VIEWS, MAX_VIEWS = 2, 30
FOLD_MARGIN = 1.05


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
    found = Comparison.of(chosen, at, angular, lens)
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
    near = ~far_off(squared / stated)
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
    if share > FIRST_LOOK_SHARE or float(np.mean(far_off(squared))) > MAX_REJECTED:
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
