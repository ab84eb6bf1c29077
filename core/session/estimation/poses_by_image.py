"""The camera's pose of every image in which the target was found, with the reason where it does not count."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from core.calibration import Calibration, calibrate_points
from core.errors import FocalWeaklyObservable, GridposeError
from core.session.estimate import ExcludedMeasurement, SessionEstimate
from core.session.estimation.board_symmetry import label_repeats
from core.session.model import ImageObservation, MeasuredPose, SessionData


@dataclass(frozen=True, slots=True)
class ImagePose:
    """One image with grid points.

    `pose` is None where the estimator gives none. `reason` says why the image is not `used`: it was excluded, or shows
    another orientation than the first image of its pose. An image that determines the focal length weakly is not used
    image by image, since its scatter is not the robot's; the pose that it gives has the uncertainty that this leaves.
    `focal_px` is the focal length of the image's own camera with its standard uncertainty, the mean of fx and fy; None
    where images share a camera, or it was given.
    """

    image: ImageObservation
    pose: MeasuredPose | None
    used: bool
    reason: ExcludedMeasurement | None
    focal_px: tuple[float, float] | None


def image_poses(data: SessionData, estimate: SessionEstimate) -> tuple[ImagePose, ...]:
    """Return every image whose grid points were found, in the session's order."""
    weak = {name for name, one in estimate.excluded.items() if one.code == FocalWeaklyObservable.code}
    poses = {pose.measurement_id: pose for pose in estimate.poses} | _poses_alone(data, weak)
    focals = _own_focals(estimate)
    found = []
    for i in sorted(data.observed()):
        image = data.images[i]
        name = image.measurement_id
        reason = estimate.excluded.get(name) or estimate.unclear.get(name)
        pose = poses.get(name)
        found.append(ImagePose(image, pose, pose is not None and reason is None, reason, focals.get(name)))
    return tuple(found)


def _own_focals(estimate: SessionEstimate) -> dict[str, tuple[float, float]]:
    """Return the focal lengths of images that have cameras of their own, px, with their standard uncertainties."""
    found: dict[str, tuple[float, float]] = {}
    for group in estimate.groups:
        relative = group.estimate.focal_uncertainty
        if relative is None:
            continue
        focals = 0.5 * group.estimate.cameras[:, :2].sum(axis=1)
        for pose, f, u in zip(group.poses, focals.tolist(), relative.tolist(), strict=True):
            found[pose.measurement_id] = f, u * f
    return found


def _poses_alone(data: SessionData, names: Collection[str]) -> dict[str, MeasuredPose]:
    """Return the poses that the images of these names give by themselves, those that give one."""
    found = {}
    for group in data.views:
        members = [(k, data.images[i]) for k, i in enumerate(group.images.tolist())]
        chosen = [(k, image) for k, image in members if image.measurement_id in names]
        views = label_repeats(group, data.images)[0] if chosen else group.views
        for k, image in chosen:
            try:
                calibration = calibrate_points(views.view(k), lens=data.lens)
            except GridposeError:  # the reason of the estimator stays
                continue
            found[image.measurement_id] = _pose_of(image, calibration)
    return found


def _pose_of(image: ImageObservation, calibration: Calibration) -> MeasuredPose:
    pose = calibration.pose
    # The part of the covariance that comes from the camera, as standard uncertainties of independent errors.
    variances, directions = np.linalg.eigh(pose.covariance - pose.covariance_given_camera)
    of_camera = np.zeros((6, 9))
    of_camera[:, :6] = directions * np.sqrt(np.maximum(variances, 0.0))
    return MeasuredPose(
        image.measurement_id,
        image.pose_id,
        image.cycle,
        image.joint_angles_deg,
        pose.position_mm,
        pose.rotation,
        pose.covariance,
        pose.covariance,
        of_camera,
        image.target,
        image,
        calibration.reprojection.rms_px,
    )
