"""Views of a target that a camera could take: tilted, turned, near and far, anywhere in the image."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from core.geometry import AnyCamera, project_any, so3_exp, transform, transform_points
from core.targets import TargetSpec

MAX_TILT = math.radians(50.0)
FILL = (0.35, 0.95)
"""Of the shorter side: how much of it the target's longer side takes."""
UPRIGHT = (0.0, math.radians(20.0))
_SEED = 11
_DRAWS_PER_VIEW = 40


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
    low, high = points.min(axis=0) - spec.pitch_mm, points.max(axis=0) + spec.pitch_mm
    outline = np.array([[x, y, 0.0] for x in (low[0], high[0]) for y in (low[1], high[1])])
    focal = float(camera.as_array()[:2].mean())
    found: list[Float[np.ndarray, "4 4"]] = []
    for _ in range(_DRAWS_PER_VIEW * count):
        if len(found) == count:
            break
        side, lean = rng.uniform(0.0, 2.0 * math.pi), MAX_TILT * math.sqrt(rng.uniform())
        turn = turns[0] + rng.uniform(-1.0, 1.0) * turns[1]
        R = so3_exp(lean * np.array([math.cos(side), math.sin(side), 0.0])) @ so3_exp(
            np.array([0.0, 0.0, turn])
        )
        depth = focal * extent / (rng.uniform(*FILL) * min(size_px))
        across = np.array([*(rng.uniform(-0.5, 0.5, 2) * size_px), focal]) * depth / focal
        T = transform(R, across - R @ middle)
        seen = transform_points(T, np.concatenate([points, outline]))
        if seen[:, 2].min() <= 0.0:
            continue
        pixels = project_any(seen, camera)
        if np.all(pixels >= 0.0) and np.all(pixels <= np.array(size_px) - 1.0):
            found.append(T)
    return np.array(found).reshape(-1, 4, 4)
