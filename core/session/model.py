"""The values of a session: what was observed and stated.

A session is some images of one or more targets, each taken at a pose of the robot that has a name (`pose_id`), or poses
that another instrument measured. Stated values (joint angles, commanded poses) keep the unit they are stated in, which
their names say; what is computed is in millimetres and radians.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from core.calibration import Lens, ViewStack, stack_views
from core.errors import MeasuredPosesMissing
from core.geometry import Camera, rpy_to_rotation
from core.kinematics import Chain
from core.targets import GridPoints, Labelling, TargetSpec

NO_TARGET = -1
"""The place of the target of an image that shows none of the session's; such an image has no grid points."""
CameraMount = Literal["robot", "fixed"]
"""`robot`: the camera is on the robot and targets stand still (eye in hand). `fixed`: the camera stands still and the
target is on the robot's flange (eye to hand)."""
_NUMBER = re.compile(r"(\d+)", re.ASCII)


@dataclass(frozen=True, slots=True)
class ImageObservation:
    """One target in one image, or the reason why it was not measured.

    Parameters
    ----------
    measurement_id
        Names this observation in messages and answers.
    pose_id
        The robot's pose, under the user's name.
    cycle
        The number of the visit to the pose; None where it is not known.
    image
        Identifies the photograph within its pose and cycle (its SHA-256): observations of several targets share one.
    target
        The target's place in `SessionData.targets`, or NO_TARGET.
    focus_group
        Images with the same one share one setting of camera and lens.
    joint_angles_deg
        The image's own; None: those of its pose hold.
    failure_code, failure_detail
        Why the single image gave no calibration; its grid points may still be used.
    labelling
        How far the image shows which grid point is (0, 0).
    filename
        What the user calls the file, for messages; None where it is not known.
    burst
        The number of the image within the stop that it was taken at; None: it is the first, or the only one.
    """

    measurement_id: str
    pose_id: str
    cycle: int | None
    image: str
    target: int
    focus_group: str
    joint_angles_deg: Sequence[float] | None
    width_px: int
    height_px: int
    failure_code: str | None = None
    failure_detail: str | None = None
    labelling: Labelling = "absolute"
    filename: str | None = None
    burst: int | None = None


@dataclass(frozen=True, slots=True)
class CommandedPose:
    """What the robot was commanded at a pose, in its base frame; everything may be unknown."""

    position_mm: Sequence[float] | None = None
    roll_deg: float | None = None
    pitch_deg: float | None = None
    yaw_deg: float | None = None
    joint_angles_deg: Sequence[float] | None = None
    approach: str | None = None

    def rotation(self) -> Float[np.ndarray, "3 3"] | None:
        """Return R_base_flange; None where the orientation is not known whole."""
        if self.roll_deg is None or self.pitch_deg is None or self.yaw_deg is None:
            return None
        return rpy_to_rotation(np.radians([self.roll_deg, self.pitch_deg, self.yaw_deg]))


@dataclass(frozen=True, slots=True)
class Datasheet:
    """What the robot's maker states of it, mm; None where nothing is stated."""

    repeatability_mm: float | None = None
    accuracy_mm: float | None = None


@dataclass(frozen=True, slots=True)
class MeasuredPose:
    """One visit to a pose as it was measured: by the camera in an image, or by another instrument.

    Parameters
    ----------
    position_mm, rotation
        Of the camera in the target frame (T_target_camera), or of the probe in the instrument's frame; the rotation is
        None where the instrument gives positions alone. Figures of a robot before a fixed camera are of the target in
        the camera frame (`core.session.camera_mount`).
    covariance
        Of x, y, z (mm) and a small rotation w (rad) with R_true = exp(w) R, in that frame; None where it is not stated.
    scatter
        The part of it that differs from visit to visit.
    common
        What one standard uncertainty of each error that all images share does to the pose: columns of the camera,
        eight or more, and one of the print's scale, the last. None for another instrument.
    frame
        Distinguishes frames in which positions do not compare: the target's place in the session's list.
    image
        The observation that the pose was estimated from; None for another instrument.
    burst
        The images of one stop that this is the mean of; empty where it is a single one.
    """

    measurement_id: str
    pose_id: str
    cycle: int | None
    joint_angles_deg: Sequence[float] | None
    position_mm: Float[np.ndarray, "3"]
    rotation: Float[np.ndarray, "3 3"] | None
    covariance: Float[np.ndarray, "6 6"] | None
    scatter: Float[np.ndarray, "6 6"] | None
    common: Float[np.ndarray, "6 e"] | None = None
    frame: int = 0
    image: ImageObservation | None = None
    rms_px: float | None = None
    burst: tuple[MeasuredPose, ...] = ()

    def own_covariance(self) -> Float[np.ndarray, "6 6"] | None:
        """Return the covariance without what all images share."""
        if self.covariance is None or self.common is None:
            return self.covariance
        return np.asarray(self.covariance - self.common @ self.common.T)


@dataclass(frozen=True)
class CameraViews:
    """The grid points of all images of one focus group and one size; row k of `views` is image `images[k]` of the
    session.
    """

    focus_group: str
    images: Int[np.ndarray, " k"]
    views: ViewStack


@dataclass(frozen=True)
class SessionData:
    """All that a session's figures are computed from.

    Parameters
    ----------
    targets, target_ids
        The targets and their names in messages.
    images
        In the order of pose (`natural`), cycle and image; those without a cycle follow those with one.
    views
        The grid points of those images in which they were found.
    commanded
        By `pose_id`.
    measured
        What another instrument measured, in the same order; a session of images has none.
    lens
        A 5 % prior on the focal length.
    intrinsics
        The camera of the estimator `given`.
    nominal
        The robot as its maker describes it.
    joint_coupling
        C: the joint angles of the robot's model are C times those stated of its poses; None: they are those stated.
    datasheet
        What its maker promises.
    pending
        Images that are not computed yet, for messages.
    taken_h
        When images were taken, by measurement, in hours after the first one; empty where that is not known.
    camera_mount
        What the camera is on; commanded poses are T_base_flange either way.
    measured_instead
        Whether another instrument measured poses which are not among these, while there are no images.
    time_source
        From what: `captured_at` as it was stated with the images, or `received_at`, when they came.
    """

    targets: tuple[TargetSpec, ...]
    target_ids: tuple[str, ...]
    images: tuple[ImageObservation, ...] = ()
    views: tuple[CameraViews, ...] = ()
    commanded: Mapping[str, CommandedPose] = field(default_factory=dict)
    measured: tuple[MeasuredPose, ...] = ()
    lens: Lens | None = None
    intrinsics: Camera | None = None
    nominal: Chain | None = None
    joint_coupling: Float[np.ndarray, "j j"] | None = None
    datasheet: Datasheet = Datasheet()
    pending: int = 0
    taken_h: Mapping[str, float] = field(default_factory=dict)
    time_source: str | None = None
    camera_mount: CameraMount = "robot"
    measured_instead: bool = False

    def observed(self) -> set[int]:
        """Return the places of the images whose grid points were found."""
        return {i for group in self.views for i in group.images.tolist()}

    def model_angles(self, stated_deg: Float[np.ndarray, "n j"]) -> Float[np.ndarray, "n j"]:
        """Return the joint angles of the robot's model, rad, from those stated, degrees."""
        stated = np.radians(stated_deg)
        return stated if self.joint_coupling is None else stated @ self.joint_coupling.T

    def points_count(self) -> int:
        """Return the number of grid points of all images."""
        return sum(len(group.views.column) for group in self.views)


def group_views(
    images: Sequence[ImageObservation], points: Mapping[int, GridPoints]
) -> tuple[CameraViews, ...]:
    """Return the grid points of images, by their places, camera setting by camera setting."""
    places: dict[tuple[str, int, int], list[int]] = {}
    for i in sorted(points):
        places.setdefault((images[i].focus_group, images[i].width_px, images[i].height_px), []).append(i)
    return tuple(
        CameraViews(
            name,
            np.array(members),
            stack_views([points[i] for i in members], [images[i].target for i in members]),
        )
        for (name, _, _), members in places.items()
    )


def readings(data: SessionData) -> tuple[MeasuredPose, ...]:
    """Return what another instrument measured; raises MeasuredPosesMissing where there is nothing."""
    if not data.measured:
        raise MeasuredPosesMissing("The session holds no poses measured by another instrument.")
    return data.measured


def natural(text: str) -> tuple[tuple[tuple[int, int, str], ...], str]:
    """Return a key that sorts P2 before P10; texts that differ have keys that differ."""
    parts = tuple(
        (0, int(part), "") if part.isdecimal() else (1, 0, part) for part in _NUMBER.split(text) if part
    )
    return parts, text
