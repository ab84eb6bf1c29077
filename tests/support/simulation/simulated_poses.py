"""What a camera measures of a moving arm, as numbers: poses with noise of known covariance. No image is rendered.

The noise is that of a camera before a grid of 14 x 10 points, 25 mm apart and tilted by 30°, wherever the arm holds it:
pixel noise carried to the pose through the projection's derivatives. With A, B, D the blocks of the information on
pose and lens that one image carries,

    per_image   covariance (A - B (D + prior)⁻¹ Bᵀ)⁻¹, a lens for each image, without p1 and p2
    pooled      covariance A⁻¹, and in common -A⁻¹ B L with L Lᵀ the covariance of the one lens from all images
    given       covariance A⁻¹
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float, Int

from core.geometry.camera import Camera, project_with_jacobian
from core.geometry.se3 import hat, so3_exp
from core.kinematics.dh import pose_with_jacobian
from core.kinematics.pose_observations import PoseData
from core.simulation.arm import Arm
from core.targets.specification import TargetSpec

_CAMERA = Camera(2320.0, 2320.0, 1229.5, 1020.0, k1=-0.1, k2=0.05)
_WIDTH_PX = 2448
_GRID = TargetSpec("chessboard", 14, 10, 25.0)
_DISTANCE_MM = 510.0
_TILT = math.radians(30.0)
_HELD = 1e-6  # standard deviation of a parameter that is not estimated
_VIEWS = 24  # directions of the tilt, taken in turn


@dataclass(frozen=True, slots=True)
class Repeatability:
    """Standard deviations of what the robot does differently each time.

    `position_mm` and `rotation_rad` are the camera's along and about each axis, `joint_rad` each joint's own.
    """

    position_mm: float = 0.0
    rotation_rad: float = 0.0
    joint_rad: float = 0.0


def measure_poses(
    arm: Arm,
    joint_angles: Float[np.ndarray, "n j"],
    rng: np.random.Generator,
    *,
    estimator: str = "pooled",
    sigma_px: float = 0.05,
    robot: Repeatability | None = None,
    target: Int[np.ndarray, " n"] | None = None,
) -> PoseData:
    """Return the poses at given joint angles (rad) as they would be measured.

    `estimator` is "per_image", "pooled", "given" or "exact" (no noise and no covariance). The covariances stated are
    the camera's; what the robot adds is for the analysis to find out.
    """
    T = arm.camera_poses(joint_angles, target)
    if robot is not None:
        T = _moved(T, _draw_robot(arm, joint_angles, robot, rng, target))
    covariance, common = None, None
    if estimator != "exact":
        covariance, common = camera_noise(T[:, :3, :3], estimator=estimator, sigma_px=sigma_px)
        errors = np.einsum("nij,nj->ni", np.linalg.cholesky(covariance), rng.normal(0.0, 1.0, (len(T), 6)))
        if common is not None:
            errors += common @ rng.normal(0.0, 1.0, common.shape[2])
        T = _moved(T, errors)
    labels = tuple(f"P{i + 1:03d}" for i in range(len(T)))
    return PoseData(joint_angles, T[:, :3, 3], T[:, :3, :3], covariance, common, target, labels)


def camera_noise(
    rotations: Float[np.ndarray, "n 3 3"], *, estimator: str = "pooled", sigma_px: float = 0.05
) -> tuple[Float[np.ndarray, "n 6 6"], Float[np.ndarray, "n 6 9"] | None]:
    """Return the covariance of poses measured at orientations R_target_camera, and what is common to all of them.

    Both have the coordinates of `PoseData`.
    """
    views = [_information(index, sigma_px) for index in range(min(_VIEWS, len(rotations)))]
    A, B, D = (np.array([view[k] for view in views]) for k in range(3))
    if estimator == "per_image":
        prior = _lens_prior(tangential=_HELD)
        inside = np.linalg.inv(A - B @ np.linalg.inv(D + prior) @ B.swapaxes(1, 2))
        shared = None
    elif estimator in ("pooled", "given"):
        inside = np.linalg.inv(A)
        prior = _lens_prior(tangential=3e-4)
        times = np.bincount(np.arange(len(rotations)) % len(views), minlength=len(views))
        lens = np.linalg.inv(prior + np.tensordot(times, D - B.swapaxes(1, 2) @ inside @ B, axes=1))
        shared = -inside @ B @ np.linalg.cholesky(lens) if estimator == "pooled" else None
    else:
        raise ValueError(f"There is no estimator {estimator!r} here.")
    which = np.arange(len(rotations)) % len(views)
    turn = np.zeros((len(rotations), 6, 6))
    turn[:, :3, :3] = turn[:, 3:, 3:] = rotations
    covariance = turn @ inside[which] @ turn.swapaxes(1, 2)
    return covariance, None if shared is None else turn @ shared[which]


@cache  # of two dozen views, whatever the arm
def _information(
    index: int, sigma_px: float
) -> tuple[Float[np.ndarray, "6 6"], Float[np.ndarray, "6 9"], Float[np.ndarray, "9 9"]]:
    """Return what one view determines of the camera's pose (d, w in camera axes) and of the lens.

    A camera moved by d and turned by w sees the points X move by -d - w × X.
    """
    side = 2.0 * math.pi * index * 0.381966  # the golden angle: any number of views spreads evenly
    grid = _GRID.points_target()
    R = so3_exp(_TILT * np.array([math.cos(side), math.sin(side), 0.0])) @ so3_exp(
        np.array([0.0, 0.0, 0.7 * index])
    )
    points = (grid - grid.mean(axis=0)) @ R.T + [0.0, 0.0, _DISTANCE_MM]
    _, by_camera, by_point = project_with_jacobian(points, _CAMERA)
    motion = np.array([np.hstack([-np.eye(3), hat(X)]) for X in points])
    by_pose = np.einsum("con,nci->ion", by_point, motion).reshape(6, -1) / sigma_px
    by_lens = by_camera.reshape(9, -1) / sigma_px
    return by_pose @ by_pose.T, by_pose @ by_lens.T, by_lens @ by_lens.T


def _lens_prior(tangential: float) -> Float[np.ndarray, "9 9"]:
    """Return the information assumed of any lens: centre 1 %, fx/fy 1e-3, k1 .3, k2 .5, p1 and p2 as given, no k3."""
    standard = np.array(
        [math.inf, math.inf, 0.01 * _WIDTH_PX, 0.01 * _WIDTH_PX, 0.3, 0.5, tangential, tangential, _HELD]
    )
    prior = np.diag(standard**-2)
    tie = np.zeros(9)
    tie[:2] = 1.0, -1.0
    return np.asarray(prior + np.outer(tie, tie) / (1e-3 * _CAMERA.fx_px) ** 2)


def _draw_robot(
    arm: Arm,
    joint_angles: Float[np.ndarray, "n j"],
    robot: Repeatability,
    rng: np.random.Generator,
    target: Int[np.ndarray, " n"] | None,
) -> Float[np.ndarray, "n 6"]:
    count, joints = joint_angles.shape
    scale = np.repeat([robot.position_mm, robot.rotation_rad], 3)
    errors = rng.normal(0.0, 1.0, (count, 6)) * scale
    which = np.zeros(count, dtype=np.intp) if target is None else target
    _, J = pose_with_jacobian(
        arm.chain.as_array(), joint_angles, arm.T_target_base[which], arm.T_flange_camera
    )
    by_joint = J[3 : 5 * joints : 5]  # a joint's turn is its offset's
    return np.asarray(
        errors + np.einsum("jin,nj->ni", by_joint, rng.normal(0.0, robot.joint_rad, joint_angles.shape))
    )


def _moved(T: Float[np.ndarray, "n 4 4"], motions: Float[np.ndarray, "n 6"]) -> Float[np.ndarray, "n 4 4"]:
    """Return the poses after small motions: t ← t + d, R ← exp(w) R."""
    moved = T.copy()
    moved[:, :3, 3] += motions[:, :3]
    moved[:, :3, :3] = np.array([so3_exp(w) for w in motions[:, 3:]]).reshape(-1, 3, 3) @ T[:, :3, :3]
    return moved
