"""Which grid points count, decided for all images of one pose together.

What a print that is not flat or a wrong principal point leaves in the residuals of a grid point is the same in every
image of a pose. Judged image by image, a point near the limit would count in some and not in others, and the pose would
jump between two sets of points by more than any residual tells. So the systematic part, the median residual of a
grid point over the pose's images, is judged once for all of them, and of each image only what deviates from it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from core.calibration.in_parts import in_two_parts
from core.calibration.model import SMALLEST_NOISE_PX
from core.calibration.view_stack import ViewStack, groups_of
from core.compiled import compiled
from core.least_squares import REJECTION

ENOUGH_FOR_MEDIAN = 3
"""Images of a point from which on a gross error in one of them leaves the median alone."""


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

    def judge(begin: int, stop: int) -> None:
        for pose in poses[begin:stop]:
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
                    ENOUGH_FOR_MEDIAN,
                    used,
                )

    in_two_parts(judge, len(poses), len(used))
    return used


@compiled
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
    levels = np.empty(len(pose))
    floors = np.empty(len(pose))
    for j in range(len(pose)):
        begin, end = first[pose[j]], first[pose[j] + 1]
        distance = np.empty(end - begin)
        for k in range(begin, end):
            points[place[cell[k]]] = k
            place[cell[k]] += 1
            distance[k - begin] = np.sqrt(residuals[0, k] ** 2 + residuals[1, k] ** 2) * root_weight[k]
        floors[j] = smallest_noise_px * np.sqrt(median_weight[pose[j]])
        levels[j] = max(np.median(distance), floors[j])
    limit = rejection * np.median(levels)
    u, v = np.zeros(cells), np.zeros(cells)
    common = np.zeros(cells, dtype=np.bool_)
    spared = np.zeros(cells)
    for c in range(cells):
        at = points[ends[c] : ends[c + 1]]
        if len(at) == 0:
            continue
        if len(at) == 1:
            u[c], v[c] = residuals[0, at[0]], residuals[1, at[0]]
        else:
            u[c], v[c] = np.median(residuals[0][at]), np.median(residuals[1][at])
        systematic = np.sqrt(u[c] ** 2 + v[c] ** 2) * np.mean(root_weight[at])
        common[c] = systematic <= limit
        if len(at) >= enough:
            spared[c] = systematic
    for j in range(len(pose)):
        begin, end = first[pose[j]], first[pose[j] + 1]
        deviation = np.empty(end - begin)
        for k in range(begin, end):
            c = cell[k]
            away = (residuals[0, k] - u[c]) ** 2 + (residuals[1, k] - v[c]) ** 2
            deviation[k - begin] = np.sqrt(away) * root_weight[k]
        of_view = rejection * max(np.median(deviation), floors[j])
        for k in range(begin, end):
            c = cell[k]
            used[k] = common[c] and deviation[k - begin] <= max(of_view, spared[c])
