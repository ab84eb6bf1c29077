"""The value a calibration returns: estimate, doubt, residuals and remarks together.

State order of every full covariance: the camera's nine parameters (`CAMERA_PARAMETERS`), then a small
rotation w and a small translation d of T_camera_target, with R_true = exp(w) R and t_true = t + d, in the
camera frame (rad, mm).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from core.camera import Camera
from core.errors import Advisory
from core.targets.specification import GridPoints

STATE = ("fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "p1", "p2", "k3", "wx", "wy", "wz", "dx", "dy", "dz")


@dataclass(frozen=True, slots=True)
class CameraPose:
    """The camera in the target frame (the paper's eqs 36-37): p = -Rᵀt, R_ee = Rᵀ.

    `covariance` (6, 6): x, y, z in mm, then a small rotation w in rad with R_true = exp(w) R_estimated, all
    in the target frame. `conditional_covariance` is the same with the intrinsics held fixed. Angles in
    radians, R = Rz(yaw) Ry(pitch) Rx(roll).
    """

    position_mm: Float[np.ndarray, "3"]
    rotation: Float[np.ndarray, "3 3"]
    roll_pitch_yaw: Float[np.ndarray, "3"]
    roll_pitch_yaw_standard_uncertainty: Float[np.ndarray, "3"]
    covariance: Float[np.ndarray, "6 6"]
    conditional_covariance: Float[np.ndarray, "6 6"]


@dataclass(frozen=True, slots=True)
class Reprojection:
    """Statistics of the 2-D residual distances of the points used, px; the rms is over points."""

    rms_px: float
    mean_px: float
    std_px: float
    max_px: float
    points: int
    rejected: int


@dataclass(frozen=True, slots=True)
class Observability:
    """How well the view determines the state.

    `focal_relative_uncertainty` is the predicted u(f)/f; `condition_number` that of the scaled normal matrix;
    `tilt` the angle (rad) between the optical axis and the target's normal; `prior_dominated` names the
    parameters whose uncertainty is mostly the prior's. `pose_ambiguity_ratio` is the least sum of squared residuals
    (in stated uncertainties, over the points used) over that at the second local minimum, whose tilt is mirrored about
    the line of sight: 0 to 1, at 1 the two poses cannot be told apart; None where there is no second minimum, and the
    remark `pose_ambiguous` is not given of the mirrored tilt itself.
    """

    focal_relative_uncertainty: float
    condition_number: float
    tilt: float
    prior_dominated: tuple[str, ...]
    pose_ambiguity_ratio: float | None = None


@dataclass(frozen=True, slots=True)
class Calibration:
    """One image, calibrated."""

    estimator: str  # per_image | given
    start: str  # nullspace | vanishing_point | nominal
    image_width_px: int
    image_height_px: int
    camera: Camera
    T_camera_target: Float[np.ndarray, "4 4"]
    covariance: Float[np.ndarray, "15 15"]
    pose: CameraPose
    reprojection: Reprojection
    observability: Observability
    warnings: tuple[Advisory, ...]
    points: GridPoints
    residuals_px: Float[np.ndarray, "n 2"]  # observed - predicted, one row per grid point, rejected ones too
    used: Bool[np.ndarray, " n"]

    @property
    def camera_standard_uncertainty(self) -> Float[np.ndarray, "9"]:
        """Standard uncertainties in the order of `CAMERA_PARAMETERS`; 0 where a parameter was held fixed."""
        variances: Float[np.ndarray, "9"] = np.diag(self.covariance)[:9]
        return np.sqrt(variances)
