"""Views of a focus group that were fitted together: all before one camera, given or their own."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from core.calibration.arrow import KNOWN
from core.calibration.group_starts import Alike, find_alike, placed_before
from core.calibration.group_two_fold import with_better_tilts
from core.calibration.model import View
from core.calibration.shared_lens import Linearised, SharedLens, fit_shared_lens
from core.calibration.validity import check_camera
from core.calibration.view_stack import Placements, ViewStack, stack_states
from core.camera import Camera
from core.errors import Advisory, DegenerateGeometry, EstimationError, GridposeError, NotConverged


@dataclass(frozen=True, slots=True)
class Fitted:
    """The views that could be fitted, at their placements, before their doubt is known.

    `images` says which of all views given they are, `labels` are theirs; `shared` is the fit of those that share a
    camera, left-out views included. `tilt_evidence` says how sure the tilt of each view's pose is
    (`group_two_fold.with_better_tilts`), None where that was not looked at.
    """

    estimator: str
    images: list[int]
    views: ViewStack
    labels: Int[np.ndarray, " m"]
    at: Linearised
    used: Bool[np.ndarray, " n"]
    shared: SharedLens | None
    warnings: tuple[Advisory, ...] = ()
    tilt_evidence: Float[np.ndarray, " m"] | None = None


def fit_given(
    views: ViewStack, labels: Int[np.ndarray, " m"], camera: Camera, failures: dict[int, GridposeError]
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
        raise first_failure(failures)
    chosen, repeats = views.take(usable), labels[usable]
    alike = Alike(usable, alike.leader, alike.homographies, alike.failures)
    shared = fit_shared_lens(chosen, start_of(alike, of_leader), KNOWN, repeats=repeats)
    shared, evidence = with_better_tilts(chosen, shared, KNOWN, None, repeats)
    return fitted_together("given", chosen, usable, repeats, shared, failures, (), evidence)


def start_of(alike: Alike, of_leader: dict[int, View]) -> Placements:
    """Return for every usable view the placement of its leader."""
    place = {i: k for k, i in enumerate(of_leader)}
    return stack_states(list(of_leader.values())).take([place[alike.leader[i]] for i in alike.usable])


def fitted_together(
    estimator: str,
    views: ViewStack,
    usable: list[int],
    labels: Int[np.ndarray, " m"],
    shared: SharedLens,
    failures: dict[int, GridposeError],
    warnings: tuple[Advisory, ...],
    evidence: Float[np.ndarray, " m"],
) -> Fitted:
    """Return a fit without the views that do not fit the common camera or lie behind it."""
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
        raise first_failure(failures)
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
    return Fitted(
        estimator, images, views.take(kept), labels[kept], at, used, shared, warnings, evidence[kept]
    )


def first_failure(failures: dict[int, GridposeError]) -> GridposeError:
    return failures[min(failures)]
