"""What stations that are not taken yet would say of the frames, and of the errors that all of them share.

With x the frames' motions and z the shared errors in their standard deviations, a station's residual is J x + G c z,
c being what z does to its measured pose: it says [J Gc]ᵀ V⁻¹ [J Gc] of (x, z). The stations so far leave x = x̂ + F z
with the covariance C of x̂, and z of unit variances.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from core.calibration.hand_eye.model import PoseArrays, jacobian, measurement_effect, pose_variances
from core.calibration.hand_eye.result import HandEyeCalibration, HandEyeObservation
from core.numerics import Variances, covariance_of


def information_so_far(
    tie: HandEyeCalibration, covariance_given_camera: Float[np.ndarray, "p p"]
) -> Float[np.ndarray, "q q"]:
    """Return the information on (x, z) of a calibration, whose covariance without shared errors is given."""
    C, F = covariance_of(covariance_given_camera), tie.common
    return np.block([[C, -C @ F], [-F.T @ C, np.eye(F.shape[1]) + F.T @ C @ F]])


def station_information(
    tie: HandEyeCalibration, stations: Sequence[HandEyeObservation]
) -> Float[np.ndarray, "n q q"]:
    """Return what every station says of (x, z), x in the order of the covariance.

    V has the station's covariance (zero where it is None) and the robot's deviations as the calibration found them.
    A station without `common` shares nothing.
    """
    frames, shared = tie.frames, tie.common.shape[1]
    poses = PoseArrays(
        np.array([s.T_base_flange for s in stations]),
        np.array([s.T_target_camera for s in stations]),
        np.array([np.zeros((6, 6)) if s.covariance is None else s.covariance for s in stations]),
        np.array([s.target for s in stations], dtype=np.intp),
    )
    common = np.array([np.zeros((6, shared)) if s.common is None else s.common for s in stations])
    J = np.concatenate(
        [
            jacobian(frames, poses.T_target_camera, poses.target),
            measurement_effect(frames, poses.T_target_camera, poses.target) @ common,
        ],
        axis=2,
    )
    robot = Variances.of_deviations(tie.robot_position_mm, tie.robot_rotation)
    V = pose_variances(frames, poses, robot)
    return np.asarray(J.transpose(0, 2, 1) @ np.linalg.solve(V, J))
