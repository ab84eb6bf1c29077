"""Which images the methods are compared on: those of one camera setting, and of thousands a sample that is always the
same.

Some methods take milliseconds an image, and one analysis is computed at a time. So of more than `IMAGES_AT_MOST` images
(or so many that they hold more than `POINTS_AT_MOST` grid points) every pose keeps as many as the others, evenly over
its cycles; of more than `POSES_AT_MOST` poses those with the most images are kept, and among equals some evenly over
all of them in their natural order. Nothing is drawn by chance, and nothing depends on when an image came.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

from app.services.analyses.snapshot import Image, Snapshot
from core import Advisory
from core.calibration.baselines.comparison import evenly

IMAGES_AT_MOST = 600
POINTS_AT_MOST = 120_000
POSES_AT_MOST = 100
_BYTES_PER_POINT = 45


@dataclass(frozen=True, slots=True)
class Chosen:
    """The images to compare on, in the session's order; `poses` holds each one's pose, or None where it counts for the
    calibration only, since it shows another target than most of the pose's.
    """

    focus_group: str | None
    images: tuple[Image, ...]
    poses: tuple[str | None, ...]
    warnings: tuple[Advisory, ...]


def choose_images(snapshot: Snapshot, points: Mapping[str, bytes]) -> Chosen:
    """Return what to compare on; no images where there are none with grid points."""
    seen = [image for image in snapshot.images if image.measurement_id in points]
    if not seen:
        return Chosen(None, (), (), ())
    warnings = _without_points(snapshot, len(seen))
    settings = Counter((i.focus_group, i.width_px, i.height_px) for i in seen)
    chosen = min(settings, key=lambda setting: (-settings[setting], setting))
    warnings += _other_settings(settings, chosen)
    alike = [i for i in seen if (i.focus_group, i.width_px, i.height_px) == chosen]
    images = _sample(alike)
    if len(images) < len(alike):
        warnings.append(
            Advisory(
                "images_sampled",
                f"Compared are {len(images)} of {len(alike)} images, at {len({i.pose_id for i in images})} of "
                f"{len({i.pose_id for i in alike})} poses: evenly over the cycles of each pose, always the same ones.",
                "For all of them see intrinsics and repeatability.",
            )
        )
    poses = _poses(images)
    others = sum(pose is None for pose in poses)
    if others:
        warnings.append(
            Advisory(
                "other_target",
                f"{others} images show another of the session's targets than most of their pose do, and count for the "
                "calibration only.",
            )
        )
    return Chosen(chosen[0], tuple(images), tuple(poses), tuple(warnings))


def _without_points(snapshot: Snapshot, seen: int) -> list[Advisory]:
    reasons = Counter(i.failure_code or "no_points" for i in snapshot.images if not i.point_bytes)
    if not reasons:
        return []
    listed = ", ".join(f"{code} ({count})" for code, count in sorted(reasons.items()))
    return [
        Advisory(
            "images_without_points",
            f"{len(snapshot.images) - seen} of {len(snapshot.images)} measured images have no grid points, and no "
            f"method has them: {listed}.",
            "Look at their failures and overlays, and upload better ones of these poses if need be.",
        )
    ]


def _other_settings(
    settings: Mapping[tuple[str, int, int], int], chosen: tuple[str, int, int]
) -> list[Advisory]:
    if len(settings) == 1:
        return []
    listed = ", ".join(
        f"{name!r} of {width} x {height} px ({count})"
        for (name, width, height), count in sorted(settings.items())
        if (name, width, height) != chosen
    )
    return [
        Advisory(
            "other_camera_settings",
            f"Compared are the images of focus group {chosen[0]!r} of {chosen[1]} x {chosen[2]} px, which has the "
            f"most; left out: {listed}.",
            "Methods are compared on images of one camera setting: put others into sessions of their own.",
        )
    ]


def _sample(images: list[Image]) -> list[Image]:
    """Return as many images as can be compared in time, in the same order."""
    of_pose: dict[str, list[Image]] = {}
    for image in images:
        of_pose.setdefault(image.pose_id, []).append(image)
    poses = _most_visited({pose: len(members) for pose, members in of_pose.items()})
    points = sum(image.point_bytes or 0 for image in images) // _BYTES_PER_POINT
    at_most = max(2, min(IMAGES_AT_MOST, POINTS_AT_MOST * len(images) // max(points, 1)))
    each = max(len(of_pose[pose]) for pose in poses)
    while each > 1 and sum(min(len(of_pose[pose]), each) for pose in poses) > at_most:
        each -= 1
    return [of_pose[pose][k] for pose in poses for k in evenly(len(of_pose[pose]), each)]


def _most_visited(visits: Mapping[str, int]) -> list[str]:
    """Return the poses with the most images, in their order; among those with equally many, some evenly over them."""
    if len(visits) <= POSES_AT_MOST:
        return list(visits)
    least = sorted(visits.values(), reverse=True)[POSES_AT_MOST - 1]
    more = {pose for pose, count in visits.items() if count > least}
    equal = [pose for pose, count in visits.items() if count == least]
    kept = more | {equal[k] for k in evenly(len(equal), POSES_AT_MOST - len(more))}
    return [pose for pose in visits if pose in kept]


def _poses(images: list[Image]) -> list[str | None]:
    """Return each image's pose, None where it shows another target than most of its pose's images."""
    targets: dict[str, Counter[int]] = {}
    for image in images:
        targets.setdefault(image.pose_id, Counter())[image.target] += 1
    main = {pose: min(counts, key=lambda t: (-counts[t], t)) for pose, counts in targets.items()}
    return [image.pose_id if image.target == main[image.pose_id] else None for image in images]
