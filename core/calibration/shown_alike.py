"""Images of one pose estimated from the same grid points, where they show different ones.

What is systematic in a point's residual, a bowed print's or a lens's beyond the model, moves the pose by its leverage.
It moves all images of a pose alike as long as they show the same points; where a cable hides half of a board bowed by
.3 mm in every other cycle, the pose jumps between two places, and the jump reads as the robot's. So the images of a
pose are estimated from the points that all of them show, if these are at least half of those that any of them shows.
Where they are not, all points are kept, and the pose is named.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int

from core.calibration.view_stack import ViewStack, groups_of

SHARE = 0.5
"""Of the points that any image of a pose shows: so many must be shown by all."""
LEAST_POINTS = 12


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
        if len(pose) < 2 or show_the_same(views, pose):
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
        if common.sum() < max(SHARE * int((times > 0).sum()), LEAST_POINTS):
            differing[pose] = True
            continue
        for i, one in zip(pose.tolist(), shown, strict=True):
            keep[views.part(i)] = common[one]
    return (views, differing) if keep.all() else (_kept(views, keep), differing)


def show_the_same(views: ViewStack, pose: Int[np.ndarray, " g"]) -> bool:
    """Tell whether some views of one target show the same points, listed in the same order."""
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


def squares_about_mean(
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
