"""Corners of a scene refined from starts that are off, and their errors."""

from __future__ import annotations

import numpy as np

from core.simulation import Scene
from core.targets.subpixel.corner_acceptance import RefinedCorners
from core.targets.subpixel.refinement import refine_corners


def refine_scene(scene: Scene, image: np.ndarray, off_px: float = 0.7) -> RefinedCorners:
    grid = scene.grid_points
    start = grid.points_px + np.random.default_rng(1).uniform(-off_px, off_px, grid.points_px.shape)
    return refine_corners(image, grid.column, grid.row, start, origin_is_black=True)


def rms(error: np.ndarray) -> float:
    return float(np.sqrt(np.mean(error**2)))


def normalised(refined: RefinedCorners, scene: Scene) -> np.ndarray:
    error = (refined.points_px - scene.points_px) / refined.standard_uncertainty_px[:, None]
    return error[refined.trusted]


def to_8_bit(levels: np.ndarray, noise: float = 0.0, seed: int = 0) -> np.ndarray:
    levels = levels + noise * np.random.default_rng(seed).standard_normal(levels.shape)
    return np.clip(np.rint(levels), 0, 255).astype(np.uint8)
