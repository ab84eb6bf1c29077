"""What images at candidate views are expected to measure, with the session's camera, noise and shared errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from core.calibration import CommonFit, error_factors
from core.errors import ADVISED_TILT, TooFewMeasurements
from core.geometry import AnyCamera, camera_from_array, transform
from core.session.camera_mount import moving_poses
from core.session.estimate import FocusGroup
from core.session.model import ImageObservation, MeasuredPose, SessionData
from core.session.next_view.information import placed_views, simulated_views, view_information
from core.session.robot import shared_error_columns


@dataclass(frozen=True)
class ExpectedViews:
    """What moves in what stands still, covariances of these poses by themselves, and the factors of the errors that
    they share with those so far.

    `lens` is what each view says of the shared errors of its lens, which are the columns `of_lens` of `common`.
    """

    T_fixed_moving: Float[np.ndarray, "n 4 4"]
    own: Float[np.ndarray, "n 6 6"]
    common: Float[np.ndarray, "n 6 k"]
    lens: Float[np.ndarray, "n c c"]
    of_lens: Int[np.ndarray, " c"]

    def of_shared(self, size: int) -> Float[np.ndarray, "n s s"]:
        """Return the information on the lens in a state of that size, the shared errors last."""
        found = np.zeros((len(self.lens), size, size))
        places = size - self.common.shape[2] + self.of_lens
        found[:, places[:, None], places[None, :]] = self.lens
        return found


def common_fit(group: FocusGroup) -> CommonFit:
    """Return the fit of a focus group's common camera; raises TooFewMeasurements for a group without one."""
    if group.estimate.fit is None:
        raise TooFewMeasurements(
            "The images so far give no common camera to plan from.",
            f"Take three images from different directions first, the target tilted by {ADVISED_TILT}.",
        )
    return group.estimate.fit


def image_size(fit: CommonFit) -> tuple[int, int]:
    """Return width and height of the images, px."""
    return fit.views.image_width_px, fit.views.image_height_px


def camera_of(fit: CommonFit) -> AnyCamera:
    """Return the common camera."""
    return camera_from_array(fit.placements.parameters[0])


def expected_views(
    data: SessionData,
    counted: Sequence[MeasuredPose],
    group: FocusGroup,
    target: int,
    T_camera_target: Float[np.ndarray, "n 4 4"],
) -> ExpectedViews:
    """Return what images of a target, by its place in the session, are expected to measure.

    `counted` are the poses so far, in whose shared errors those of the views are stated.
    """
    spec = data.targets[target]
    fit = common_fit(group)
    camera = camera_of(fit)
    noise = fit.scale * float(np.median(fit.views.uncertainty))
    points = simulated_views(spec, camera, image_size(fit), T_camera_target, noise)
    found = view_information(*placed_views(points, camera, T_camera_target))
    c = found.camera.shape[1]
    factors = error_factors(group.estimate.camera_covariance[:c, :c])
    T = np.linalg.inv(T_camera_target)
    common = np.zeros((len(T), 6, group.estimate.common.shape[2]))
    common[:, :, :c] = found.by_camera @ factors
    common[:, :3, -1] = (spec.scale_standard_uncertainty or 0.0) * T[:, :3, 3]
    width, height = image_size(fit)
    image = ImageObservation("", "", None, "", target, group.name, None, width, height)
    views = [
        MeasuredPose("", "", None, None, pose[:3, 3], pose[:3, :3], own, own, shared, target, image)
        for pose, own, shared in zip(T, found.own * fit.growth.own, common, strict=True)
    ]
    every = moving_poses(data, [*counted, *views])
    columns, owners = shared_error_columns(every)
    moving = every[len(counted) :]
    return ExpectedViews(
        np.array(
            [transform(view.rotation, view.position_mm) for view in moving if view.rotation is not None]
        ),
        np.array([view.scatter for view in moving]),
        columns[len(counted) :],
        factors.T @ found.camera @ factors / fit.growth.camera,
        np.array([k for k, owner in enumerate(owners) if owner == group.name], dtype=np.intp),
    )
