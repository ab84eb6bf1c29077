"""Images of a robot that comes to the same poses again and again and stands still: grid points with their truth."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from core.calibration.multi_view.estimators import estimate_group
from core.calibration.multi_view.group_estimate import GroupEstimate
from core.geometry.camera import Camera, project
from core.geometry.se3 import invert, so3_log, transform_points
from core.targets.specification import GridPoints, TargetSpec
from tests.support.simulation.simulated_views import draw_camera, draw_pose

BOARD = TargetSpec("chessboard", 14, 10, 10.0)
WIDTH, HEIGHT = 2448, 2050


def view(
    rng: np.random.Generator,
    camera: Camera,
    T_camera_target: np.ndarray,
    sigma_px: float = 0.05,
    bow_mm: float = 0.0,
) -> GridPoints:
    ideal = BOARD.points_target()
    x, y = (ideal[:, 0] / 130.0 - 0.5), (ideal[:, 1] / 90.0 - 0.5)
    printed = ideal + np.column_stack([np.zeros((len(ideal), 2)), bow_mm * (x * x + y * y)])
    pixels = project(transform_points(T_camera_target, printed), camera)
    row, column = (a.ravel() for a in np.mgrid[0:10, 0:14])
    noisy = pixels + rng.normal(0.0, sigma_px, pixels.shape)
    return GridPoints(BOARD, WIDTH, HEIGHT, column, row, noisy, np.full(len(pixels), sigma_px))


@dataclasses.dataclass(frozen=True)
class Session:
    views: list[GridPoints]
    labels: list[int]
    T_target_camera: np.ndarray
    camera: Camera


def session(
    seed: int, poses: int = 5, cycles: int = 6, tilt_deg: float = 30.0, bow_mm: float = 0.0
) -> Session:
    """A motionless robot: all cycles of a pose see the same."""
    rng = np.random.default_rng(seed)
    camera = draw_camera(rng)
    views, labels, true = [], [], []
    for pose in range(poses):
        T = draw_pose(rng, BOARD, camera, WIDTH, math.radians(tilt_deg))
        for _ in range(cycles):
            views.append(view(rng, camera, T, bow_mm=bow_mm))
            labels.append(pose)
            true.append(invert(T))
    return Session(views, labels, np.array(true), camera)


def estimate(s: Session, estimator: str) -> GroupEstimate:
    return estimate_group(s.views, estimator, intrinsics=s.camera, repeats=s.labels)


def errors(s: Session, found: GroupEstimate) -> np.ndarray:
    """Position and rotation vector, true less estimated, in the target frame."""
    true = s.T_target_camera[found.images]
    turned = [so3_log(T[:3, :3] @ R.T) for T, R in zip(true, found.rotations, strict=True)]
    return np.hstack([true[:, :3, 3] - found.positions_mm, turned])
