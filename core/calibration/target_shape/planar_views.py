"""Where the estimate of a target's shape begins: camera and views before the nominal target, and their directions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from core.calibration.multi_view import calibrate_views, estimate_group, stack_views
from core.calibration.priors import Lens
from core.geometry import AnyCamera, Camera, invert, transform
from core.targets import GridPoints

MIN_VIEW_ANGLE = math.radians(5.0)
MIN_TILT = math.radians(10.0)


@dataclass(frozen=True, slots=True)
class PlanarViews:
    """Camera and views before the nominal target: which of them, and the points used (empty: by their residuals)."""

    camera: AnyCamera
    kept: Int[np.ndarray, " k"]
    T_camera_target: Float[np.ndarray, "k 4 4"]
    used: tuple[Bool[np.ndarray, " _"], ...]


def planar_views(views: Sequence[GridPoints], lens: Lens | None, start: AnyCamera | None) -> PlanarViews:
    """Estimate camera and poses before the nominal target, with the lens model of `start`, None for Brown's."""
    if start is None or isinstance(start, Camera):
        found = calibrate_views(views, lens=lens)
        kept = np.array([i for i, used in enumerate(found.used) if used.any()])
        poses = np.array([found.T_camera_target[i] for i in kept])
        return PlanarViews(found.camera, kept, poses, tuple(found.used[i] for i in kept))
    group = estimate_group(stack_views(views), "pooled", lens=lens, lens_start=start)
    seen = zip(group.rotations, group.positions_mm, strict=True)
    return PlanarViews(group.camera, group.images, np.array([invert(transform(R, t)) for R, t in seen]), ())


def count_directions(rotations: Float[np.ndarray, "m 3 3"]) -> int:
    """Return how many of the tilted views R_camera_target differ from one another by more than `MIN_VIEW_ANGLE`."""
    leaders: list[Float[np.ndarray, "3 3"]] = []
    for R in rotations:
        if math.acos(min(abs(float(R[2, 2])), 1.0)) < MIN_TILT:
            continue
        if all(0.5 * (float(np.sum(R * other)) - 1.0) < math.cos(MIN_VIEW_ANGLE) for other in leaders):
            leaders.append(R)
    return len(leaders)
