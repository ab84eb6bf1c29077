"""Boards of dots before one camera, rendered, and how far the dots that are found are from the truth."""

from __future__ import annotations

import math

import numpy as np

from core.geometry.camera import Camera
from core.simulation import Light, Scene, random_pose
from core.targets import TargetSpec

CAMERA = Camera(1500.0, 1500.0, 795.0, 603.0, k1=-0.2)
SIZE = (1600, 1200)
SYMMETRIC = TargetSpec("circles", 9, 7, 25.0)
ASYMMETRIC = TargetSpec("asymmetric_circles", 4, 11, 20.0)


def scene_of(target: TargetSpec, tilt_deg: float, seed: int, *, roll: float = 0.6) -> Scene:
    T = random_pose(target, CAMERA, SIZE, math.radians(tilt_deg), roll, np.random.default_rng(seed))
    light = Light(gradient=(0.15, -0.1), vignetting=0.2)
    return Scene(target, CAMERA, T, *SIZE, light=light, clutter=0.7, seed=seed, background_seed=seed)


def errors(scene: Scene, found: object) -> np.ndarray:
    truth = scene.points_px.reshape(scene.target.rows, scene.target.columns, 2)
    return np.asarray(found.points_px - truth[found.row, found.column])  # type: ignore[attr-defined]
