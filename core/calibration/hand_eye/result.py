"""What goes into tying frames and what comes out of it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy import stats

from core.calibration.hand_eye.model import Frames, jacobian, measurement_effect
from core.errors import Advisory, InvalidArgument
from core.transforms import transform_mean

FRAMES_STATE = tuple(
    f"{frame}.{name}"
    for frame in ("T_flange_camera", "T_base_target")
    for name in ("dx", "dy", "dz", "wx", "wy", "wz")
)
"""Order of the frames' covariance: for each a small translation d (mm) and rotation w (rad), R_true = exp(w) R."""


@dataclass(frozen=True, slots=True)
class Station:
    """One commanded pose, and where the camera was measured to be then.

    Cycles of the same commanded pose share the robot's deviation: average them first (`average_station`), or the
    covariances come out too small. `covariance` (x, y, z in mm, then w in rad; target frame) is what is this pose's
    own, `CameraPose.conditional_covariance`, or None where it is not known: it then counts as part of the robot's
    deviation. `common` (6, k) is what one standard uncertainty of each of k errors that all stations share, the lens's
    above all, does to this pose: dpose/dlens @ root, with root rootᵀ the lens's covariance.
    """

    pose_id: str
    T_base_flange: Float[np.ndarray, "4 4"]
    T_target_camera: Float[np.ndarray, "4 4"]
    covariance: Float[np.ndarray, "6 6"] | None = None
    common: Float[np.ndarray, "6 k"] | None = None


@dataclass(frozen=True, slots=True)
class Mount:
    """What a drawing says of where the camera sits on the flange, with standard uncertainties (mm, rad)."""

    T_flange_camera: Float[np.ndarray, "4 4"]
    position_standard_uncertainty_mm: float
    rotation_standard_uncertainty: float

    def __post_init__(self) -> None:
        sigmas = (self.position_standard_uncertainty_mm, self.rotation_standard_uncertainty)
        if not all(0.0 < sigma < math.inf for sigma in sigmas):
            raise InvalidArgument("A mount's standard uncertainties must be positive numbers.")


@dataclass(frozen=True, slots=True)
class Deviation:
    """Attained - commanded of one pose in the base frame: position (mm) and rotation vector (rad).

    The fit follows each pose a little, so these come out too small. `held_out_...` are the same with the frames tied by
    the other poses, `held_out_covariance` (position, rotation) their covariance as a measurement of what the robot did;
    None where the other poses would not suffice. Of a pose that was not `used` all poses used are the others.
    """

    pose_id: str
    position_mm: Float[np.ndarray, "3"]
    rotation: Float[np.ndarray, "3"]
    held_out_position_mm: Float[np.ndarray, "3"] | None
    held_out_rotation: Float[np.ndarray, "3"] | None
    held_out_covariance: Float[np.ndarray, "6 6"] | None
    used: bool


@dataclass(frozen=True, slots=True)
class FrameTie:
    """The frames with their doubt, in the order of `FRAMES_STATE`.

    `conditional_covariance` is `covariance` with the errors held that all stations have in common.
    `robot_position_mm` and `robot_rotation` (rad) are the standard deviations, along each axis, of what the robot's
    poses differ from those commanded beyond what the measurements explain.
    """

    T_flange_camera: Float[np.ndarray, "4 4"]
    T_base_target: Float[np.ndarray, "4 4"]
    covariance: Float[np.ndarray, "12 12"]
    conditional_covariance: Float[np.ndarray, "12 12"]
    robot_position_mm: float
    robot_rotation: float
    degrees_of_freedom: float
    deviations: tuple[Deviation, ...]
    warnings: tuple[Advisory, ...]

    @property
    def coverage_factor(self) -> float:
        """Half a 95 % interval in standard uncertainties (Student's t: few poses do not tell the deviations well)."""
        return float(stats.t.ppf(0.975, self.degrees_of_freedom))

    @property
    def frames(self) -> Frames:
        return Frames(self.T_flange_camera, self.T_base_target)


@dataclass(frozen=True, slots=True)
class AttainedPoses:
    """The cycles of one pose in the robot's base frame, ready to be compared with what was commanded.

    `T_base_flange` (n) and `covariance` (n; d in mm, w in rad, base frame) are of the cycles, measurement alone;
    `frames_covariance` is the tied frames' part, common to all cycles: it enters accuracy, not repeatability. Errors of
    the lens are in neither: T_flange_camera takes up most of them (`Deviation.held_out_covariance` has the rest).
    """

    pose_id: str
    commanded_T_base_flange: Float[np.ndarray, "4 4"]
    T_base_flange: Float[np.ndarray, "n 4 4"]
    covariance: Float[np.ndarray, "n 6 6"]
    frames_covariance: Float[np.ndarray, "6 6"]


def average_station(
    pose_id: str,
    T_base_flange: Float[np.ndarray, "4 4"],
    T_target_camera: Float[np.ndarray, "n 4 4"],
    covariances: Float[np.ndarray, "n 6 6"] | None = None,
    common: Float[np.ndarray, "6 k"] | None = None,
) -> Station:
    """Return one station of all cycles of a pose.

    Its covariance is the cycles' mean one, as if nothing averaged out: what a bowed grid or a lens beyond the model do
    is the same in every cycle.

    Raises InvalidArgument for no cycles.
    """
    if len(T_target_camera) == 0:
        raise InvalidArgument(f"Pose {pose_id} has no measurement.")
    mean = transform_mean(T_target_camera)
    covariance = None if covariances is None else covariances.mean(axis=0)
    return Station(pose_id, T_base_flange, mean, covariance, common)


def attained_poses(
    tie: FrameTie,
    pose_id: str,
    commanded_T_base_flange: Float[np.ndarray, "4 4"],
    T_target_camera: Float[np.ndarray, "n 4 4"],
    covariances: Float[np.ndarray, "n 6 6"] | None = None,
) -> AttainedPoses:
    """Return the measured cycles of a pose as T_base_flange, beside the commanded one."""
    frames = tie.frames
    G = measurement_effect(frames, T_target_camera)
    known = np.zeros((len(G), 6, 6)) if covariances is None else G @ covariances @ G.swapaxes(1, 2)
    J = jacobian(frames, transform_mean(T_target_camera)[None])[0]
    return AttainedPoses(
        pose_id=pose_id,
        commanded_T_base_flange=commanded_T_base_flange,
        T_base_flange=frames.attained(T_target_camera),
        covariance=known,
        frames_covariance=J @ tie.conditional_covariance @ J.T,
    )
