"""Selection of the images on which methods are compared: one camera setting, and a reproducible sample of many.

Some methods take milliseconds an image, and one analysis is computed at a time. So of more than `MAX_IMAGES` images
(or so many that they hold more than `MAX_POINTS` grid points) every pose keeps as many as the others, evenly over
its cycles; of more than `MAX_POSES` poses those with the most images are kept, and among equals some evenly over
all of them in their natural order. Nothing is drawn by chance, and nothing depends on when an image came.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Int

from core.calibration import ViewStack, evenly
from core.errors import Advisory
from core.session.estimate import ExcludedMeasurement
from core.session.model import CameraViews, ImageObservation, SessionData

MAX_IMAGES = 600
MAX_POINTS = 120_000
MAX_POSES = 100
_OTHER_SETTING = "It is of another camera setting than the images that are compared."
_SAMPLED = "Of so many images an even sample is compared."


@dataclass(frozen=True)
class SelectedImages:
    """The images to compare on, in the session's order: their places in it and their grid points.

    `pose_ids` holds each one's pose, or None where it counts for the calibration only, since it shows another target
    than most of the pose's. `excluded` are the session's other images.
    """

    focus_group: str
    images: Int[np.ndarray, " k"]
    views: ViewStack
    pose_ids: tuple[str | None, ...]
    excluded: tuple[ExcludedMeasurement, ...]
    warnings: tuple[Advisory, ...]

    def session(self, data: SessionData) -> SessionData:
        """Return the session of these images alone."""
        return replace(
            data,
            images=tuple(data.images[i] for i in self.images.tolist()),
            views=(CameraViews(self.focus_group, np.arange(len(self.images)), self.views),),
        )


def select_images(data: SessionData) -> SelectedImages | None:
    """Return what to compare on; None where there are no images with grid points."""
    if not data.views:
        return None
    chosen = min(data.views, key=lambda group: (-len(group.images), _setting(group)))
    warnings = [*_without_points(data), *_other_settings(data.views, chosen)]
    of_setting = [data.images[i] for i in chosen.images.tolist()]
    rows = _sample(of_setting, chosen.views.counts.tolist())
    images = [of_setting[k] for k in rows]
    if len(images) < len(of_setting):
        warnings.append(
            Advisory(
                "images_sampled",
                f"Compared are {len(images)} of {len(of_setting)} images, at {len({i.pose_id for i in images})} of "
                f"{len({i.pose_id for i in of_setting})} poses: evenly over the cycles of each pose, always the "
                "same ones.",
                "For all of them see intrinsics and repeatability.",
            )
        )
    pose_ids = _poses(images)
    others = sum(pose_id is None for pose_id in pose_ids)
    if others:
        warnings.append(
            Advisory(
                "images_of_other_target",
                f"{others} images show another of the session's targets than most of their pose do, and count for the "
                "calibration only.",
                "To have figures of their positions, give them a pose of their own.",
            )
        )
    return SelectedImages(
        chosen.focus_group,
        chosen.images[rows],
        chosen.views.take(rows),
        tuple(pose_ids),
        tuple(_excluded(data, chosen, set(chosen.images[rows].tolist()))),
        tuple(warnings),
    )


def _excluded(data: SessionData, chosen: CameraViews, selected: set[int]) -> Iterator[ExcludedMeasurement]:
    """Yield the images that no method is given, and why."""
    observed, of_setting = data.observed(), set(chosen.images.tolist())
    for i, image in enumerate(data.images):
        if i in selected:
            continue
        name = image.measurement_id
        if i not in observed:
            detail = image.failure_detail or "No points."
            yield ExcludedMeasurement(name, image.failure_code or "no_points", detail)
        elif i not in of_setting:
            yield ExcludedMeasurement(name, "images_of_other_focus_group", _OTHER_SETTING)
        else:
            yield ExcludedMeasurement(name, "images_sampled", _SAMPLED)


def _setting(group: CameraViews) -> tuple[str, int, int]:
    return group.focus_group, group.views.image_width_px, group.views.image_height_px


def _without_points(data: SessionData) -> list[Advisory]:
    observed = data.observed()
    reasons = Counter(
        image.failure_code or "no_points" for i, image in enumerate(data.images) if i not in observed
    )
    if not reasons:
        return []
    found = ", ".join(f"{code} ({count})" for code, count in sorted(reasons.items()))
    return [
        Advisory(
            "images_without_points",
            f"{len(data.images) - len(observed)} of {len(data.images)} measured images have no grid points, and no "
            f"method has them: {found}.",
            "Look at their failures and overlays, and upload better ones of these poses if need be.",
        )
    ]


def _other_settings(groups: Sequence[CameraViews], chosen: CameraViews) -> list[Advisory]:
    if len(groups) == 1:
        return []
    name, width, height = _setting(chosen)
    others = ", ".join(
        f"{n!r} of {w} x {h} px ({count})"
        for (n, w, h), count in sorted((_setting(g), len(g.images)) for g in groups if g is not chosen)
    )
    as_many = sum(len(group.images) == len(chosen.images) for group in groups) > 1
    why = "the first of those with the most images" if as_many else "which has the most"
    return [
        Advisory(
            "images_of_other_focus_group",
            f"Compared are the {len(chosen.images)} images of focus group {name!r} of {width} x {height} px, {why}; "
            f"excluded: {others}.",
            "Methods are compared on images of one camera setting: put others into sessions of their own.",
        )
    ]


def _sample(images: Sequence[ImageObservation], points: Sequence[int]) -> list[int]:
    """Return the places of as many images as can be compared in time, in the same order."""
    of_pose: dict[str, list[int]] = {}
    for k, image in enumerate(images):
        of_pose.setdefault(image.pose_id, []).append(k)
    poses = _most_visited({pose: len(members) for pose, members in of_pose.items()})
    at_most = max(2, min(MAX_IMAGES, MAX_POINTS * len(images) // max(sum(points), 1)))
    each = max(len(of_pose[pose]) for pose in poses)
    while each > 1 and sum(min(len(of_pose[pose]), each) for pose in poses) > at_most:
        each -= 1
    return [k for pose in poses for k in evenly(of_pose[pose], each)]


def _most_visited(visits: Mapping[str, int]) -> list[str]:
    """Return the poses with the most images, in their order; among those with equally many, some evenly over them."""
    if len(visits) <= MAX_POSES:
        return list(visits)
    least = sorted(visits.values(), reverse=True)[MAX_POSES - 1]
    more = {pose for pose, count in visits.items() if count > least}
    equal = [pose for pose, count in visits.items() if count == least]
    kept = more | set(evenly(equal, MAX_POSES - len(more)))
    return [pose for pose in visits if pose in kept]


def _poses(images: Sequence[ImageObservation]) -> list[str | None]:
    """Return each image's pose, None where it shows another target than most of its pose's images."""
    targets: dict[str, Counter[int]] = {}
    for image in images:
        targets.setdefault(image.pose_id, Counter())[image.target] += 1
    main = {pose: min(counts, key=lambda t: (-counts[t], t)) for pose, counts in targets.items()}
    return [image.pose_id if image.target == main[image.pose_id] else None for image in images]
