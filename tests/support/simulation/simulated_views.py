"""Random views as points: what a perfect detector would report of a board before a camera, with noise of
known size.

Cameras are drawn from the very priors that the single-image fit assumes, so that a stated 95 % interval has
to cover 95 % of the truths, no more and no less. No image is rendered; `scenes` and `renderer` do that.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from core.calibration.priors import (
    ASPECT_PRIOR,
    FOCAL_PRIOR,
    PRINCIPAL_POINT_PRIOR,
    RADIAL_PRIORS,
    TANGENTIAL_PRIOR,
)
from core.geometry.camera import Camera, project
from core.geometry.se3 import so3_exp, transform, transform_points
from core.targets.specification import GridPoints, TargetSpec


@dataclass(frozen=True, slots=True)
class View:
    """Points as detected, and the truth behind them."""

    points: GridPoints
    camera: Camera
    T_camera_target: Float[np.ndarray, "4 4"]


def draw_camera(
    rng: np.random.Generator, width_px: int = 2448, height_px: int = 2050, focal_px: float = 2320.0
) -> Camera:
    """Draw a camera of about one focal length: principal point, p1 and p2 from the priors of a single view, pixels that
    are square within .1 %, and moderate barrel distortion.
    """
    fx = focal_px * math.exp(rng.normal(0.0, 0.05))
    fy = fx * math.exp(rng.normal(0.0, 1e-3))
    cx, cy = rng.normal(
        [0.5 * (width_px - 1), 0.5 * (height_px - 1)], PRINCIPAL_POINT_PRIOR * max(width_px, height_px)
    )
    k1, k2 = rng.normal([-0.1, 0.05], 0.05)
    p1, p2 = rng.normal(0.0, TANGENTIAL_PRIOR, 2)
    return Camera(fx, fy, float(cx), float(cy), float(k1), float(k2), float(p1), float(p2))


def draw_camera_from_priors(rng: np.random.Generator, width_px: int = 2448, height_px: int = 2050) -> Camera:
    """Draw every parameter from the priors of a single view; a lens that folds back within the image is drawn again."""
    longer = max(width_px, height_px)
    centre = np.array([0.5 * (width_px - 1), 0.5 * (height_px - 1)])
    while True:
        fx = longer * math.exp(rng.normal(*FOCAL_PRIOR))
        fy = fx * math.exp(rng.normal(0.0, ASPECT_PRIOR))
        cx, cy = rng.normal(centre, PRINCIPAL_POINT_PRIOR * longer)
        k1, k2 = rng.normal(0.0, RADIAL_PRIORS)
        p1, p2 = rng.normal(0.0, TANGENTIAL_PRIOR, 2)
        r = np.linspace(0.0, 1.2 * float(np.hypot(*centre)) / fx, 50)
        if np.all(1.0 + 3.0 * k1 * r**2 + 5.0 * k2 * r**4 > 0.1):
            return Camera(fx, fy, float(cx), float(cy), float(k1), float(k2), float(p1), float(p2))


def draw_pose(
    rng: np.random.Generator, target: TargetSpec, camera: Camera, width_px: int, tilt: float
) -> Float[np.ndarray, "4 4"]:
    """Draw T_camera_target with the given tilt (rad) about a random axis, the board filling 40-75 % of the
    width."""
    points = target.points_target()
    extent = float(np.max(np.ptp(points, axis=0)))
    depth = camera.fx_px * extent / (rng.uniform(0.4, 0.75) * width_px)
    direction = rng.uniform(0.0, 2.0 * math.pi)
    axis = np.array([math.cos(direction), math.sin(direction), 0.0])
    rotation = so3_exp(tilt * axis) @ so3_exp(np.array([0.0, 0.0, rng.uniform(-0.5, 0.5)]))
    centre = np.array([*rng.uniform(-0.04, 0.04, 2) * depth, depth])
    return transform(rotation, centre - rotation @ points.mean(axis=0))


def draw_view(
    rng: np.random.Generator,
    *,
    columns: int = 14,
    rows: int = 10,
    tilt_deg: float = 30.0,
    sigma_px: float = 0.05,
    width_px: int = 2448,
    height_px: int = 2050,
    camera: Camera | None = None,
) -> View:
    """Draw a view of a chessboard of 10 mm pitch; noise is white, `sigma_px` in u and in v."""
    target = TargetSpec("chessboard", columns, rows, 10.0)
    camera = camera or draw_camera(rng, width_px, height_px)
    T_camera_target = draw_pose(rng, target, camera, width_px, math.radians(tilt_deg))
    exact = project(transform_points(T_camera_target, target.points_target()), camera)
    row, column = (a.ravel() for a in np.mgrid[0:rows, 0:columns])
    points = GridPoints(
        target,
        width_px,
        height_px,
        column,
        row,
        exact + rng.normal(0.0, sigma_px, exact.shape),
        np.full(len(exact), sigma_px),
    )
    return View(points, camera, T_camera_target)


def draw_view_from_priors(rng: np.random.Generator, *, sigma_px: float, tilt_deg: float, **grid: int) -> View:
    """Draw a view of a camera from the priors, with all its points within the image."""
    while True:
        view = draw_view(
            rng, sigma_px=sigma_px, tilt_deg=tilt_deg, camera=draw_camera_from_priors(rng), **grid
        )
        size = view.points.image_width_px, view.points.image_height_px
        if np.all((view.points.points_px > 0.0) & (view.points.points_px < np.subtract(size, 1))):
            return view
