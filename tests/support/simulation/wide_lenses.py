"""Sessions of points before a lens of any model, drawn from the priors of its fit, the board reaching the edges."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from core.calibration import (
    GroupEstimate,
    LensChoice,
    estimate_group,
    number_labels,
    select_lens,
    stack_views,
)
from core.calibration.priors import (
    ASPECT_PRIOR,
    CURVATURE_ANGLES,
    CURVATURE_MEANS,
    CURVATURE_PRIORS,
    PRINCIPAL_POINT_PRIOR,
    RADIAL_PRIORS,
    RATIONAL_PRIORS,
    TANGENTIAL_PRIOR,
)
from core.geometry import (
    AnyCamera,
    Camera,
    KannalaBrandtCamera,
    LensModel,
    RationalCamera,
    fold_radius_px,
    project_any,
    so3_exp,
    transform,
    transform_points,
)
from core.targets import GridPoints, TargetSpec

WIDTH, HEIGHT = 1280, 960
BOARD = TargetSpec("chessboard", 9, 6, 25.0)
FOCALS: dict[LensModel, float] = {"brown": 0.8, "kannala_brandt": 0.45, "rational": 0.55}
"""Of the image's width, about."""


@dataclass(frozen=True, slots=True)
class WideSession:
    """Views of one camera, and the truth behind them."""

    camera: AnyCamera
    views: tuple[GridPoints, ...]
    T_camera_target: tuple[Float[np.ndarray, "4 4"], ...]


def draw_lens(rng: np.random.Generator, model: LensModel) -> AnyCamera:
    """Draw a camera from the priors of its model's fit, its focal length but for 10 %, until none folds."""
    centre = np.array([0.5 * (WIDTH - 1), 0.5 * (HEIGHT - 1)])
    while True:
        fx = FOCALS[model] * WIDTH * math.exp(rng.normal(0.0, 0.1))
        fy = fx * math.exp(rng.normal(0.0, ASPECT_PRIOR))
        cx, cy = rng.normal(centre, PRINCIPAL_POINT_PRIOR * WIDTH).tolist()
        p1, p2 = rng.normal(0.0, TANGENTIAL_PRIOR, 2).tolist()
        if model == "kannala_brandt":
            corner = min(math.hypot(*centre) / fx, 1.5)
            steps = rng.normal(0.0, CURVATURE_PRIORS)
            kappa = np.array(CURVATURE_MEANS) + np.cumsum(steps)
            powers = (np.array(CURVATURE_ANGLES) * corner)[:, None] ** np.array([0, 2, 4, 6])
            k = np.linalg.solve(powers, kappa).tolist()
            camera: AnyCamera = KannalaBrandtCamera(fx, fy, cx, cy, *k, p1=p1, p2=p2)
        elif model == "rational":
            k = {name: float(rng.normal(0.0, sigma)) for name, sigma in RATIONAL_PRIORS.items()}
            camera = RationalCamera(fx, fy, cx, cy, p1=p1, p2=p2, **k)
        else:
            k1, k2 = rng.normal([-0.1, 0.0], [0.5 * sigma for sigma in RADIAL_PRIORS]).tolist()
            camera = Camera(fx, fy, cx, cy, k1, k2, p1, p2)
        fold = fold_radius_px(camera)
        radius = 1.15 * math.hypot(*centre)
        if (fold is None or fold > radius) and _reaches(camera, radius):
            return camera


def _reaches(camera: AnyCamera, radius: float) -> bool:
    """Return whether directions up to 75° from the axis cover the image."""
    angle = np.linspace(0.0, math.radians(75.0), 60)
    seen = project_any(np.column_stack([np.sin(angle), 0.0 * angle, np.cos(angle)]), camera)[:, 0]
    return bool(np.all(np.diff(seen) > 0.0) and seen[-1] - camera.cx_px > radius)


def draw_session(
    rng: np.random.Generator,
    model: LensModel,
    *,
    images: int = 12,
    sigma_px: float = 0.05,
    bow_mm: float = 0.0,
) -> WideSession:
    """Draw a camera and views of a chessboard in all parts of the image, tilted by 10° to 40°."""
    return look_around(rng, draw_lens(rng, model), images=images, sigma_px=sigma_px, bow_mm=bow_mm)


def look_around(
    rng: np.random.Generator, camera: AnyCamera, *, images: int, sigma_px: float, bow_mm: float = 0.0
) -> WideSession:
    """Draw views before a camera, every point within the image; a bowed board stands out by `bow_mm` in its middle."""
    nominal = BOARD.points_target()
    middle, half = nominal.mean(axis=0), 0.5 * float(np.ptp(nominal, axis=0).max())
    printed = nominal.copy()
    printed[:, 2] += bow_mm * (1.0 - np.sum((nominal - middle)[:, :2] ** 2, axis=1) / half**2)
    row, column = (a.ravel() for a in np.mgrid[0 : BOARD.rows, 0 : BOARD.columns])
    views, poses = [], []
    while len(views) < images:
        direction = rng.uniform(0.0, 2.0 * math.pi)
        off, depth = math.radians(rng.uniform(0.0, 40.0)), rng.uniform(150.0, 330.0)
        facing = so3_exp(off * np.array([-math.sin(direction), math.cos(direction), 0.0]))
        about = rng.uniform(0.0, 2.0 * math.pi)
        tilt = math.radians(rng.uniform(10.0, 40.0)) * np.array([math.cos(about), math.sin(about), 0.0])
        rotation = facing @ so3_exp(tilt) @ so3_exp(np.array([0.0, 0.0, rng.uniform(-0.5, 0.5)]))
        T = transform(rotation, facing @ np.array([0.0, 0.0, depth]) - rotation @ middle)
        in_camera = transform_points(T, printed)
        if np.min(in_camera[:, 2]) < 40.0:
            continue
        exact = project_any(in_camera, camera)
        if np.min(exact) < 5.0 or np.any(exact > np.array([WIDTH, HEIGHT]) - 6.0):
            continue
        seen = exact + rng.normal(0.0, sigma_px, exact.shape)
        views.append(GridPoints(BOARD, WIDTH, HEIGHT, column, row, seen, np.full(len(exact), sigma_px)))
        poses.append(T)
    return WideSession(camera, tuple(views), tuple(poses))


def choose_lens(
    views: Sequence[GridPoints], asked: LensModel | None = None
) -> tuple[LensChoice, GroupEstimate]:
    """Return the lens model selected for views of one camera, and their pooled estimate with it."""
    stack = stack_views(views)
    brown = estimate_group(stack, "pooled")
    choice = select_lens(stack, number_labels(range(len(stack))), None, brown, asked)
    if choice.start is None:
        return choice, brown
    return choice, estimate_group(stack, "pooled", lens_start=choice.start)
