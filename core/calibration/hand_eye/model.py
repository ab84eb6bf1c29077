"""Model of hand-eye calibration: the unknown frames, attained poses, and propagation of noise.

    T_base_flange = T_base_target @ T_target_camera @ T_camera_flange

T_base_target is one for each target. Small motions of a frame are d (mm) and w (rad), t ← t + d, R ← exp(w) R, in this
order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from core.geometry import hat, hats, perturbed, so3_log
from core.numerics import Variances

MIN_ROBOT_SIGMAS = Variances.of_deviations(1e-3, 1e-6)
"""Least variances assumed of a robot: exact poses still need weights."""


@dataclass(frozen=True, slots=True)
class Frames:
    """The unknowns: the camera on the flange, and each target in the base."""

    T_flange_camera: Float[np.ndarray, "4 4"]
    T_base_targets: Float[np.ndarray, "t 4 4"]

    @property
    def size(self) -> int:
        """Degrees of freedom of all frames."""
        return 6 + 6 * len(self.T_base_targets)

    def moved(self, step: Float[np.ndarray, " p"]) -> Frames:
        """Return the frames after small motions of T_flange_camera and of each T_base_target."""
        targets = [perturbed(T, step[6 + 6 * k : 12 + 6 * k]) for k, T in enumerate(self.T_base_targets)]
        return Frames(perturbed(self.T_flange_camera, step[:6]), np.array(targets))

    def attained(
        self, T_target_camera: Float[np.ndarray, "n 4 4"], target: Int[np.ndarray, " n"] | int = 0
    ) -> Float[np.ndarray, "n 4 4"]:
        """Return T_base_flange of measured poses; `target` is the place of each one's target."""
        return self.T_base_targets[target] @ T_target_camera @ np.linalg.inv(self.T_flange_camera)


@dataclass(frozen=True, slots=True)
class PoseArrays:
    """Commanded and measured poses, covariances (zero where one is not known) of the measured ones, and the place of
    the target that each was measured before.
    """

    T_base_flange: Float[np.ndarray, "n 4 4"]
    T_target_camera: Float[np.ndarray, "n 4 4"]
    covariance: Float[np.ndarray, "n 6 6"]
    target: Int[np.ndarray, " n"]

    def part(self, used: Bool[np.ndarray, " n"]) -> PoseArrays:
        return PoseArrays(
            self.T_base_flange[used], self.T_target_camera[used], self.covariance[used], self.target[used]
        )


def residuals(frames: Frames, poses: PoseArrays) -> Float[np.ndarray, "n 6"]:
    """Return commanded - attained in the base frame: position (mm) and rotation vector (rad)."""
    attained = frames.attained(poses.T_target_camera, poses.target)
    turned = poses.T_base_flange[:, :3, :3] @ attained[:, :3, :3].swapaxes(1, 2)
    position = poses.T_base_flange[:, :3, 3] - attained[:, :3, 3]
    return np.concatenate([position, np.array([so3_log(R) for R in turned])], axis=1)


def jacobian(
    frames: Frames,
    T_target_camera: Float[np.ndarray, "n 4 4"],
    target: Int[np.ndarray, " n"] | int = 0,
) -> Float[np.ndarray, "n 6 p"]:
    """Return d(position, rotation vector) of the attained flange by small motions of the frames.

    With R, p attained, those of T_flange_camera move it by -R d - R [t]× w and turn it by -R w; those of
    its T_base_target by d - [p - t]× w and w, and those of other targets not at all.
    """
    attained = frames.attained(T_target_camera, target)
    R, from_target = attained[:, :3, :3], attained[:, :3, 3] - frames.T_base_targets[target, :3, 3]
    J = np.zeros((len(R), 6, frames.size))
    J[:, :3, :3] = J[:, 3:, 3:6] = -R
    J[:, :3, 3:6] = -R @ hat(frames.T_flange_camera[:3, 3])
    of_target = np.zeros((len(R), 6, 6))
    of_target[:, :3, :3] = of_target[:, 3:, 3:] = np.eye(3)
    of_target[:, :3, 3:] = -hats(from_target)
    places = np.broadcast_to(target, len(R))
    for k in range(len(frames.T_base_targets)):
        J[places == k, :, 6 + 6 * k : 12 + 6 * k] = of_target[places == k]
    return J


def measurement_effect(
    frames: Frames,
    T_target_camera: Float[np.ndarray, "n 4 4"],
    target: Int[np.ndarray, " n"] | int = 0,
) -> Float[np.ndarray, "n 6 6"]:
    """Return d(attained flange; base frame)/d(measured pose's error; target frame), both as (d, w)."""
    R_Z, T_X = frames.T_base_targets[target, :3, :3], frames.T_flange_camera
    arm = T_target_camera[:, :3, :3] @ (-T_X[:3, :3].T @ T_X[:3, 3])
    G = np.zeros((len(arm), 6, 6))
    G[:, :3, :3] = G[:, 3:, 3:] = R_Z
    G[:, :3, 3:] = -R_Z @ hats(arm)
    return G


def measurement_covariance(frames: Frames, poses: PoseArrays) -> Float[np.ndarray, "n 6 6"]:
    """Return the covariance of the attained flange due to measurement, base frame."""
    G = measurement_effect(frames, poses.T_target_camera, poses.target)
    return np.asarray(G @ poses.covariance @ G.swapaxes(1, 2))


def pose_variances(frames: Frames, poses: PoseArrays, robot: Variances) -> Float[np.ndarray, "n 6 6"]:
    """Return V, the covariance of every commanded - attained pose: measurement and the robot's deviation."""
    return measurement_covariance(frames, poses) + np.diag(robot.diagonal(6))


def whitening(V: Float[np.ndarray, "n m m"]) -> Float[np.ndarray, "n m m"]:
    """Return upper triangular W with W V Wᵀ = 1: the last rows see the last components alone."""
    lower = np.linalg.cholesky(V[:, ::-1, ::-1])
    return np.ascontiguousarray(np.linalg.inv(lower)[:, ::-1, ::-1])
