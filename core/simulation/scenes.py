"""Scenes: a target before a camera, with everything about it known."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from core.errors import InvalidArgument
from core.geometry import Camera, compose, project, so3_exp, transform, transform_points
from core.targets import GridPoints, TargetSpec


@dataclass(frozen=True, slots=True)
class Light:
    """How bright the sheet's inks look, in 8-bit grey levels, and how that varies over the image.

    The levels are multiplied by (1 + gradient · q) (1 - vignetting r²), with q the pixel's place from -1 to 1
    across width and height, r its distance from the centre in half diagonals.
    """

    black_level: float = 30.0
    white_level: float = 205.0
    gradient: tuple[float, float] = (0.0, 0.0)
    vignetting: float = 0.0


@dataclass(frozen=True, slots=True)
class Scene:
    """One image to be rendered, with its ground truth.

    `blur_px` is the standard deviation of the lens's Gaussian blur (at least .1), which comes on top of the
    pixel's own area; `noise_levels` that of white noise in 8-bit grey levels; `quiet_zone` the white margin
    around the board in pitches; `clutter` from 0 (plain background) to 1. `seed` draws the noise,
    `background_seed` what lies behind the sheet. `origin_dot` is how much wider the dot at the origin of a board of
    dots is than the others: some print it so to mark it. `marks` prints a chessboard's marked squares.
    """

    target: TargetSpec
    camera: Camera
    T_camera_target: Float[np.ndarray, "4 4"]
    width_px: int = 2448
    height_px: int = 2050
    blur_px: float = 1.0
    noise_levels: float = 0.0
    light: Light = field(default_factory=Light)
    bit_depth: int = 8
    quiet_zone: float = 1.0
    clutter: float = 0.0
    seed: int = 0
    background_seed: int = 0
    origin_dot: float = 1.0
    marks: bool = False

    def __post_init__(self) -> None:
        if self.bit_depth not in (8, 16):
            raise InvalidArgument(f"bit_depth must be 8 or 16, got {self.bit_depth}.")
        if self.blur_px < 0.1:
            raise InvalidArgument(f"blur_px must be at least .1, got {self.blur_px}.")

    @property
    def points_px(self) -> Float[np.ndarray, "n 2"]:
        """The true pixels of all grid points, row-major."""
        return project(transform_points(self.T_camera_target, self.target.points_target()), self.camera)

    @property
    def grid_points(self) -> GridPoints:
        """The same as a detector would hand them over, without uncertainty."""
        return GridPoints.whole(self.target, (self.width_px, self.height_px), self.points_px, 0.0)


def random_pose(
    target: TargetSpec,
    camera: Camera,
    size_px: tuple[int, int],
    tilt: float,
    max_roll: float,
    rng: np.random.Generator,
) -> Float[np.ndarray, "4 4"]:
    """Return a random T_camera_target of the given tilt (rad) that has the whole board in the image.

    The board fills from 45 to 90 % of the largest size at which it fits.
    """
    axis_angle = rng.uniform(0.0, 2.0 * math.pi)
    axis = np.array([math.cos(axis_angle), math.sin(axis_angle), 0.0])
    rotation = so3_exp(tilt * axis) @ so3_exp(np.array([0.0, 0.0, rng.uniform(-max_roll, max_roll)]))
    points = target.points_target()
    middle = (points.min(axis=0) + points.max(axis=0)) / 2.0
    turned = transform(rotation, -rotation @ middle)  # the board's middle at the origin
    far = _fitting_distance(turned, target, camera, size_px) / rng.uniform(0.45, 0.9)
    for reach in np.linspace(1.0, 0.0, 41):  # displaced as far as the frame allows
        shift = rng.uniform(-0.5, 0.5, 2) * reach * far * np.array(size_px) / (camera.fx_px, camera.fy_px)
        T_camera_target = compose(transform(np.eye(3), np.array([*shift, far])), turned)
        if _is_in_view(T_camera_target, target, camera, size_px):
            return T_camera_target
    raise InvalidArgument("No pose with this tilt has the whole board in view.")


def _fitting_distance(
    turned: Float[np.ndarray, "4 4"], target: TargetSpec, camera: Camera, size_px: tuple[int, int]
) -> float:
    """Return the least distance (mm) at which the turned board, straight ahead, is all in view."""
    size = max(target.columns, target.rows) * target.pitch_mm
    near, far = 0.5 * size, 40.0 * size
    while far / near > 1.01:
        distance = math.sqrt(near * far)
        T = compose(transform(np.eye(3), np.array([0.0, 0.0, distance])), turned)
        near, far = (near, distance) if _is_in_view(T, target, camera, size_px) else (distance, far)
    return far


def _is_in_view(
    T_camera_target: Float[np.ndarray, "4 4"], target: TargetSpec, camera: Camera, size_px: tuple[int, int]
) -> bool:
    """Return whether the grid, and one pitch around it, lies in the image."""
    corners = transform_points(T_camera_target, target.outline())
    if np.any(corners[:, 2] <= 0.0):
        return False
    pixels = project(corners, camera)
    return bool(np.all(pixels > 4.0) and np.all(pixels < np.array(size_px) - 5.0))
