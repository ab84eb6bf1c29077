"""A robot's camera before one or two grids: joint angles and the grid points of each image, drawn with noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from core.geometry.camera import Camera
from core.geometry.lens_models import AnyCamera, project_any
from core.geometry.se3 import invert, so3_exp, transform, transform_points
from core.kinematics.pose_observations import PoseData
from core.session import ImageObservation, SessionData, SessionEstimate, estimate_session, group_views
from core.session.robot.robot_poses import poses_of_estimate
from core.simulation.arm import KR5_ARC_HOME, KR5_ARC_LIMITS, Arm, kr5_arc
from core.simulation.looking import sample_viewing_configurations
from core.simulation.scenes import Scene
from core.targets.specification import GridPoints, TargetSpec

GRID = TargetSpec("chessboard", 14, 9, 25.0)
CAMERA = Camera(2350.0, 2348.0, 1230.0, 1018.0, -0.1, 0.05, 1e-4, -2e-4)
SIZE = (2448, 2050)


def session(
    seed: int,
    *,
    count: int = 36,
    sigma_px: float = 0.02,
    position_mm: float = 0.0,
    rotation_rad: float = 0.0,
    targets: int = 1,
    grid: TargetSpec = GRID,
    bow_mm: float = 0.0,
    camera: AnyCamera = CAMERA,
) -> tuple[Arm, np.ndarray, list[GridPoints], np.ndarray]:
    """An arm, joint angles, the grid points seen there, and which target it was."""
    rng = np.random.default_rng(seed)
    arm = kr5_arc(rng)
    second = invert(arm.T_target_base[0]) @ transform(
        so3_exp(np.array([0.5, 0.3, 0.2])), np.array([150.0, 80.0, 30.0])
    )
    arm = replace(arm, T_target_base=np.array([arm.T_target_base[0], invert(second)]))
    each = [
        sample_viewing_configurations(
            arm, grid, CAMERA, SIZE, rng, count // targets, home=KR5_ARC_HOME, limits=KR5_ARC_LIMITS, target=t
        )
        for t in range(targets)
    ]
    q, target = np.concatenate(each), np.repeat(np.arange(targets), count // targets)
    views = []
    for T in arm.camera_poses(q, target):
        e = rng.normal(0.0, 1.0, 6) * np.repeat([position_mm, rotation_rad], 3)
        camera_pose = transform(so3_exp(e[3:]) @ T[:3, :3], T[:3, 3] + e[:3])
        points = Scene(grid, CAMERA, invert(camera_pose), *SIZE).grid_points
        printed = points.points_target
        q_xy = printed[:, :2] / np.ptp(printed[:, :2], axis=0) - 0.5
        printed = printed + np.column_stack([np.zeros((len(printed), 2)), bow_mm * np.sum(q_xy**2, axis=1)])
        pixels = project_any(transform_points(invert(camera_pose), printed), camera)
        noisy = pixels + rng.normal(0.0, sigma_px, points.points_px.shape)
        views.append(
            replace(points, points_px=noisy, standard_uncertainty_px=np.full(len(noisy), max(sigma_px, 1e-3)))
        )
    return arm, q, views, target


def observed(
    views: list[GridPoints], joint_angles: np.ndarray, target: np.ndarray | None = None
) -> tuple[SessionData, SessionEstimate]:
    """The session of these images, each of a pose of its own (P0, P1, ...), and its estimate."""
    targets = np.zeros(len(views), dtype=np.intp) if target is None else target
    images = tuple(
        ImageObservation(
            f"m{i}", f"P{i}", 1, f"i{i}", int(targets[i]), "default", np.degrees(q).tolist(), *SIZE
        )
        for i, q in enumerate(joint_angles)
    )
    specs = tuple(views[int(np.argmax(targets == t))].target for t in range(int(targets.max()) + 1))
    data = SessionData(
        specs, tuple(f"T{t}" for t in range(len(specs))), images, group_views(images, dict(enumerate(views)))
    )
    estimate = estimate_session(data)
    assert not estimate.excluded
    return data, estimate


def image_poses(
    views: list[GridPoints], joint_angles: np.ndarray, target: np.ndarray | None = None
) -> PoseData:
    """What an identification takes of these images: their poses, with the errors of lens and print in common."""
    return poses_of_estimate(*observed(views, joint_angles, target)).poses
