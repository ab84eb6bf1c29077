"""What is estimated of a session, as values: cameras and poses by focus group, and what is excluded and why."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Int

from core.calibration import GroupEstimate, LensEvidence, ShapePrior, ViewStack
from core.errors import Advisory, NotConverged, listed
from core.session.model import MeasuredPose, SessionData

MIN_OTHER_SETTING = 3
"""Images of a focus group that do not fit its camera, from which on they may be of another setting of the lens."""
TURNED_ADVICE = "Upload turned images as the sensor gave them: the camera's frame turns with them."
_LOOK_ADVICE = "Look at their failures and overlays, and upload better ones of these poses if need be."
_OTHER_SETTING_ADVICE = (
    "Look at their failures and overlays. Sound images that did not converge may be of another setting of the lens "
    "(focus, zoom) or another camera: give these a focus_group of their own. Upload better ones of the others "
    "if need be. " + TURNED_ADVICE
)
_SIZES_ADVICE = (
    "Give each camera setting a focus_group of its own: they count in a camera of their own size. "
    + TURNED_ADVICE
)


@dataclass(frozen=True, slots=True)
class ExcludedMeasurement:
    """A measurement that is not in the figures, and why."""

    measurement_id: str
    code: str
    detail: str


@dataclass(frozen=True, slots=True)
class ExcludedPose:
    """A commanded pose that is not in the figures, and why."""

    pose_id: str
    code: str
    detail: str


@dataclass(frozen=True)
class FocusGroup:
    """One focus group's camera and poses; rows run over its `poses`, which are in the session's order.

    `views` has the points of each image under one labelling of each target, `quarters` by how many quarter turns of
    the target frame that differs from the image's own
    (`core.calibration.multi_view.board_symmetry.symmetry_rotations`): T_image_labelled. `evidence` is that against
    Brown's lens model; None where it was not looked for.
    """

    name: str
    estimate: GroupEstimate
    poses: tuple[MeasuredPose, ...]
    views: ViewStack
    quarters: Int[np.ndarray, " k"]
    evidence: LensEvidence | None = None


@dataclass(frozen=True)
class SessionEstimate:
    """Cameras and poses of a session by one estimator; every image is estimated or excluded.

    `unclear` are images that show another orientation than the first of their pose, however a board that looks the same
    when turned is labelled: estimated, but no visit to their pose. `unsteady` are the poses among whose images the
    camera changed, `differing` those whose images show too different points. `shapes` is what is left open of prints
    whose shape was estimated from the images, by the target's place in the session's list.
    """

    estimator: str
    groups: tuple[FocusGroup, ...]
    poses: tuple[MeasuredPose, ...]
    excluded: Mapping[str, ExcludedMeasurement]
    warnings: tuple[Advisory, ...]
    unclear: Mapping[str, ExcludedMeasurement]
    unsteady: frozenset[str]
    differing: frozenset[str]
    shapes: Mapping[int, ShapePrior] = field(default_factory=dict)


def in_order(data: SessionData, groups: Sequence[FocusGroup]) -> tuple[MeasuredPose, ...]:
    """Return the poses of all groups in the session's order."""
    place = {image.measurement_id: i for i, image in enumerate(data.images)}
    poses = (pose for group in groups for pose in group.poses)
    return tuple(sorted(poses, key=lambda pose: place[pose.measurement_id]))


def exclusion_warnings(data: SessionData, excluded: Mapping[str, ExcludedMeasurement]) -> list[Advisory]:
    """Say which images of an analysis are excluded, by the codes of the reasons."""
    if not excluded:
        return []
    reasons: dict[str, list[str]] = {}
    for image in data.images:
        if image.measurement_id in excluded:
            reasons.setdefault(excluded[image.measurement_id].code, []).append(image.measurement_id)
    found = "; ".join(f"{code} ({len(ids)}): {listed(ids)}" for code, ids in sorted(reasons.items()))
    verb = "is" if len(excluded) == 1 else "are"
    return [
        Advisory(
            "images_excluded",
            f"{len(excluded)} of {len(data.images)} images {verb} not in the figures: {found}.",
            _advice(data, excluded, set(reasons)),
        )
    ]


def _advice(data: SessionData, excluded: Mapping[str, ExcludedMeasurement], reasons: set[str]) -> str | None:
    advice = [_SIZES_ADVICE] if "image_size_differs" in reasons else []
    unlike = Counter(
        image.focus_group
        for image in data.images
        if image.measurement_id in excluded and excluded[image.measurement_id].code == NotConverged.code
    )
    if any(count >= MIN_OTHER_SETTING for count in unlike.values()):
        advice.append(_OTHER_SETTING_ADVICE)
    elif reasons - {"image_size_differs", "excluded_by_user"}:
        advice.append(_LOOK_ADVICE)
    return " ".join(advice) or None
