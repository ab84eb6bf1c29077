"""Where a common fit of many views starts: images of one pose show nearly the same, so one start serves them all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from core.calibration import closed_form
from core.calibration.homography import estimate_homography
from core.calibration.model import Lens, View, centred
from core.calibration.single_image import assumed_focals, plausible_start
from core.calibration.validity import LARGEST_RATIO, check_points
from core.calibration.view_stack import ViewStack, evenly
from core.camera import Camera, project, undistort_points
from core.compiled import compiled
from core.errors import DegenerateGeometry, GridposeError
from core.targets.specification import GridPoints

NEAR = 0.02
"""Of the image's width: views whose points lie within this of one another's have one start."""
ASKED = 30
"""As many views, evenly chosen, are asked for a focal length to start from."""


@dataclass(frozen=True, slots=True)
class Alike:
    """Views that can be fitted, by their indices; each with the `leader` whose start it takes, itself or another, and
    the leaders' homographies. The others are in `failures`, with the reason.
    """

    usable: list[int]
    leader: dict[int, int]
    homographies: dict[int, Float[np.ndarray, "3 3"]]
    failures: dict[int, GridposeError]


def find_alike(views: ViewStack, labels: Int[np.ndarray, " m"], *, least: int) -> Alike:
    """Check the views, of which each needs `least` points, and find those of one label that show nearly the same."""
    _, first, place = np.unique(labels, return_index=True, return_inverse=True)
    firsts = first[place]
    near = _near(views, firsts) & (firsts != np.arange(len(views)))
    alike = Alike([], {}, {}, {})
    leaders: dict[int, int] = {}
    # What is near its label's first view, if that one is sound, needs no look of its own.
    for i in np.flatnonzero(~near).tolist():
        _look(views, int(labels[i]), i, leaders, alike, least)
    for i in np.flatnonzero(near).tolist():
        leader = int(firsts[i])
        if leader in alike.leader:
            alike.leader[i] = alike.leader[leader]
        else:
            _look(views, int(labels[i]), i, leaders, alike, least)
    usable = sorted(alike.leader)
    return Alike(usable, alike.leader, alike.homographies, alike.failures)


def _look(views: ViewStack, label: int, i: int, leaders: dict[int, int], alike: Alike, least: int) -> None:
    """Take view i for near its label's leader, for a leader or for a failure."""
    leader = leaders.get(label)
    if leader is not None and _near_one(views, i, leader):
        alike.leader[i] = leader
        return
    view = views.view(i)
    try:
        check_points(view)
        if len(view) < least:
            raise DegenerateGeometry(f"A pose needs at least {least} grid points, {len(view)} were found.")
        alike.homographies[i] = estimate_homography(view.points_target[:, :2], view.points_px)
    except GridposeError as failure:
        alike.failures[i] = failure
        return
    alike.leader[i] = i
    leaders.setdefault(label, i)


def _near_one(views: ViewStack, i: int, leader: int) -> bool:
    return bool(_near(views.take([leader, i]), np.zeros(2, dtype=np.intp))[1])


def _near(views: ViewStack, leaders: Int[np.ndarray, " m"]) -> Bool[np.ndarray, " m"]:
    """Tell of each view whether it shows the points of its leader, in nearly the same places."""
    return shows_the_same(
        leaders,
        views.first,
        views.target,
        views.column,
        views.row,
        views.points_px,
        views.standard_uncertainty_px,
        NEAR * views.image_width_px,
        LARGEST_RATIO,
    )


@compiled
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
    """Tell whether views show the same points as their leaders within `near_px`, with uncertainties that make sense:
    what is near a view that was checked is sound too. NaN is near nothing.
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


def start_focals(
    views: Sequence[tuple[Float[np.ndarray, "3 3"], GridPoints]], lens: Lens | None
) -> list[float]:
    """Return the focal lengths to start from: the median of what views by themselves tell, each given with its
    homography, or assumed ones where none tells any. Of many views a part is asked first.
    """
    for asked in (evenly(list(views), ASKED), views):
        starts = [plausible_start(H, points) for H, points in asked]
        found = [start.camera.fx_px for start in starts if start is not None]
        if found:
            return [float(np.median(found))]
    return assumed_focals(views[0][1], lens)


def placed(
    H: Float[np.ndarray, "3 3"], points: GridPoints, camera: Camera, centroid: Float[np.ndarray, "3"]
) -> View:
    """Place a view before a camera by its homography, distortion left aside; `centroid` is that of its points."""
    T = closed_form.nominal(H, points, camera).T_camera_target
    return View(camera.as_array(), T[:3, :3], T[:3, :3] @ centroid + T[:3, 3])


def placed_before(camera: Camera, points: GridPoints) -> View:
    """Place a view before a known camera by the homography of its undistorted points.

    Raises DegenerateGeometry where the camera's distortion has no inverse at the points.
    """
    normalised = undistort_points(points.points_px, camera)
    again = project(np.column_stack([normalised, np.ones(len(normalised))]), camera)
    if float(np.mean(np.abs(again - points.points_px) > 0.5)) > 0.1:
        raise DegenerateGeometry(
            "The distortion folds back within the image: these pixels have no direction.",
            "Check the session's intrinsics: k1, k2, p1, p2, k3 in OpenCV's order, for this image size.",
        )
    H = camera.matrix @ estimate_homography(points.points_target[:, :2], normalised)
    return placed(H, points, camera, centred(points)[1])
