"""Where a common fit of many views starts: images of one pose show nearly the same, so one start serves them all."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from core.calibration import closed_form
from core.calibration.homography import estimate_homography
from core.calibration.model import centred
from core.calibration.shared_lens import Placement
from core.calibration.validity import LARGEST_RATIO, check_points
from core.camera import Camera, project, undistort_points
from core.errors import DegenerateGeometry, GridposeError
from core.targets.specification import GridPoints

NEAR = 0.02
"""Of the image's width: views whose points lie within this of one another's have one start."""


@dataclass(frozen=True, slots=True)
class Alike:
    """Views that can be fitted, by their indices; each with the `leader` whose start it takes, itself or another, and
    the leaders' homographies. The others are in `failures`, with the reason.
    """

    usable: list[int]
    leader: dict[int, int]
    homographies: dict[int, Float[np.ndarray, "3 3"]]
    failures: dict[int, GridposeError]


def find_alike(views: Sequence[GridPoints], labels: Sequence[Hashable], *, least: int) -> Alike:
    """Check the views, of which each needs `least` points, and find those of one label that show nearly the same."""
    alike = Alike([], {}, {}, {})
    leaders: dict[Hashable, int] = {}
    for i, (view, label) in enumerate(zip(views, labels, strict=True)):
        leader = leaders.get(label)
        if leader is not None and _near(view, views[leader]):
            alike.leader[i] = leader
        else:
            try:
                check_points(view)
                if len(view) < least:
                    raise DegenerateGeometry(
                        f"A pose needs at least {least} grid points, {len(view)} were found."
                    )
                alike.homographies[i] = estimate_homography(view.points_target[:, :2], view.points_px)
            except GridposeError as failure:
                alike.failures[i] = failure
                continue
            alike.leader[i] = i
            leaders.setdefault(label, i)
        alike.usable.append(i)
    return alike


def _near(view: GridPoints, leader: GridPoints) -> bool:
    """Tell whether the same points lie in nearly the same places; what is near a view that was checked is sound too."""
    if len(view) != len(leader) or view.target != leader.target:
        return False
    smallest, largest = view.standard_uncertainty_px.min(), view.standard_uncertainty_px.max()
    return bool(
        np.array_equal(view.column, leader.column)
        and np.array_equal(view.row, leader.row)
        and np.abs(view.points_px - leader.points_px).max() < NEAR * view.image_width_px  # NaN fails
        and smallest > 0
        and largest < LARGEST_RATIO * smallest
    )


def placed(H: Float[np.ndarray, "3 3"], points: GridPoints, camera: Camera) -> Placement:
    """Place a view before a camera by its homography, distortion left aside."""
    T = closed_form.nominal(H, points, camera).T_camera_target
    return Placement(camera.as_array(), T[:3, :3], T[:3, :3] @ centred(points)[1] + T[:3, 3])


def placed_before(camera: Camera, points: GridPoints) -> Placement:
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
    return placed(
        camera.matrix @ estimate_homography(points.points_target[:, :2], normalised), points, camera
    )
