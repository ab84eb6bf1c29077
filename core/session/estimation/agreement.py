"""Whether one camera explains the images of a focus group: the warning where it does not."""

from __future__ import annotations

import math

from core.errors import Advisory
from core.session.estimate import FocusGroup
from core.session.model import MeasuredPose

WORST = 5
MIN_DISAGREEMENT = 1.5
"""Above this a common camera is called into question, if chance does not explain it."""


def worst_poses(group: FocusGroup) -> list[MeasuredPose]:
    """Return the poses whose images have the largest residuals."""
    return sorted(group.poses, key=lambda pose: -(pose.rms_px or 0.0))[:WORST]


def disagreement(group: FocusGroup) -> Advisory | None:
    """Warn where one camera does not explain the images better than chance would have it."""
    value = group.estimate.disagreement
    # Of χ² with about eight degrees of freedom an image, four standard deviations.
    chance = 1.0 + 4.0 * math.sqrt(2.0 / (8.0 * len(group.poses)))
    if value is None or value <= max(MIN_DISAGREEMENT, chance):
        return None
    worst = ", ".join(pose.measurement_id for pose in worst_poses(group))
    better = f"cameras of their own would fit them better by {value:.1f} times what chance allows"
    if group.estimate.estimator == "given":
        return Advisory(
            "intrinsics_vary_between_images",
            f"The session's intrinsics do not explain the images of focus group {group.name!r}: {better}. Poses take "
            f"them as exact, and no uncertainty contains what they are off by. Worst: {worst}.",
            "Compare them with the camera of estimator=pooled, which the images give by themselves. Intrinsics hold "
            "for one camera, one setting of its lens and one size of its images, neither binned, cropped nor turned.",
        )
    return Advisory(
        "intrinsics_vary_between_images",
        f"One set of intrinsics does not explain the images of focus group {group.name!r}: {better}; uncertainties of "
        f"camera and absolute poses are scaled up by {group.estimate.inflation:.1f}. Repeatability is judged pose by "
        f"pose: what all images of a pose share does not scatter. Worst: {worst}.",
        "Check that all images are of one camera and none is turned, that focus and zoom stayed as they were, and that "
        "the print is flat, as long and as wide as stated; give each camera and setting a focus_group of its own, or "
        "use estimator=pooled_free_focal where the lens refocuses.",
    )
