"""Same grid points, same rejections and same weights in all images of one pose.

Systematic residuals of a grid point (a bowed print, a lens beyond the model, a wrong principal point) are the same in
every image of a pose. They move the pose by the point's leverage, but equally in all its images, as long as these use
the same points with the same weights. Otherwise the pose jumps between images, and the jump is mistaken for the
robot's. So three things are decided for all images of a pose together:

- Rejection. Image by image, a point near the limit would be used in some images and rejected in others. The median
  residual of a grid point over the pose's images is tested once for all of them, and in each image only the deviation
  from it.
- Points. Images may show different points, such as where a cable hides half of a board in every other cycle. They are
  estimated from the points that all of them show, if these are at least half of those that any of them shows.
  Otherwise all points are kept, and the pose is reported.
- Weights. The refiner estimates each corner's uncertainty from each image anew, and these estimates scatter by some
  per cent. Pure noise is not affected by that, but a systematic residual far larger than the noise is weighed
  differently in each image: at 3 % scatter and residuals of seven times the noise a motionless robot's RP_l was up to
  1.8 times its noise floor. The pattern of uncertainties over the points is therefore pooled over the images of a pose.
  The overall sharpness stays each image's own, since no pose depends on it. A point that is far less certain in one
  image than in the others keeps its uncertainty.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int

from core.calibration.multi_view.view_stack import ViewStack, groups_of
from core.calibration.state import SMALLEST_NOISE_PX
from core.jit import jit
from core.numerics import REJECTION

MIN_VIEWS_FOR_MEDIAN = 3
"""Images of a point from which on a gross error in one of them leaves the median alone."""
_JUST_BEYOND = 1.001
"""Times a distance over the rejection's: a median that is no less keeps the distance, whatever it is."""


def find_repeats(views: ViewStack, labels: Int[np.ndarray, " m"] | None) -> list[Int[np.ndarray, " _"]]:
    """Return the views of each label, by target; without labels every view is by itself."""
    if labels is None:
        return [np.array([i]) for i in range(len(views))]
    return groups_of(labels * len(views.targets) + views.target)


def inliers_of(
    views: ViewStack,
    poses: Sequence[Int[np.ndarray, " _"]],
    residuals: Float[np.ndarray, "2 n"],
    kept: Bool[np.ndarray, " m"],
) -> Bool[np.ndarray, " n"]:
    """Return which points count; none of views that are not `kept`. `poses` are the views of each pose.

    A point is out in all images of a pose where its median residual lies beyond the rejection's distance of these
    images' residuals, and out in one image where it deviates from that median by more than the rejection's distance of
    that image's deviations, and by more than the median itself: to leave a point out of one image moves its pose by
    what is systematic in the point, to keep it by what deviates.
    """
    used = np.zeros(len(views.column), dtype=np.bool_)
    root_weight, median_weight, cell = np.sqrt(views.weight), views.median_weight, views.cell
    cells = [t.size for t in views.targets]
    for pose in poses:
        chosen = pose[kept[pose]]
        if len(chosen):
            judge_pose(
                chosen,
                views.first,
                cell,
                cells[int(views.target[chosen[0]])],
                residuals,
                root_weight,
                median_weight,
                REJECTION,
                SMALLEST_NOISE_PX,
                MIN_VIEWS_FOR_MEDIAN,
                used,
            )
    return used


@jit("f8[::1], f8")
def median_up_to(values: Float[np.ndarray, " n"], most: float) -> float:
    """Return the median, or `most` where more than half are no less: to count takes a tenth of a median's time."""
    count = 0
    for value in values:
        count += value >= most
    return most if 2 * count > len(values) else np.median(values)


@jit("i8[::1], i8[::1], i8[::1], i8, f8[:, ::1], f8[::1], f8[::1], f8, f8, i8, b1[::1]")
def judge_pose(
    pose: Int[np.ndarray, " k"],
    first: Int[np.ndarray, " bounds"],
    cell: Int[np.ndarray, " n"],
    cells: int,
    residuals: Float[np.ndarray, "2 n"],
    root_weight: Float[np.ndarray, " n"],
    median_weight: Float[np.ndarray, " m"],
    rejection: float,
    smallest_noise_px: float,
    enough: int,
    used: Bool[np.ndarray, " n"],
) -> None:
    """Mark which points of one pose's views count; `cell` lies in [0, cells)."""
    # The points of every cell, one cell after another.
    ends = np.zeros(cells + 1, dtype=np.intp)
    for i in pose:
        for k in range(first[i], first[i + 1]):
            ends[cell[k] + 1] += 1
    ends = np.cumsum(ends)
    place = ends[:-1].copy()
    points = np.empty(ends[cells], dtype=np.intp)
    for i in pose:
        for k in range(first[i], first[i + 1]):
            points[place[cell[k]]] = k
            place[cell[k]] += 1
    u, v = np.zeros(cells), np.zeros(cells)
    systematic = np.zeros(cells)
    spared = np.zeros(cells)
    for c in range(cells):
        at = points[ends[c] : ends[c + 1]]
        if len(at) == 0:
            continue
        if len(at) == 1:
            u[c], v[c] = residuals[0, at[0]], residuals[1, at[0]]
        else:
            u[c], v[c] = np.median(residuals[0][at]), np.median(residuals[1][at])
        systematic[c] = np.sqrt(u[c] ** 2 + v[c] ** 2) * np.mean(root_weight[at])
        if len(at) >= enough:
            spared[c] = systematic[c]
    largest = systematic.max()
    levels = np.empty(len(pose))
    for most in (_JUST_BEYOND * largest / rejection, np.inf):
        for j in range(len(pose)):
            begin, end = first[pose[j]], first[pose[j] + 1]
            distance = np.sqrt(residuals[0, begin:end] ** 2 + residuals[1, begin:end] ** 2)
            floor = smallest_noise_px * np.sqrt(median_weight[pose[j]])
            levels[j] = max(median_up_to(distance * root_weight[begin:end], most), floor)
        limit = rejection * np.median(levels)
        if largest <= limit:
            break
    for i in pose:
        begin, end = first[i], first[i + 1]
        if begin == end:
            continue
        deviation = np.empty(end - begin)
        for k in range(begin, end):
            c = cell[k]
            away = (residuals[0, k] - u[c]) ** 2 + (residuals[1, k] - v[c]) ** 2
            deviation[k - begin] = np.sqrt(away) * root_weight[k]
        median = median_up_to(deviation, _JUST_BEYOND * deviation.max() / rejection)
        of_view = rejection * max(median, smallest_noise_px * np.sqrt(median_weight[i]))
        for k in range(begin, end):
            c = cell[k]
            used[k] = systematic[c] <= limit and deviation[k - begin] <= max(of_view, spared[c])


MIN_OVERLAP = 0.5
"""Of the points that any image of a pose shows: so many must be shown by all."""
MIN_POINTS = 12


def with_common_points(
    views: ViewStack, labels: Int[np.ndarray, " m"]
) -> tuple[ViewStack, Bool[np.ndarray, " m"]]:
    """Return the views without points that not all views of their label and target show, and of each view whether it
    still shows others than these do.
    """
    keep = np.ones(len(views.column), dtype=np.bool_)
    differing = np.zeros(len(views), dtype=np.bool_)
    cell = views.cell
    for pose in groups_of(labels * len(views.targets) + views.target):
        if len(pose) < 2 or is_same_scene(views, pose):
            continue
        shown = [cell[views.part(i)] for i in pose.tolist()]
        # What lies outside the target or is named twice is the checks' to refuse.
        size = views.targets[int(views.target[pose[0]])].size
        if any(len(one) == 0 or one.min() < 0 or one.max() >= size for one in shown):
            continue
        times = np.zeros(size, dtype=np.intp)
        for one in shown:
            times[np.unique(one)] += 1
        common = times == len(pose)
        if common.sum() < max(MIN_OVERLAP * int((times > 0).sum()), MIN_POINTS):
            differing[pose] = True
            continue
        for i, one in zip(pose.tolist(), shown, strict=True):
            keep[views.part(i)] = common[one]
    return (views, differing) if keep.all() else (_kept(views, keep), differing)


def is_same_scene(views: ViewStack, pose: Int[np.ndarray, " g"]) -> bool:
    """Return whether some views of one target show the same points, listed in the same order."""
    count = int(views.counts[pose[0]])
    if np.any(views.counts[pose] != count):
        return False
    cells = views.cell[views.first[pose][:, None] + np.arange(count)]
    return bool(np.all(cells == cells[0]))


def _kept(views: ViewStack, keep: Bool[np.ndarray, " n"]) -> ViewStack:
    return replace(
        views,
        first=np.concatenate([[0], np.cumsum(views.sums(keep.astype(np.float64)).round().astype(np.intp))]),
        column=views.column[keep],
        row=views.row[keep],
        points_px=views.points_px[keep],
        standard_uncertainty_px=views.standard_uncertainty_px[keep],
        points_target=views.points_target[keep],
    )


def sums_of_squared_deviations(
    cell: Int[np.ndarray, " n"],
    residuals: Float[np.ndarray, "2 n"],
    uncertainty: Float[np.ndarray, " n"],
) -> tuple[float, int]:
    """Return Σ (residual - the cell's mean)² over the cell's mean variance, and the number of squares less that of
    means: over the images of a pose, each cell's over those that show it.
    """
    _, place, times = np.unique(cell, return_inverse=True, return_counts=True)
    variance = (np.bincount(place, uncertainty) / times) ** 2
    total = 0.0
    for component in residuals:
        mean = np.bincount(place, component) / times
        total += float(np.sum((component - mean[place]) ** 2 / variance[place]))
    return total, 2 * (len(cell) - len(times))


MAX_POOLED_RATIO = 1.5
"""A point's uncertainty in an image stays as it is where it exceeds the pattern by this factor."""


def with_pooled_variances(views: ViewStack, labels: Int[np.ndarray, " m"]) -> ViewStack:
    """Return the views with uncertainties of one pattern for all views of a label and target."""
    uncertainty = views.standard_uncertainty_px.copy()
    cells = [t.size for t in views.targets]
    changed = False
    for pose in groups_of(labels * len(views.targets) + views.target):
        if len(pose) > 1:
            size = cells[int(views.target[pose[0]])]
            pool_variances(
                pose,
                views.first,
                views.cell,
                size,
                views.standard_uncertainty_px,
                MAX_POOLED_RATIO,
                uncertainty,
            )
            changed = True
    return replace(views, standard_uncertainty_px=uncertainty) if changed else views


@jit("i8[::1], i8[::1], i8[::1], i8, f8[::1], f8, f8[::1]")
def pool_variances(
    pose: Int[np.ndarray, " k"],
    first: Int[np.ndarray, " bounds"],
    cell: Int[np.ndarray, " n"],
    cells: int,
    stated: Float[np.ndarray, " n"],
    own: float,
    result: Float[np.ndarray, " n"],
) -> None:
    """Write the uncertainties of one pose's views, level times pattern, where they are not left as stated.

    The pattern is the mean over the views of each cell's logarithm less the view's mean. What is no positive number or
    no cell of the target stays as it is: that is the checks' to name.
    """
    total, seen = np.zeros(cells), np.zeros(cells)
    levels = np.zeros(len(pose))
    for j in range(len(pose)):
        begin, end = first[pose[j]], first[pose[j] + 1]
        logs = np.zeros(end - begin)
        count = 0
        for k in range(begin, end):
            if 0.0 < stated[k] < np.inf and 0 <= cell[k] < cells:
                logs[k - begin] = np.log(stated[k])
                levels[j] += logs[k - begin]
                count += 1
        levels[j] /= max(count, 1)
        for k in range(begin, end):
            if 0.0 < stated[k] < np.inf and 0 <= cell[k] < cells:
                total[cell[k]] += logs[k - begin] - levels[j]
                seen[cell[k]] += 1.0
    pattern = np.exp(total / np.maximum(seen, 1.0))
    for j in range(len(pose)):
        level = np.exp(levels[j])
        for k in range(first[pose[j]], first[pose[j] + 1]):
            if 0.0 < stated[k] < np.inf and 0 <= cell[k] < cells:
                common = level * pattern[cell[k]]
                if stated[k] <= own * common:
                    result[k] = common
