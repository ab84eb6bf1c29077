"""Images that several tests look at; rendered once."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np
import pytest

from core.geometry.camera import Camera
from core.simulation import Light, Scene, random_pose
from core.targets.specification import TargetSpec
from tests.support.simulation.renders import render

SIZE_PX = (1000, 800)
CAMERA = Camera(1000.0, 1000.0, 503.0, 396.0, k1=-0.1, k2=0.05)


@lru_cache(maxsize=64)
def _make(columns: int, rows: int, seed: int, tilt_deg: float, max_roll_deg: float) -> Scene:
    target = TargetSpec("chessboard", columns, rows, pitch_mm=20.0)
    rng = np.random.default_rng([seed, columns, rows])
    T = random_pose(target, CAMERA, SIZE_PX, math.radians(tilt_deg), math.radians(max_roll_deg), rng)
    return Scene(
        target=target,
        camera=CAMERA,
        T_camera_target=T,
        width_px=SIZE_PX[0],
        height_px=SIZE_PX[1],
        noise_levels=4.0,
        light=Light(gradient=(0.15, -0.1), vignetting=0.2),
        clutter=1.0,
        seed=seed,
        background_seed=seed,
    )


@lru_cache(maxsize=16)
def _rendered(key: tuple[int, int, int, float, float]) -> np.ndarray:
    image = render(_make(*key))
    image.flags.writeable = False
    return image


@pytest.fixture(scope="session")
def take() -> Callable[..., tuple[Scene, np.ndarray]]:
    """Return a function (columns, rows, seed, tilt_deg, max_roll_deg, **changes) -> scene and its image."""

    def take_image(
        columns: int,
        rows: int,
        seed: int = 0,
        tilt_deg: float = 25.0,
        max_roll_deg: float = 40.0,
        **changes: object,
    ) -> tuple[Scene, np.ndarray]:
        key = (columns, rows, seed, tilt_deg, max_roll_deg)
        if not changes:
            return _make(*key), _rendered(key)
        scene = dataclasses.replace(_make(*key), **changes)
        return scene, render(scene)

    return take_image
