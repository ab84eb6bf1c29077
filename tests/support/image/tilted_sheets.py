"""Images of one flat target, tilted and turned before one camera, and how far what is found is from the truth."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from core.geometry.camera import Camera
from core.geometry.se3 import so3_exp, transform
from core.simulation import Scene
from core.targets import detect
from core.targets.specification import GridPoints, TargetSpec
from tests.support.simulation.renders import render

CAMERA = Camera(1450.0, 1451.0, 640.0, 480.0, k1=-0.2, k2=0.04, p1=2e-4)
Shot = tuple[Scene, np.ndarray]


def tilted_scene(
    target: TargetSpec,
    *,
    tilt_deg: float = 30.0,
    turn: float = 0.3,
    offset_mm: float = 0.0,
    depth_mm: float = 300.0,
    **changes: Any,
) -> Scene:
    """A target whose middle lies `depth_mm` ahead and `offset_mm` to the right; changes are of the scene's fields."""
    R = so3_exp(math.radians(tilt_deg) * np.array([0.8, 0.6, 0.0])) @ so3_exp(np.array([0.0, 0.0, turn]))
    middle = target.points_target().mean(axis=0)
    T = transform(R, np.array([offset_mm, 0.0, depth_mm]) - R @ middle)
    taken = Scene(target, CAMERA, T, 1280, 960, noise_levels=3.0, clutter=1.0, seed=2, quiet_zone=0.5)
    return dataclasses.replace(taken, **changes)


def take(target: TargetSpec, **how: Any) -> Shot:
    """The same, with its image."""
    taken = tilted_scene(target, **how)
    return taken, render(taken)


def truth_px(taken: Scene, found: GridPoints) -> np.ndarray:
    """Where the points found truly are."""
    return np.asarray(taken.points_px[found.row * taken.target.grid_columns + found.column])


def errors(taken: Scene, image: np.ndarray) -> tuple[int, float, float]:
    """How many points were found, their RMS error (px), and that over the stated uncertainty."""
    found = detect(image, taken.target)
    off = found.points_px - truth_px(taken, found)
    stated = off / found.standard_uncertainty_px[:, None]
    return len(found), float(np.sqrt(np.mean(off**2))), float(np.sqrt(np.mean(stated**2)))
