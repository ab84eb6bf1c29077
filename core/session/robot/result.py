"""What a session's poses determine of a robot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from core.errors import Advisory
from core.kinematics import (
    ArmState,
    Chain,
    Conditioning,
    ErrorModel,
    HoldOutError,
    JointEstimate,
    JointRegion,
    ParameterSampling,
    TargetTransform,
    Unidentifiable,
    Validation,
)
from core.session.estimate import ExcludedMeasurement
from core.session.robot.method_agreement import MethodDifference


@dataclass(frozen=True, slots=True)
class JointFigures:
    """One joint with the number of poses that it was identified from, and the residual where it alone moved."""

    estimate: JointEstimate
    poses: int
    residual: HoldOutError | None


@dataclass(frozen=True)
class RobotIdentification:
    """What a session's poses determine of a robot, in mm and rad.

    Parameters
    ----------
    chain, T_flange_camera, T_target_base
        T_target_camera = T_target_base · forward(chain, q) · T_flange_camera; a base for each of `targets`.
    joints
        From the base on, each with standard uncertainties.
    parameters, correlation
        Of the parameters that were fitted.
    residual, validation
        Rms of the poses about the arm, and of poses held out of the fit.
    scatter_mm, scatter_rad
        The robot's own: standard deviation of each coordinate of position and of rotation.
    null_space
        The parameters that the poses do not determine.
    flange_camera_covariance, base_target_covariances
        Of T_flange_camera (flange frame) and of each T_base_target (base frame): x, y, z (mm), then a rotation from
        the left (rad). None where it is not identifiable, and with the methods that begin at axes.
    target_transforms
        How targets lie to one another, by their places in `targets`.
    targets
        The places of the targets in the session's list; empty for another instrument.
    region
        Where the joints have been at the poses that were fitted.
    error_model
        What the robot has beyond its chain, and what it predicts with it; None where the chain alone was asked for,
        and with the methods that begin at axes.
    nominal_arm
        The nominal chain with the base and tool that suit the poses best; None without a nominal, and with the methods
        that begin at axes.
    chain_residual
        Rms of the poses about the chain without the terms beyond it; None without such terms.
    method_agreement
        Methods compared with the global fit: of the global fit's own answer all others, empty where a joint has no
        sweep; of another method's that method.
    sampling
        The parameters by sampling, in the order of `parameters`; None unless asked for.
    excluded
        The measurements that are not among the poses that were fitted.
    """

    chain: Chain
    T_flange_camera: Float[np.ndarray, "4 4"]
    T_target_base: Float[np.ndarray, "t 4 4"]
    joints: tuple[JointFigures, ...]
    parameters: tuple[str, ...]
    correlation: Float[np.ndarray, "f f"]
    residual: HoldOutError
    validation: Validation | None
    conditioning: Conditioning
    scatter_mm: float
    scatter_rad: float | None
    null_space: tuple[Unidentifiable, ...]
    target_transforms: tuple[TargetTransform, ...]
    targets: tuple[int, ...]
    flange_camera_covariance: Float[np.ndarray, "6 6"] | None
    base_target_covariances: tuple[Float[np.ndarray, "6 6"] | None, ...]
    region: tuple[JointRegion, ...]
    error_model: ErrorModel | None
    nominal_arm: ArmState | None
    chain_residual: HoldOutError | None
    method_agreement: tuple[MethodDifference, ...]
    excluded: tuple[ExcludedMeasurement, ...]
    warnings: tuple[Advisory, ...]
    sampling: ParameterSampling | None = None
