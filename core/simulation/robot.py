"""A camera held by a robot before a fixed target, with the robot's true repeatability known."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from core.camera import Camera
from core.simulation.scenes import Light, Scene
from core.targets.specification import TargetSpec
from core.transforms import compose, invert, so3_exp, transform


@dataclass(frozen=True, slots=True)
class SessionImage:
    """One image a robot session would send: its tags, what the robot was told, and the scene with the truth.

    `commanded_T_target_camera` is the same for all cycles of a pose; `scene.T_camera_target` is what came of
    it.
    """

    pose_id: str
    cycle: int
    commanded_T_target_camera: Float[np.ndarray, "4 4"]
    scene: Scene

    @property
    def true_T_target_camera(self) -> Float[np.ndarray, "4 4"]:
        """Where the camera really was."""
        return invert(self.scene.T_camera_target)


def robot_session(
    target: TargetSpec,
    camera: Camera,
    size_px: tuple[int, int],
    *,
    poses: int = 5,
    cycles: int = 6,
    repeatability_mm: float = 0.03,
    repeatability_rad: float = math.radians(0.005),
    seed: int = 0,
) -> list[SessionImage]:
    """Return the images of a session, pose by pose within each cycle, as ISO 9283 drives them.

    Parameters
    ----------
    size_px
        Width and height of the images.
    repeatability_mm, repeatability_rad
        Standard deviation of the camera's position along each axis, and of its rotation about each.
    """
    rng = np.random.default_rng([seed, 9283])
    commanded = [_pose_around(target, camera, size_px, index, poses, rng) for index in range(poses)]
    digits = len(str(poses))
    images = []
    for cycle in range(1, cycles + 1):
        for index, T_target_camera in enumerate(commanded):
            w, d = rng.normal(0.0, repeatability_rad, 3), rng.normal(0.0, repeatability_mm, 3)
            true = transform(so3_exp(w) @ T_target_camera[:3, :3], T_target_camera[:3, 3] + d)
            scene = workshop_scene(
                target,
                camera,
                invert(true),
                size_px,
                seed=int(rng.integers(2**31)),
                background_seed=seed * 1000 + index,
            )
            images.append(SessionImage(f"P{index + 1:0{digits}d}", cycle, T_target_camera, scene))
    return images


def workshop_scene(
    target: TargetSpec,
    camera: Camera,
    T_camera_target: Float[np.ndarray, "4 4"],
    size_px: tuple[int, int],
    *,
    seed: int,
    background_seed: int,
) -> Scene:
    """Return a scene as robot sessions have it: a good lens and sensor, uneven light, things behind the board."""
    return Scene(
        target=target,
        camera=camera,
        T_camera_target=T_camera_target,
        width_px=size_px[0],
        height_px=size_px[1],
        noise_levels=2.0,
        light=Light(gradient=(0.1, -0.08), vignetting=0.15),
        clutter=0.7,
        seed=seed,
        background_seed=background_seed,
    )


def _pose_around(
    target: TargetSpec,
    camera: Camera,
    size_px: tuple[int, int],
    index: int,
    poses: int,
    rng: np.random.Generator,
) -> Float[np.ndarray, "4 4"]:
    """Return T_target_camera of a camera that looks at the board's middle, 20 to 35° tilted.

    Successive poses tilt to successive sides. The board takes about two thirds of the image.
    """
    middle = np.array([target.columns - 1, target.rows - 1, 0.0]) * target.pitch_mm / 2.0
    extent = np.array([target.columns + 1, target.rows + 1]) * target.pitch_mm
    focal = np.array([camera.fx_px, camera.fy_px])
    distance = float(np.max(extent * focal / (0.62 * np.array(size_px)))) * float(rng.uniform(1.0, 1.15))
    side = 2.0 * math.pi * (index + float(rng.uniform(0.1, 0.5))) / poses
    tilt = math.radians(float(rng.uniform(20.0, 35.0)))
    rotation = so3_exp(tilt * np.array([math.cos(side), math.sin(side), 0.0]))
    rotation = rotation @ so3_exp(np.array([0.0, 0.0, math.radians(float(rng.uniform(-20.0, 20.0)))]))
    ahead = transform(np.eye(3), np.array([0.0, 0.0, distance]))
    T_camera_target = compose(ahead, transform(rotation, -rotation @ middle))
    return invert(T_camera_target)
