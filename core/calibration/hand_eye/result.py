"""Inputs and results of hand-eye calibration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import stdtrit

from core.calibration.hand_eye.model import Frames, jacobian, measurement_effect
from core.errors import Advisory, InvalidArgument, listed
from core.geometry import transform_mean


@dataclass(frozen=True, slots=True)
class HandEyeObservation:
    """One commanded pose and the camera pose measured there.

    Cycles of the same commanded pose share the robot's deviation: average them first (`average_station`), or the
    covariances come out too small. `covariance` (x, y, z in mm, then w in rad; target frame) is what is this pose's
    own, `CameraPose.covariance_given_camera`, or None where it is not known: it then counts as part of the robot's
    deviation. `common` (6, k) is what one standard uncertainty of each of k errors that all stations share, the lens's
    above all, does to this pose: dpose/dlens @ root, with root rootᵀ the lens's covariance. `target` is the place of
    the target that the camera was measured before, 0 where there is one.
    """

    pose_id: str
    T_base_flange: Float[np.ndarray, "4 4"]
    T_target_camera: Float[np.ndarray, "4 4"]
    covariance: Float[np.ndarray, "6 6"] | None = None
    common: Float[np.ndarray, "6 k"] | None = None
    target: int = 0


@dataclass(frozen=True, slots=True)
class PositionObservation:
    """One commanded position (mm, base frame) and the camera pose measured there; else as `HandEyeObservation`."""

    pose_id: str
    position_base_mm: Float[np.ndarray, "3"]
    T_target_camera: Float[np.ndarray, "4 4"]
    covariance: Float[np.ndarray, "6 6"] | None = None
    common: Float[np.ndarray, "6 k"] | None = None


@dataclass(frozen=True, slots=True)
class ScaleDifference:
    """By what share commanded distances are longer than measured ones, with its standard uncertainty.

    `like_of_robot` is the standard deviation of the scale that the robot's own errors resemble, by what else they have
    of an affine map of the place; 0 where that is not observable.
    """

    value: float
    standard_uncertainty: float
    like_of_robot: float = 0.0

    @property
    def inverse(self) -> ScaleDifference:
        """That of measured distances to commanded ones."""
        ratio = 1.0 / max(1.0 + self.value, 1e-9)
        return ScaleDifference(
            ratio - 1.0, ratio**2 * self.standard_uncertainty, ratio**2 * self.like_of_robot
        )


@dataclass(frozen=True, slots=True)
class PoseResidual:
    """Attained - commanded of one pose in the base frame: position (mm) and rotation vector (rad).

    The fit follows each pose a little, so these are too small. The fields `held_out_*` are the same with the frames
    from the other poses; None where these would not suffice. Of a pose that was not `used` all poses used are the
    others.

    `leverage` (6, 6) is the pose's block J C JᵀV⁻¹ of the fit's hat matrix: the share of the pose's own deviation that
    the frames follow. `common` (6, k) is what one standard uncertainty of each error that all stations share leaves in
    the deviation, the frames having followed it.
    """

    pose_id: str
    position_mm: Float[np.ndarray, "3"]
    rotation: Float[np.ndarray, "3"]
    held_out_position_mm: Float[np.ndarray, "3"] | None
    held_out_rotation: Float[np.ndarray, "3"] | None
    used: bool
    leverage: Float[np.ndarray, "6 6"]
    common: Float[np.ndarray, "6 k"]


@dataclass(frozen=True, slots=True)
class HandEyeCalibration:
    """The frames with their covariance; `T_base_targets` is one for each target.

    `covariance` is of T_flange_camera, then of every target's T_base_target: of each a small translation d (mm) and
    rotation w (rad), R_true = exp(w) R. `covariance_given_camera` is the same without the errors that all stations have
    in common; `common` (p, k) is what one standard uncertainty of each of these does to the frames.
    `robot_position_mm` and `robot_rotation` (rad) are the robot's standard deviations from the commanded poses along
    each axis, beyond what the measurements explain. `scale` is by how much commanded distances are longer than measured
    ones; None where the poses do not determine it.
    """

    T_flange_camera: Float[np.ndarray, "4 4"]
    T_base_targets: Float[np.ndarray, "t 4 4"]
    covariance: Float[np.ndarray, "p p"]
    covariance_given_camera: Float[np.ndarray, "p p"]
    robot_position_mm: float
    robot_rotation: float
    degrees_of_freedom: float
    deviations: tuple[PoseResidual, ...]
    warnings: tuple[Advisory, ...]
    common: Float[np.ndarray, "p k"]
    scale: ScaleDifference | None

    @property
    def coverage_factor(self) -> float:
        """Half a 95 % interval in standard uncertainties (Student's t, since the deviations come from few poses)."""
        return float(stdtrit(self.degrees_of_freedom, 0.975))

    @property
    def frames(self) -> Frames:
        return Frames(self.T_flange_camera, self.T_base_targets)

    def effect_of(
        self, T_target_camera: Float[np.ndarray, "4 4"], common: Float[np.ndarray, "6 k"] | None
    ) -> tuple[Float[np.ndarray, "6 6"], Float[np.ndarray, "6 k"]]:
        """Return how a pose before the first target that tied no frames is compared: the covariance that the frames
        leave in its attained pose, and what the errors that it shares with the stations (`common`) leave.
        """
        J = jacobian(self.frames, T_target_camera[None])[0]
        left = J @ self.common
        if common is not None and common.shape == left.shape:
            left = left + measurement_effect(self.frames, T_target_camera[None])[0] @ common
        return J @ self.covariance_given_camera @ J.T, left

    def measurement_effect(
        self, T_target_camera: Float[np.ndarray, "4 4"], target: int = 0
    ) -> Float[np.ndarray, "6 6"]:
        """Return what an error of a measured pose does to the attained one in these frames."""
        return measurement_effect(self.frames, T_target_camera[None], np.array([target]))[0]


def rejected_poses(pose_ids: Sequence[str]) -> tuple[Advisory, ...]:
    """Return the warning that these poses were rejected; none for no poses."""
    if not pose_ids:
        return ()
    return (
        Advisory(
            "poses_excluded",
            f"Rejected, far from where the other poses say they are: {listed(pose_ids)}.",
            "Check their pose_id and commanded values, and that all measure the same point (of an unmarked target, "
            "that its origin is the same in all images).",
        ),
    )


def average_station(
    pose_id: str,
    T_base_flange: Float[np.ndarray, "4 4"],
    T_target_camera: Float[np.ndarray, "n 4 4"],
    covariances: Float[np.ndarray, "n 6 6"] | None = None,
    common: Float[np.ndarray, "6 k"] | None = None,
    target: int = 0,
) -> HandEyeObservation:
    """Return one observation averaged over all cycles of a pose.

    Its covariance is the cycles' mean one, as if nothing averaged out: what a bowed grid or a lens beyond the model do
    is the same in every cycle.

    Raises InvalidArgument for no cycles.
    """
    if len(T_target_camera) == 0:
        raise InvalidArgument(f"Pose {pose_id} has no measurement.")
    mean = transform_mean(T_target_camera)
    covariance = None if covariances is None else covariances.mean(axis=0)
    return HandEyeObservation(pose_id, T_base_flange, mean, covariance, common, target)
