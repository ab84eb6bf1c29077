"""Which grid points count, decided for all images of one pose together.

What a print that is not flat or a wrong principal point leaves in the residuals of a grid point is the same in every
image of a pose. Judged image by image, a point near the limit would count in some and not in others, and the pose would
jump between two sets of points by more than any residual tells. So the systematic part, the median residual of a
grid point over the pose's images, is judged once for all of them, and of each image only what deviates from it.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from core.calibration.model import SMALLEST_NOISE_PX
from core.least_squares import REJECTION
from core.targets.specification import GridPoints, TargetSpec

ENOUGH_FOR_MEDIAN = 3
"""Images of a point from which on a gross error in one of them leaves the median alone."""


@dataclass(frozen=True, slots=True)
class Repeats:
    """Images of one pose: which views they are, and of each its points' places among all that the pose shows."""

    views: tuple[int, ...]
    places: tuple[Int[np.ndarray, " _"], ...]
    root_weights: tuple[Float[np.ndarray, " _"], ...]  # 1/u
    count: int


def find_repeats(views: Sequence[GridPoints], labels: Sequence[Hashable] | None) -> tuple[Repeats, ...]:
    """Sort views by label, and by target; without labels every view is by itself."""
    members: dict[tuple[Hashable, TargetSpec], list[int]] = {}
    for i, view in enumerate(views):
        members.setdefault((i if labels is None else labels[i], view.target), []).append(i)
    return tuple(_repeats(views, group) for group in members.values())


def _repeats(views: Sequence[GridPoints], group: list[int]) -> Repeats:
    cells = [views[i].row * views[i].target.columns + views[i].column for i in group]
    different, place = np.unique(np.concatenate(cells), return_inverse=True)
    ends = np.cumsum([len(c) for c in cells])
    return Repeats(
        tuple(group),
        tuple(np.split(place, ends[:-1])),
        tuple(1.0 / views[i].standard_uncertainty_px for i in group),
        len(different),
    )


def inliers_of(
    repeats: Sequence[Repeats], residuals: Sequence[Float[np.ndarray, "2 _"]], kept: Bool[np.ndarray, " m"]
) -> tuple[Bool[np.ndarray, " _"], ...]:
    """Return for every view which of its points count; none of views that are not `kept`.

    A point is out in all images of a pose where its median residual lies beyond the rejection's distance of these
    images' residuals, and out in one image where it deviates from that median by more than the rejection's distance of
    that image's deviations, and by more than the median itself: to leave a point out of one image moves its pose by
    what is systematic in the point, to keep it by what deviates.
    """
    used = [np.zeros(r.shape[1], dtype=np.bool_) for r in residuals]
    for pose in repeats:
        chosen = [k for k, i in enumerate(pose.views) if kept[i]]
        if not chosen:
            continue
        place = np.concatenate([pose.places[k] for k in chosen])
        root = np.concatenate([pose.root_weights[k] for k in chosen])
        stacked = np.concatenate([residuals[pose.views[k]] for k in chosen], axis=1)
        size = np.bincount(place, minlength=pose.count)
        median = np.stack([_medians(component, place, size) for component in stacked])
        weight = np.bincount(place, root, minlength=pose.count) / np.maximum(size, 1)
        systematic = np.hypot(*median) * weight
        levels, floors = [], []
        for k in chosen:
            floors.append(SMALLEST_NOISE_PX * float(np.median(pose.root_weights[k])))
            levels.append(float(np.median(np.hypot(*residuals[pose.views[k]]) * pose.root_weights[k])))
        common = systematic <= REJECTION * float(np.median(np.maximum(levels, floors)))
        spared = np.where(size >= ENOUGH_FOR_MEDIAN, systematic, 0.0)
        for k, floor in zip(chosen, floors, strict=True):
            i, at = pose.views[k], pose.places[k]
            deviation = np.hypot(*(residuals[i] - median[:, at])) * pose.root_weights[k]
            limit = REJECTION * max(float(np.median(deviation)), floor)
            used[i] = common[at] & (deviation <= np.maximum(limit, spared[at]))
    return tuple(used)


def _medians(
    values: Float[np.ndarray, " n"], place: Int[np.ndarray, " n"], size: Int[np.ndarray, " p"]
) -> Float[np.ndarray, " p"]:
    """Return the median of the values at each place; anything where there is none."""
    order = np.lexsort((values, place))
    first = np.cumsum(size) - size
    last = len(order) - 1
    low = order[np.clip(first + (size - 1) // 2, 0, last)]
    high = order[np.clip(first + size // 2, 0, last)]
    return np.asarray(0.5 * (values[low] + values[high]))
