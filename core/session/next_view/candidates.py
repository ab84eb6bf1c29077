"""Views of a target that a camera could take: tilted, turned, near and far, anywhere in the image."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Bool, Float

from core.geometry import AnyCamera, project_any, rotations_from_vectors
from core.targets import TargetSpec

MAX_TILT = math.radians(50.0)
FILL = (0.35, 0.95)
"""Of the shorter side: how much of it the target's longer side takes."""
UPRIGHT = (0.0, math.radians(20.0))
_SEED = 11
_DRAWS_PER_VIEW = 40
"""At most: a camera that can hardly show the target gives fewer views than asked for."""


def candidate_views(
    spec: TargetSpec,
    camera: AnyCamera,
    size_px: tuple[int, int],
    count: int,
    seed: int = _SEED,
    *,
    turns: tuple[float, float] = UPRIGHT,
) -> Float[np.ndarray, "n 4 4"]:
    """Return up to `count` poses T_camera_target (mm) that show the whole target with a pitch around it.

    Tilts go to `MAX_TILT` about any axis in the image, more of them steep than not. `turns` about the optical axis are
    their middle and half their range, rad: those of a hand that keeps the image upright unless stated.
    """
    rng = np.random.default_rng(seed)
    points = spec.points_target()
    middle, extent = points.mean(axis=0), float(np.ptp(points, axis=0).max()) + 2.0 * spec.pitch_mm
    focal = float(camera.as_array()[:2].mean())
    found = np.zeros((0, 4, 4))
    for _ in range(_DRAWS_PER_VIEW):
        if len(found) >= count:
            break
        side, lean = rng.uniform(0.0, 2.0 * math.pi, count), MAX_TILT * np.sqrt(rng.uniform(size=count))
        turn = turns[0] + rng.uniform(-1.0, 1.0, count) * turns[1]
        across_axis = np.column_stack([np.cos(side), np.sin(side), np.zeros(count)])
        about_axis = np.column_stack([np.zeros((count, 2)), turn])
        T = np.tile(np.eye(4), (count, 1, 1))
        T[:, :3, :3] = rotations_from_vectors(lean[:, None] * across_axis) @ rotations_from_vectors(
            about_axis
        )
        depth = focal * extent / (rng.uniform(*FILL, count) * min(size_px))
        at_px = np.column_stack([rng.uniform(-0.5, 0.5, (count, 2)) * size_px, np.full(count, focal)])
        T[:, :3, 3] = at_px * depth[:, None] / focal - T[:, :3, :3] @ middle
        found = np.concatenate([found, T[shows_target(T, spec, camera, size_px)]])
    return found[:count]


def shows_target(
    T: Float[np.ndarray, "n 4 4"], spec: TargetSpec, camera: AnyCamera, size_px: tuple[int, int]
) -> Bool[np.ndarray, " n"]:
    """Return in which views T_camera_target (mm) the whole target with a pitch around it is before the camera and in
    the image.
    """
    points = np.concatenate([spec.points_target(), spec.outline()])
    seen = points @ T[:, :3, :3].transpose(0, 2, 1) + T[:, None, :3, 3]
    ahead = seen[:, :, 2].min(axis=1) > 0.0
    seen[~ahead] = [0.0, 0.0, 1.0]
    pixels = project_any(seen.reshape(-1, 3), camera).reshape(*seen.shape[:2], 2)
    inside = (pixels >= 0.0) & (pixels <= np.array(size_px) - 1.0)
    return np.asarray(ahead & np.all(inside, axis=(1, 2)))
