"""The result of a global identification."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from core.errors import Advisory
from core.kinematics.arm_model import ArmState
from core.kinematics.dh import Chain
from core.kinematics.error_model import ErrorModel, JointRegion
from core.kinematics.global_fit import Conditioning, HoldOutError, Unidentifiable, Validation
from core.kinematics.identification.sampling import ParameterSampling
from core.kinematics.results import JointEstimate
from core.kinematics.target_transforms import TargetTransform


@dataclass(frozen=True, slots=True)
class Identification:
    """A robot identified from poses.

    Parameters
    ----------
    chain, T_flange_camera, T_target_base
        The arm: T_target_camera = T_target_base · forward(chain, q) · T_flange_camera; a base for each target.
    names, covariance
        Of the parameters that were fitted (mm, rad): keys of `ParameterLayout.keys`, joints', then the tool's and the
        bases', whose rotations are turned from the left.
    scatter
        The robot's own: standard deviation of each coordinate of position (mm) and of rotation (rad), beyond the
        instrument's stated noise; all of the noise where none was stated.
    residual
        Rms over the poses used; `residuals` (m, n) of all poses, observed - predicted; `used` which count.
    null_space
        The parameters that the poses do not determine.
    flange_camera_covariance, base_target_covariances
        Of T_flange_camera, with zeros for what is held, and of each T_base_target (`frame_covariances`); None where
        it is not identifiable.
    region
        Where the joints have been at the poses used.
    error_model
        What the robot has beyond its chain; None where the chain alone was asked for.
    nominal_arm
        The nominal chain with the base and tool that suit the poses best; None without a nominal.
    chain_residual
        Rms of the poses used about the chain without the terms beyond it, with the base and tool that suit that best;
        None where there are no such terms.
    sampling
        The parameters by sampling; None unless asked for.
    """

    chain: Chain
    T_flange_camera: Float[np.ndarray, "4 4"]
    T_target_base: Float[np.ndarray, "t 4 4"]
    joints: tuple[JointEstimate, ...]
    names: tuple[str, ...]
    covariance: Float[np.ndarray, "f f"]
    target_transforms: tuple[TargetTransform, ...]
    scatter_position_mm: float
    scatter_rotation: float | None
    residual: HoldOutError
    residuals: Float[np.ndarray, "m n"]
    used: Bool[np.ndarray, " n"]
    conditioning: Conditioning
    null_space: tuple[Unidentifiable, ...]
    flange_camera_covariance: Float[np.ndarray, "6 6"] | None
    base_target_covariances: tuple[Float[np.ndarray, "6 6"] | None, ...]
    validation: Validation | None
    region: tuple[JointRegion, ...]
    error_model: ErrorModel | None
    nominal_arm: ArmState | None
    chain_residual: HoldOutError | None
    warnings: tuple[Advisory, ...]
    sampling: ParameterSampling | None = None

    @property
    def correlation(self) -> Float[np.ndarray, "f f"]:
        unit = 1.0 / np.sqrt(np.diag(self.covariance))
        return np.asarray(self.covariance * np.outer(unit, unit))
