"""From stored grid points to the camera's pose in every image: focus group by focus group, nothing dropped unsaid."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from app.records.codec import decode_stack
from app.services.analyses.board_readings import GroupPoses, read_alike
from app.services.analyses.naming import naming_remarks
from app.services.analyses.outcome import CannotAnalyse
from app.services.analyses.snapshot import Image, Snapshot, natural
from core import Advisory, Camera, GridposeError, Lens, TargetSpec
from core.calibration.estimators import GroupEstimate, estimate_group

POINTS_AT_MOST = 4_000_000
"""Grid points of one analysis, which takes some 450 bytes for each."""
_BYTES_PER_POINT = 45
WORST = 5
NAMED = 5
_UNCLEAR = (
    "The image shows another orientation than the first of its pose, whichever way the board, which looks the same "
    "when turned, is read."
)
DISAGREEMENT = 1.5
"""Above this a common camera is called into question, if chance does not explain it."""


@dataclass(frozen=True, slots=True)
class Exclusion:
    """An image that is not in the figures, and why."""

    measurement_id: str
    code: str
    detail: str


@dataclass(frozen=True, slots=True)
class EstimatedImage:
    """Where the camera was in one image: x, y, z (mm) and orientation in the target frame, with `estimators`'
    covariances.
    """

    image: Image
    position_mm: Float[np.ndarray, "3"]
    rotation: Float[np.ndarray, "3 3"]
    covariance: Float[np.ndarray, "6 6"]
    scatter: Float[np.ndarray, "6 6"]
    common: Float[np.ndarray, "6 9"]
    rms_px: float

    @property
    def measurement_id(self) -> str:
        return self.image.measurement_id

    @property
    def cycle(self) -> int | None:
        return self.image.cycle


@dataclass(frozen=True, slots=True)
class FocusGroup:
    """One focus group's camera, and its images in the session's order.

    `estimate` is in the frames of the boards as each image's reading had them, `images` in those of one reading.
    """

    name: str
    estimate: GroupEstimate
    images: tuple[EstimatedImage, ...]


@dataclass(frozen=True, slots=True)
class SessionEstimate:
    """All that the images of a session say by one estimator; every image is estimated or excluded."""

    groups: tuple[FocusGroup, ...]
    images: tuple[EstimatedImage, ...]
    excluded: Mapping[str, Exclusion]
    warnings: tuple[Advisory, ...]
    unclear: Mapping[str, Exclusion]
    """Images that show another orientation than their pose's first, however a board that looks the same turned is read:
    estimated, but no visit to their pose."""
    unsteady: frozenset[str]
    """Poses whose images one camera does not explain: it changed from cycle to cycle, and they scatter by that too."""
    differing: frozenset[str] = frozenset()
    """Poses whose images show too different points: what print and lens lack makes these scatter, too."""


def estimate_session(snapshot: Snapshot, points: Mapping[str, bytes], estimator: str) -> SessionEstimate:
    """Estimate the camera's pose in every finished image.

    Raises CannotAnalyse where not a single image serves.
    """
    _check(snapshot, estimator)
    excluded: dict[str, Exclusion] = {}
    found: dict[str, list[Image]] = {}
    for image in snapshot.images:
        if image.measurement_id in points:
            found.setdefault(image.focus_group, []).append(image)
        else:
            _exclude(excluded, image, image.failure_code or "no_points", image.failure_detail or "No points.")
    warnings: list[Advisory] = []
    failures: list[GridposeError] = []
    estimates: list[GroupPoses] = []
    for name in sorted(found):
        images = _of_one_size(name, found[name], excluded, warnings)
        try:
            estimates.append(_estimate(name, images, snapshot, points, estimator, excluded))
        except GridposeError as failure:
            failures.append(failure)
            for image in images:
                if image.measurement_id not in excluded:
                    _exclude(excluded, image, failure.code, failure.detail)
    if not estimates:
        raise _nothing(snapshot, excluded, failures)
    alike = read_alike(snapshot, estimates)
    groups = [
        FocusGroup(read.name, read.estimate, _images(turned))
        for read, turned in zip(estimates, alike.groups, strict=True)
    ]
    doubts = {group.name: _disagreement(group) for group in groups}
    warnings += [
        warning
        for group in groups
        for warning in group.estimate.warnings
        if not (warning.code == "residuals_correlated" and doubts[group.name])  # which says more
    ]
    warnings += [doubt for doubt in doubts.values() if doubt is not None]
    unsteady = frozenset(pose_id for group in groups for pose_id in _unsteady(group))
    if unsteady:
        warnings.append(_unsteady_remark(unsteady))
    differing = frozenset(
        e.image.pose_id
        for group in groups
        for e, one in zip(group.images, group.estimate.differing.tolist(), strict=True)
        if one
    )
    if differing:
        warnings.append(_differing_remark(differing))
    place = {image.measurement_id: i for i, image in enumerate(snapshot.images)}
    everything = sorted(
        (image for group in groups for image in group.images), key=lambda e: place[e.image.measurement_id]
    )
    return SessionEstimate(
        tuple(groups),
        tuple(everything),
        excluded,
        (
            *warnings,
            *naming_remarks(
                snapshot,
                [i for i in snapshot.images if i.measurement_id in excluded and i.origin == "unknown"],
            ),
            *alike.remarks,
            *_exclusion_remarks(snapshot, excluded),
        ),
        {one: Exclusion(one, "orientation_unclear", _UNCLEAR) for one in sorted(alike.unclear)},
        unsteady,
        differing,
    )


def _check(snapshot: Snapshot, estimator: str) -> None:
    if not snapshot.images:
        raise CannotAnalyse(
            "too_few_measurements",
            f"None of the session's images is measured yet; {snapshot.pending} are waiting."
            if snapshot.pending
            else "The session has no images.",
            "Ask again when the session's queued and running counts are lower."
            if snapshot.pending
            else "Upload images of the target first.",
        )
    if estimator == "given" and snapshot.intrinsics is None:
        raise CannotAnalyse(
            "intrinsics_missing",
            "The estimator `given` takes the session's intrinsics, and the session has none.",
            "PATCH the session with intrinsics, or choose another estimator.",
        )
    size = sum(image.point_bytes or 0 for image in snapshot.images) // _BYTES_PER_POINT
    if size > POINTS_AT_MOST:
        raise CannotAnalyse(
            "too_many_measurements",
            f"The session's images hold {size} grid points; one analysis takes {POINTS_AT_MOST}.",
            "Divide the images among several sessions.",
        )


def _exclude(excluded: dict[str, Exclusion], image: Image, code: str, detail: str) -> None:
    excluded[image.measurement_id] = Exclusion(image.measurement_id, code, detail)


def _of_one_size(
    name: str, images: list[Image], excluded: dict[str, Exclusion], warnings: list[Advisory]
) -> list[Image]:
    """Return the images of the size that most have; a group without such a size cannot share a camera."""
    sizes = Counter((image.width_px, image.height_px) for image in images)
    if len(sizes) == 1:
        return images
    (width, height), most = max(sizes.items(), key=lambda item: (item[1], item[0]))
    listed = ", ".join(f"{w} x {h} ({count})" for (w, h), count in sorted(sizes.items()))
    if 2 * most <= len(images):
        raise CannotAnalyse(
            "mixed_image_sizes",
            f"The images of focus group {name!r} have several sizes, none of them most images': {listed}.",
            "Images of one focus group share a camera: give each camera setting a focus_group of its own, in a new "
            "session if need be.",
        )
    for image in images:
        if (image.width_px, image.height_px) != (width, height):
            detail = (
                f"The image has {image.width_px} x {image.height_px} px, its focus group {width} x {height}."
            )
            _exclude(excluded, image, "image_size_differs", detail)
    warnings.append(
        Advisory(
            "image_size_differs",
            f"The images of focus group {name!r} have several sizes: {listed}. Those of {width} x {height} px "
            "are used.",
            "Give each camera setting a focus_group of its own.",
        )
    )
    return [image for image in images if image.measurement_id not in excluded]


def _estimate(
    name: str,
    images: list[Image],
    snapshot: Snapshot,
    points: Mapping[str, bytes],
    estimator: str,
    excluded: dict[str, Exclusion],
) -> GroupPoses:
    estimate = estimate_group(
        decode_stack(
            [points[image.measurement_id] for image in images],
            [TargetSpec(**target) for target in snapshot.targets],
            [image.target for image in images],
            images[0].width_px,
            images[0].height_px,
        ),
        estimator,
        lens=Lens(**snapshot.lens) if snapshot.lens is not None else None,
        intrinsics=Camera(**snapshot.intrinsics) if snapshot.intrinsics is not None else None,
        repeats=[(image.pose_id, image.target) for image in images],
    )
    for i, failure in estimate.failures:
        _exclude(excluded, images[i], failure.code, failure.detail)
    return GroupPoses(name, tuple(images[i] for i in estimate.images.tolist()), estimate)


def _images(group: GroupPoses) -> tuple[EstimatedImage, ...]:
    estimate = group.estimate
    return tuple(
        map(
            EstimatedImage,
            group.images,
            estimate.positions_mm,
            estimate.rotations,
            estimate.covariance,
            estimate.scatter,
            estimate.common,
            estimate.rms_px.tolist(),
        )
    )


def _nothing(
    snapshot: Snapshot, excluded: Mapping[str, Exclusion], failures: list[GridposeError]
) -> CannotAnalyse:
    reasons = Counter(exclusion.code for exclusion in excluded.values())
    if failures and len({failure.code for failure in failures}) == 1:
        code, count = failures[0].code, reasons[failures[0].code]
        if 2 * count >= len(snapshot.images):
            return CannotAnalyse(code, failures[0].detail, failures[0].advice)
    listed = ", ".join(f"{code} ({count})" for code, count in sorted(reasons.items()))
    return CannotAnalyse(
        "nothing_usable",
        f"None of the {len(snapshot.images)} measured images serves this analysis: {listed}.",
        "Look at the measurements' failures and overlays; show the whole grid, sharp, evenly lit, and tilted.",
    )


def worst_images(group: FocusGroup) -> list[EstimatedImage]:
    """Return the images with the largest residuals."""
    return sorted(group.images, key=lambda e: -e.rms_px)[:WORST]


def _disagreement(group: FocusGroup) -> Advisory | None:
    """Warn where one camera does not explain the images better than chance would have it."""
    value = group.estimate.disagreement
    # Of χ² with about eight degrees of freedom an image, four standard deviations.
    chance = 1.0 + 4.0 * math.sqrt(2.0 / (8.0 * len(group.images)))
    if value is None or value <= max(DISAGREEMENT, chance):
        return None
    listed = ", ".join(e.image.measurement_id for e in worst_images(group))
    what = "given intrinsics" if group.estimate.estimator == "given" else "set of intrinsics"
    return Advisory(
        "intrinsics_not_common",
        f"One {what} does not explain the images of focus group {group.name!r}: cameras of their own would fit them "
        f"better by {value:.1f} times what chance allows; uncertainties of camera and absolute poses are scaled up by "
        f"{group.estimate.inflation:.1f}. Repeatability is judged pose by pose: what all images of a pose share does "
        f"not scatter. Worst: {listed}.",
        "Check that focus and zoom stayed as they were and that the print is flat; give each setting a focus_group of "
        "its own, or use estimator=pooled_free_focal where the lens refocuses.",
    )


def _unsteady(group: FocusGroup) -> set[str]:
    """Return the poses among whose images the camera changed."""
    told = group.estimate.unsteady.tolist()
    return {e.image.pose_id for e, one in zip(group.images, told, strict=True) if one}


def _unsteady_remark(poses: frozenset[str]) -> Advisory:
    listed = sorted(poses, key=natural)
    named = ", ".join(listed[:NAMED]) + (", ..." if len(listed) > NAMED else "")
    return Advisory(
        "camera_not_steady",
        f"The camera was not the same in all images of {len(listed)} poses: {named}. Their scatter is not the robot's "
        "alone, and no figure of theirs is said to be.",
        "Switch automatic focus, zoom and image stabilisation off; or use estimator=pooled_free_focal where the lens "
        "refocuses between images.",
    )


def _differing_remark(poses: frozenset[str]) -> Advisory:
    listed = sorted(poses, key=natural)
    named = ", ".join(listed[:NAMED]) + (", ..." if len(listed) > NAMED else "")
    return Advisory(
        "points_differ",
        f"The images of {len(listed)} poses show so different grid points that less than half of them are common: "
        f"{named}. A print that is not flat or a lens beyond its model moves such images against one another, and no "
        "figure of these poses is said to be the robot's.",
        "Keep the same part of the board in view in all cycles of a pose; leave out images in which much is hidden.",
    )


def _exclusion_remarks(snapshot: Snapshot, excluded: Mapping[str, Exclusion]) -> list[Advisory]:
    if not excluded:
        return []
    reasons: dict[str, list[str]] = {}
    for image in snapshot.images:
        if image.measurement_id in excluded:
            reasons.setdefault(excluded[image.measurement_id].code, []).append(image.measurement_id)
    listed = "; ".join(
        f"{code} ({len(ids)}): {', '.join(ids[:NAMED])}{', ...' if len(ids) > NAMED else ''}"
        for code, ids in sorted(reasons.items())
    )
    return [
        Advisory(
            "images_excluded",
            f"{len(excluded)} of {len(snapshot.images)} measured images are not in the figures: {listed}.",
            "Look at their failures and overlays, and upload better ones of these poses if need be.",
        )
    ]
