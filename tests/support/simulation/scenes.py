"""The standard scenes of tests and benchmarks, and their camera and boards."""

from __future__ import annotations

import math

import numpy as np

from core.geometry import Camera
from core.simulation import Light, Scene, random_pose
from core.targets import TargetSpec


def standard_camera() -> Camera:
    """Return the camera of the standard scenes: 2448 x 2050 pixels, f 2320 px, k1 -.1, k2 .05."""
    return Camera(2320.0, 2320.0, 1229.5, 1020.0, k1=-0.1, k2=0.05)


def standard_target(columns: int, rows: int) -> TargetSpec:
    """Return a chessboard about 300 mm wide, whatever its number of points."""
    return TargetSpec("chessboard", columns, rows, pitch_mm=round(300.0 / columns, 1))


def standard_scene(
    target: TargetSpec,
    seed: int,
    *,
    tilt: float | None = None,
    max_roll: float = math.radians(40.0),
    blur_px: float = 1.0,
    noise_levels: float = 4.0,
    clutter: float = 1.0,
) -> Scene:
    """Return one of the standard scenes: a random pose that shows the whole board, uneven light, clutter.

    Parameters
    ----------
    tilt
        Angle between the optical axis and the board's normal, rad; random from 0 to 60° by default.
    max_roll
        Largest turn about the board's normal, rad.
    """
    rng = np.random.default_rng([seed, 20160516])
    camera = standard_camera()
    if tilt is None:
        tilt = float(rng.uniform(0.0, math.radians(60.0)))
    light = Light(
        black_level=float(rng.uniform(20, 40)),
        white_level=float(rng.uniform(170, 210)),
        gradient=(float(rng.uniform(-0.2, 0.2)), float(rng.uniform(-0.2, 0.2))),
        vignetting=float(rng.uniform(0.05, 0.3)),
    )
    T_camera_target = random_pose(target, camera, (2448, 2050), tilt, max_roll, rng)
    return Scene(
        target=target,
        camera=camera,
        T_camera_target=T_camera_target,
        blur_px=blur_px,
        noise_levels=noise_levels,
        light=light,
        clutter=clutter,
        seed=seed,
        background_seed=seed,
    )
