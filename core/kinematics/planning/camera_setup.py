"""Camera and grid before a robot is moved: where they are, and what a perfect detector would find at joint angles."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from core.calibration import Lens
from core.geometry import Camera, invert, project, transform, transform_points
from core.kinematics.dh import Chain, forward
from core.targets import GridPoints, TargetSpec

LARGEST_TILT = math.radians(65.0)  # beyond it grids are hardly detected


@dataclass(frozen=True, slots=True)
class CameraSetup:
    """Camera and grid: where they are, and how well grid points are located.

    `noise_px` the standard deviation of a grid point's coordinate;
    `scatter_position_mm` and `scatter_rotation` (rad) the robot's own, of each coordinate of the camera's pose.
    """

    camera: Camera
    width_px: int
    height_px: int
    noise_px: float
    target: TargetSpec
    T_flange_camera: Float[np.ndarray, "4 4"]
    T_target_base: Float[np.ndarray, "4 4"]
    scatter_position_mm: float = 0.0
    scatter_rotation: float = 0.0
    lens: Lens | None = None


def default_setup(
    chain: Chain,
    home: Float[np.ndarray, " j"],
    camera: Camera,
    size_px: tuple[int, int],
    target: TargetSpec,
    T_flange_camera: Float[np.ndarray, "4 4"],
    *,
    noise_px: float,
    fill: float = 0.5,
    scatter_position_mm: float = 0.0,
    scatter_rotation: float = 0.0,
) -> CameraSetup:
    """Return a rig with the grid straight before the camera at the joint angles `home` (rad), filling a share of the
    image.
    """
    middle = target.points_target().mean(axis=0)
    extent = np.ptp(target.points_target()[:, :2], axis=0) + target.pitch_mm
    depth = float(np.max(extent * [camera.fx_px, camera.fy_px] / np.array(size_px))) / fill
    T_camera_target = transform(np.eye(3), np.array([0.0, 0.0, depth]) - middle)
    T_base_target = forward(chain, home[None])[0] @ T_flange_camera @ T_camera_target
    return CameraSetup(
        camera,
        *size_px,
        noise_px,
        target,
        T_flange_camera,
        invert(T_base_target),
        scatter_position_mm,
        scatter_rotation,
    )


def count_visible_points(
    chain: Chain, joint_angles: Float[np.ndarray, "n j"], rig: CameraSetup
) -> Bool[np.ndarray, " n"]:
    """Return which joint angles (rad) let the camera see the whole grid from its front, tilted no more than detectors
    take.
    """
    return np.array([view is not None for view in views_of(chain, joint_angles, rig)])


def camera_poses(
    chain: Chain, joint_angles: Float[np.ndarray, "n j"], rig: CameraSetup
) -> Float[np.ndarray, "n 4 4"]:
    """Return T_target_camera at the joint angles (rad)."""
    return np.asarray(rig.T_target_base @ forward(chain, joint_angles) @ rig.T_flange_camera)


def views_of(
    chain: Chain, joint_angles: Float[np.ndarray, "n j"], rig: CameraSetup
) -> list[GridPoints | None]:
    """Return what a perfect detector would find at each pose; None where the grid is not all in view, with a pitch of
    its margin.
    """
    views: list[GridPoints | None] = []
    largest = np.array([rig.width_px, rig.height_px]) - 1.0
    points = rig.target.points_target()
    with_outline = np.concatenate([points, rig.target.outline()])
    for T in camera_poses(chain, joint_angles, rig):
        T_camera_target = invert(T)
        in_camera = transform_points(T_camera_target, with_outline)
        # The target's z points into the board: seen from its front, it points away from the camera.
        facing = float(T_camera_target[2, 2]) > math.cos(LARGEST_TILT)
        if not facing or float(in_camera[:, 2].min()) <= 0.0:
            views.append(None)
            continue
        pixels = project(in_camera, rig.camera)
        if np.any(pixels < 0.0) or np.any(pixels > largest):
            views.append(None)
            continue
        pixels = np.ascontiguousarray(pixels[: len(points)])
        views.append(GridPoints.whole(rig.target, (rig.width_px, rig.height_px), pixels, rig.noise_px))
    return views
