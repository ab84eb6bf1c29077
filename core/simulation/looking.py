"""Joint angles at which a camera on an arm looks at a target: free poses, and sweeps that keep it in view."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Bool, Float

from core.geometry import Camera, invert, project, so3_exp, transform
from core.simulation.arm import Arm, reach
from core.targets import TargetSpec

MARGIN_PX = 10.0
_STEP = math.radians(2.0)  # of a joint that is moved as far as the grid stays in view
_LARGEST_SWEEP = math.radians(120.0)
_STEEPEST = math.radians(60.0)


def sample_viewing_configurations(
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
        if not in_view(T_camera_target[None], spec, camera, size_px)[0]:
            continue
        angles = reach(arm, invert(T_camera_target), home, target)
        if angles is not None and np.all(angles > limits[:, 0]) and np.all(angles < limits[:, 1]):
            found.append(angles)
    raise ValueError("The arm can hardly look at this target.")


def largest_visible_sweep(
    arm: Arm,
    spec: TargetSpec,
    camera: Camera,
    size_px: tuple[int, int],
    through: Float[np.ndarray, "n j"],
    joint: int,
    *,
    limits: Float[np.ndarray, "j 2"],
    steps: int,
    target: int = 0,
    smallest: float = math.radians(10.0),
) -> Float[np.ndarray, "m j"]:
    """Return the deepest sweep (rad) of one joint through any of the given poses that keeps the grid in view.

    The joint (counted from 0) is turned both ways until the grid or a pitch around it would leave the image, be seen
    at less than 30°, or the joint come to its limit, or the arc to 120°; `steps` poses are spread over the arc.
    An arc informs by its depth, its deviation from a straight line: of the same angle the deeper, the farther the
    camera is from the axis.

    Raises ValueError where no arc is as wide as `smallest`.
    """
    half = round(_LARGEST_SWEEP / _STEP)
    moves = _STEP * np.arange(-half, half + 1)
    turns = moves[:, None] * np.eye(len(arm.chain))[joint]
    swept = (through[:, None] + turns).reshape(-1, len(arm.chain))
    camera_poses = arm.camera_poses(swept, np.full(len(swept), target))
    T_camera_target = np.linalg.inv(camera_poses)
    seen = in_view(T_camera_target, spec, camera, size_px) & (T_camera_target[:, 2, 2] > math.cos(_STEEPEST))
    seen &= np.all((swept > limits[:, 0]) & (swept < limits[:, 1]), axis=1)
    deepest, best = 0.0, through[:0]
    for pose, of_pose in enumerate(seen.reshape(len(through), -1)):
        if not of_pose[half]:
            continue
        lost = np.flatnonzero(~of_pose)
        first = int(max(lost[lost < half], default=-1)) + 1
        last = int(min(lost[lost > half], default=len(moves))) - 1
        if last - first > half:  # wider than need be: as much to either side as there is
            first = min(max(first, half - half // 2), last - half)
            last = first + half
        ends = pose * len(moves) + np.array([first, last])
        arc = _STEP * (last - first)
        chord = float(np.linalg.norm(np.ptp(camera_poses[ends, :3, 3], axis=0)))
        depth = 0.5 * chord * math.tan(arc / 4.0)
        if arc >= smallest and depth > deepest:
            deepest, best = depth, np.linspace(swept[ends[0]], swept[ends[1]], steps)
    if not len(best):
        raise ValueError(f"Joint {joint + 1} can hardly move without losing the target.")
    return np.asarray(best)


def in_view(
    T_camera_target: Float[np.ndarray, "n 4 4"], spec: TargetSpec, camera: Camera, size_px: tuple[int, int]
) -> Bool[np.ndarray, " n"]:
    """Return in which views the grid and a pitch around it are in the image, a few pixels from its edge."""
    rotations = T_camera_target[:, :3, :3]
    corners = np.einsum("nij,kj->nki", rotations, spec.outline()) + T_camera_target[:, None, :3, 3]
    ahead = np.all(corners[:, :, 2] > spec.pitch_mm, axis=1)
    corners[~ahead] = [0.0, 0.0, 1.0]
    pixels = project(corners.reshape(-1, 3), camera).reshape(-1, 4, 2)
    inside = (pixels >= MARGIN_PX) & (pixels <= np.array(size_px) - MARGIN_PX)
    return np.asarray(ahead & np.all(inside, axis=(1, 2)))
