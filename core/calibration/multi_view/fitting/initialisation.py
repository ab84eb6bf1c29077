"""Initialisation of a common fit of many views, and the fit of a focus group before one camera.

Images of one pose show nearly the same, so one initial placement serves them all.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from core.calibration.multi_view.bundle_adjustment import BundleAdjustment, bundle_adjust
from core.calibration.multi_view.linearisation import Linearised
from core.calibration.multi_view.planar_ambiguity import select_solutions
from core.calibration.multi_view.view_stack import Placements, ViewStack, evenly, stack_states
from core.calibration.priors import Lens
from core.calibration.residuals import View
from core.calibration.single_image import candidate_focals, closed_form_start
from core.calibration.state import pose_from_undistorted_points
from core.calibration.validity import MAX_UNCERTAINTY_RATIO, check_camera, check_points
from core.errors import Advisory, DegenerateGeometry, EstimationError, GridposeError, NotConverged
from core.geometry import AnyCamera, Camera, estimate_homography
from core.jit import jit
from core.numerics import KNOWN
from core.targets import GridPoints

MAX_REPEAT_DISTANCE = 0.02
"""Of the image's width: views whose points lie within this of one another's have one start."""
MAX_FOCAL_VIEWS = 30
"""As many views, evenly chosen, are asked for a focal length to start from."""


@dataclass(frozen=True, slots=True)
class RepeatGroups:
    """Views that can be fitted, by their indices; each with the `leader` whose start it takes, itself or another, and
    the leaders' homographies. The others are in `failures`, with the reason.
    """

    usable: list[int]
    leader: dict[int, int]
    homographies: dict[int, Float[np.ndarray, "3 3"]]
    failures: dict[int, GridposeError]


def group_repeats(views: ViewStack, labels: Int[np.ndarray, " m"], *, least: int) -> RepeatGroups:
    """Check the views, of which each needs `least` points, and find those of one label that show nearly the same."""
    _, first, place = np.unique(labels, return_index=True, return_inverse=True)
    firsts = first[place]
    near = _near(views, firsts) & (firsts != np.arange(len(views)))
    groups = RepeatGroups([], {}, {}, {})
    leaders: dict[int, int] = {}
    # What is near its label's first view, if that one is sound, needs no look of its own.
    for i in np.flatnonzero(~near).tolist():
        _look(views, int(labels[i]), i, leaders, groups, least)
    for i in np.flatnonzero(near).tolist():
        leader = int(firsts[i])
        if leader in groups.leader:
            groups.leader[i] = groups.leader[leader]
        else:
            _look(views, int(labels[i]), i, leaders, groups, least)
    usable = sorted(groups.leader)
    return RepeatGroups(usable, groups.leader, groups.homographies, groups.failures)


def _look(
    views: ViewStack, label: int, i: int, leaders: dict[int, int], groups: RepeatGroups, least: int
) -> None:
    """Assign view i to its label's leader, make it a leader, or record its failure."""
    leader = leaders.get(label)
    if leader is not None and _near_one(views, i, leader):
        groups.leader[i] = leader
        return
    view = views.view(i)
    try:
        check_points(view)
        if len(view) < least:
            raise DegenerateGeometry(f"A pose needs at least {least} grid points, {len(view)} were found.")
        groups.homographies[i] = estimate_homography(view.points_target[:, :2], view.points_px)
    except GridposeError as failure:
        groups.failures[i] = failure
        return
    groups.leader[i] = i
    leaders.setdefault(label, i)


def _near_one(views: ViewStack, i: int, leader: int) -> bool:
    return bool(_near(views.take([leader, i]), np.zeros(2, dtype=np.intp))[1])


def _near(views: ViewStack, leaders: Int[np.ndarray, " m"]) -> Bool[np.ndarray, " m"]:
    """Return which views show the points of their leader, in nearly the same places."""
    return shows_the_same(
        leaders,
        views.first,
        views.target,
        views.column,
        views.row,
        views.points_px,
        views.standard_uncertainty_px,
        MAX_REPEAT_DISTANCE * views.image_width_px,
        MAX_UNCERTAINTY_RATIO,
    )


@jit("i8[::1], i8[::1], i8[::1], i8[::1], i8[::1], f8[:, ::1], f8[::1], f8, f8")
def shows_the_same(
    leaders: Int[np.ndarray, " m"],
    first: Int[np.ndarray, " bounds"],
    target: Int[np.ndarray, " m"],
    column: Int[np.ndarray, " n"],
    row: Int[np.ndarray, " n"],
    points_px: Float[np.ndarray, "n 2"],
    uncertainty: Float[np.ndarray, " n"],
    near_px: float,
    largest_ratio: float,
) -> Bool[np.ndarray, " m"]:
    """Return which views show the same points as their leaders within `near_px`, with plausible uncertainties:
    a view near one that was checked is valid, too. NaN is near nothing.
    """
    same = np.zeros(len(leaders), dtype=np.bool_)
    for i in range(len(leaders)):
        begin, count, other = first[i], first[i + 1] - first[i], first[leaders[i]]
        if first[leaders[i] + 1] - other != count or target[leaders[i]] != target[i] or count == 0:
            continue
        same[i] = True
        smallest, largest = np.inf, 0.0
        for k in range(count):
            a, b = begin + k, other + k
            smallest, largest = min(smallest, uncertainty[a]), max(largest, uncertainty[a])
            if not (
                column[a] == column[b]
                and row[a] == row[b]
                and abs(points_px[a, 0] - points_px[b, 0]) < near_px
                and abs(points_px[a, 1] - points_px[b, 1]) < near_px
                and uncertainty[a] > 0.0
            ):
                same[i] = False
                break
        same[i] = same[i] and largest < largest_ratio * smallest
    return same


def initial_focals(
    views: Sequence[tuple[Float[np.ndarray, "3 3"], GridPoints]], lens: Lens | None
) -> list[float]:
    """Return the focal lengths to start from: the median of the single views' estimates, each view given with its
    homography, or assumed ones where no view determines one. Of many views a subset is tried first.
    """
    for asked in (evenly(list(views), MAX_FOCAL_VIEWS), views):
        starts = [closed_form_start(H, points) for H, points in asked]
        found = [start.camera.fx_px for start in starts if start is not None]
        if found:
            return [float(np.median(found))]
    return candidate_focals(views[0][1], lens)


@dataclass(frozen=True, slots=True)
class Fitted:
    """The views that could be fitted, at their placements, before their covariance is known.

    `images` are their indices among all views given, `labels` their labels. `shared` is the fit of those that share a
    camera, rejected views included. `tilt_evidence` is the evidence for each pose's tilt
    (`planar_ambiguity.select_solutions`), None where it was not computed; `lens` is the prior of the fit, and
    `prior_factor` its weight where views have cameras of their own (`view_prior`). `own_priors` is the information of
    priors that are not those of any lens, on each view's camera and pose.
    """

    estimator: str
    images: list[int]
    views: ViewStack
    labels: Int[np.ndarray, " m"]
    at: Linearised
    used: Bool[np.ndarray, " n"]
    shared: BundleAdjustment | None
    warnings: tuple[Advisory, ...] = ()
    tilt_evidence: Float[np.ndarray, " m"] | None = None
    lens: Lens | None = None
    prior_factor: float = 1.0
    own_priors: Float[np.ndarray, "k l l"] | None = None


def fit_with_known_camera(
    views: ViewStack, labels: Int[np.ndarray, " m"], camera: Camera, failures: dict[int, GridposeError]
) -> Fitted:
    """Fit the poses alone; add what cannot be fitted to `failures`."""
    check_camera(camera, views.view(0))
    groups = group_repeats(views, labels, least=5)
    failures |= groups.failures
    groups, of_leader = placed_before(camera, views, groups, failures)
    usable = groups.usable
    if not usable:
        raise first_failure(failures)
    chosen, repeats = views.take(usable), labels[usable]
    shared = bundle_adjust(chosen, initial_placements(groups, of_leader), KNOWN, repeats=repeats)
    shared, evidence = select_solutions(chosen, shared, KNOWN, None, repeats)
    return accepted_fit("given", chosen, usable, repeats, shared, failures, (), evidence)


def placed_before(
    camera: AnyCamera, views: ViewStack, groups: RepeatGroups, failures: dict[int, GridposeError]
) -> tuple[RepeatGroups, dict[int, View]]:
    """Place the leaders before a camera; return the groups without those that have no place, and the placements."""
    of_leader: dict[int, View] = {}
    for i in groups.homographies:
        try:
            of_leader[i] = pose_from_undistorted_points(camera, views.view(i))
        except EstimationError as failure:
            failures |= {k: failure for k in groups.usable if groups.leader[k] == i}
    return replace(groups, usable=[k for k in groups.usable if groups.leader[k] in of_leader]), of_leader


def initial_placements(groups: RepeatGroups, of_leader: dict[int, View]) -> Placements:
    """Return for every usable view the placement of its leader."""
    place = {i: k for k, i in enumerate(of_leader)}
    return stack_states(list(of_leader.values())).take([place[groups.leader[i]] for i in groups.usable])


def accepted_fit(
    estimator: str,
    views: ViewStack,
    usable: list[int],
    labels: Int[np.ndarray, " m"],
    shared: BundleAdjustment,
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
