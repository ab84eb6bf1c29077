"""Observations for kinematic identification: joint angles, and the poses measured at them.

    T_target_camera(q) = T_target_base · T_base_flange(q) · T_flange_camera

whatever the instrument: for a camera on the flange the target's frame is the measuring frame; for a laser tracker that
is the tracker's, with the probe or reflector in the camera's place.

One lens, one error: where all poses depend on one estimated lens, most of a pose's error is common to all of them. The
covariance therefore comes in two parts, cov(pose i, pose j) = δ_ij covariance_i + common_i common_jᵀ. Without the
second part, intervals of absolute quantities are several times too short.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int

from core.errors import InvalidArgument, JointAnglesInconsistent, JointAnglesMissing, listed
from core.geometry import are_rotations


@dataclass(frozen=True, slots=True)
class PoseData:
    """Poses T_target_camera (or T_tracker_probe), in any order, with the robot's joint angles.

    Parameters
    ----------
    joint_angles
        Of the robot's own encoders, rad, first joint first.
    positions_mm
        Of the camera (the reflector), in the frame of the target that was seen.
    rotations
        R_target_camera, or None where the instrument gives positions alone.
    covariance
        Of each pose by itself: (x, y, z in mm, then a small rotation w in rad with R_true = exp(w) R_estimated, all in
        the measuring frame). For positions alone the last three rows and columns are not read. None: nothing is known
        of the instrument; the noise's size is then read from the residuals.
    common
        Factors of the errors that all poses share, such as the lens's: d(pose) of one standard deviation of each, so
        that cov(pose i, pose j) = common_i @ common_jᵀ for i ≠ j.
    target
        Index of the target that each pose was measured from, 0 for all where there is one.
    labels
        The user's names of the poses, as many as poses, or none: for messages, and to group visits to one pose.
    image
        Index of the image that each pose was measured in, the same for the poses of several targets that one image
        shows; None where each has its own.
    approach
        Sign of every joint's last move before the pose, 1, -1, or 0 where it is not known; None: of no pose.
    instrument
        Whether another instrument measured the poses, not a camera before a print: for messages.
    """

    joint_angles: Float[np.ndarray, "a j"]
    positions_mm: Float[np.ndarray, "n 3"]
    rotations: Float[np.ndarray, "n 3 3"] | None = None
    covariance: Float[np.ndarray, "n 6 6"] | None = None
    common: Float[np.ndarray, "n 6 k"] | None = None
    target: Int[np.ndarray, " n"] | None = None
    labels: tuple[str, ...] = field(default=())
    image: Int[np.ndarray, " n"] | None = None
    approach: Float[np.ndarray, "a j"] | None = None
    instrument: bool = False

    def __post_init__(self) -> None:
        """Raise JointAnglesMissing or InvalidArgument, naming the pose, where something cannot be used."""
        parts = (
            self.joint_angles,
            self.rotations,
            self.covariance,
            self.common,
            self.target,
            self.image,
            self.approach,
        )
        if any(part is not None and len(part) != len(self.positions_mm) for part in parts):
            raise InvalidArgument("Each pose needs all of what is given: the arrays differ in length.")
        _require_angles(self)
        self._require(np.isfinite(self.positions_mm).all(axis=1), "a position that is not finite")
        if self.rotations is not None:
            self._require(np.isfinite(self.rotations).all(axis=(1, 2)), "a rotation that is not finite")
            self._require(are_rotations(self.rotations), "a matrix that is no rotation")
        for values, name in ((self.covariance, "a covariance"), (self.common, "a common error")):
            if values is not None:
                self._require(np.isfinite(values).all(axis=(1, 2)), f"{name} that is not finite")
        if self.covariance is not None:
            components = 3 if self.rotations is None else 6
            variances = np.diagonal(self.covariance, axis1=1, axis2=2)[:, :components]
            self._require(
                np.asarray((variances > 0.0).all(axis=1)), "a covariance without a positive diagonal"
            )
        if self.target is not None:
            self._require(self.target >= 0, "a target's index below zero")
        if self.labels and len(self.labels) != len(self.positions_mm):
            raise InvalidArgument(f"There are {len(self.positions_mm)} poses and {len(self.labels)} labels.")

    def __len__(self) -> int:
        return len(self.positions_mm)

    @property
    def joints(self) -> int:
        return int(self.joint_angles.shape[1])

    @property
    def targets(self) -> Int[np.ndarray, " n"]:
        """Index of the target of every pose."""
        return np.zeros(len(self), dtype=np.intp) if self.target is None else self.target

    def label(self, pose: int) -> str:
        """Return the name of a pose for a message: the user's, or its number counted from 1."""
        return self.labels[pose] if self.labels else f"number {pose + 1}"

    def take(self, poses: Int[np.ndarray, " m"]) -> PoseData:
        """Return the poses of these indices alone, in this order."""
        return PoseData(
            self.joint_angles[poses],
            self.positions_mm[poses],
            None if self.rotations is None else self.rotations[poses],
            None if self.covariance is None else self.covariance[poses],
            None if self.common is None else self.common[poses],
            None if self.target is None else self.target[poses],
            tuple(self.labels[i] for i in poses) if self.labels else (),
            None if self.image is None else self.image[poses],
            None if self.approach is None else self.approach[poses],
            self.instrument,
        )

    def _require(self, passes: Bool[np.ndarray, " n"], what: str) -> None:
        if not passes.all():
            label = self.label(int(np.argmin(passes)))
            raise InvalidArgument(f"Pose {label} has {what}.", "Correct this pose, or leave it out.")


def _require_angles(poses: PoseData) -> None:
    finite = np.isfinite(poses.joint_angles)
    without = np.flatnonzero(~finite.all(axis=1))
    if poses.joints == 0 or len(without):
        some = listed([poses.label(int(i)) for i in without])
        raise JointAnglesMissing(
            f"{len(without)} of {len(poses)} poses are without all their joint angles: {some}."
            if poses.joints
            else "The poses carry no joint angles."
        )


def stack_joint_angles(
    angles: Sequence[Sequence[float] | None], joints: int | None = None, labels: Sequence[str] = ()
) -> Float[np.ndarray, "n j"]:
    """Return the angles of all poses as one array, in the unit they came in.

    `joints` is the number of joints of the robot where that is known.

    Raises JointAnglesMissing for poses without angles, JointAnglesInconsistent where their number differs from pose to
    pose or is not the robot's.
    """
    named = list(labels) or [f"number {i + 1}" for i in range(len(angles))]
    missing = [name for name, values in zip(named, angles, strict=True) if not values]
    if missing or not angles:
        raise JointAnglesMissing(
            f"{len(missing)} of {len(angles)} poses are without joint angles: {listed(missing)}."
        )
    numbers = {len(values) for values in angles if values is not None}
    expected = joints if joints is not None else max(numbers)
    if numbers != {expected}:
        odd = next(
            name for name, v in zip(named, angles, strict=True) if v is not None and len(v) != expected
        )
        found = ", ".join(str(n) for n in sorted(numbers))
        whose = "The robot has" if joints is not None else "Another pose has"
        raise JointAnglesInconsistent(
            f"Poses carry {found} joint angles. {whose} {expected} joints; pose {odd} differs."
        )
    return np.asarray(angles, dtype=np.float64)
