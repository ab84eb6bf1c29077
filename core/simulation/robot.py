"""An image of a robot session with its truth, and what a workshop looks like."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from core.camera import Camera
from core.simulation.scenes import Light, Scene
from core.targets.specification import TargetSpec
from core.transforms import invert


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
