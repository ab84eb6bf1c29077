"""Joint angles at which a camera on an arm looks at a target: what a session of free poses consists of."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from core.camera import Camera, project
from core.simulation.arm import Arm, reach
from core.targets.specification import TargetSpec
from core.transforms import invert, so3_exp, transform, transform_points

MARGIN_PX = 10.0


def looking_angles(
    arm: Arm,
    spec: TargetSpec,
    camera: Camera,
    size_px: tuple[int, int],
    rng: np.random.Generator,
    count: int,
    *,
    home: Float[np.ndarray, " j"],
    limits: Float[np.ndarray, "j 2"],
    target: int = 0,
    tilt: float = math.radians(40.0),
    fill: tuple[float, float] = (0.45, 0.75),
) -> Float[np.ndarray, "n j"]:
    """Draw joint angles (rad) within limits, at each of which the grid and a pitch around it are in the image.

    Views tilt up to `tilt` to any side, turn freely about the optical axis, and let the grid fill a share of the image
    drawn from `fill`; the grid stands anywhere in the image.

    Raises ValueError where the arm can hardly look at the target.
    """
    points = spec.points_target()
    middle = points.mean(axis=0)
    low, high = points.min(axis=0) - spec.pitch_mm, points.max(axis=0) + spec.pitch_mm
    outline = np.array([[x, y, 0.0] for x in (low[0], high[0]) for y in (low[1], high[1])])
    extent = float(np.max(np.ptp(points, axis=0)))
    found: list[Float[np.ndarray, " j"]] = []
    for _ in range(60 * count):
        if len(found) == count:
            return np.array(found)
        side, lean = rng.uniform(0.0, 2.0 * math.pi), tilt * math.sqrt(rng.uniform(0.0, 1.0))
        rotation = so3_exp(lean * np.array([math.cos(side), math.sin(side), 0.0])) @ so3_exp(
            np.array([0.0, 0.0, rng.uniform(-math.pi, math.pi)])
        )
        depth = camera.fx_px * extent / (rng.uniform(*fill) * min(size_px))
        centre = np.array([*rng.uniform(-0.1, 0.1, 2) * depth, depth])
        T_camera_target = transform(rotation, centre - rotation @ middle)
        pixels = project(transform_points(T_camera_target, outline), camera)
        if np.any(pixels < MARGIN_PX) or np.any(pixels > np.array(size_px) - MARGIN_PX):
            continue
        angles = reach(arm, invert(T_camera_target), home, target)
        if angles is not None and np.all(angles > limits[:, 0]) and np.all(angles < limits[:, 1]):
            found.append(angles)
    raise ValueError("The arm can hardly look at this target.")
