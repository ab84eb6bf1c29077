"""Illumination that varies over the image, and the objects behind the sheet.

Neither needs the sheet's geometric exactness; both are to mislead a detector as a workshop does.
"""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float

from core.simulation.scenes import Scene

_PLAIN_LEVEL = 105.0


def illumination(scene: Scene) -> Float[np.ndarray, "h w"]:
    """Return the factor by which light and lens change the grey levels, float32."""
    light = scene.light
    u = np.linspace(-1.0, 1.0, scene.width_px, dtype=np.float32)[None, :]
    v = np.linspace(-1.0, 1.0, scene.height_px, dtype=np.float32)[:, None]
    size = np.array([scene.width_px, scene.height_px])
    a, b = light.vignetting * (size / np.hypot(*size)) ** 2
    slope = np.float32(1.0) + np.float32(light.gradient[0]) * u + np.float32(light.gradient[1]) * v
    return np.asarray(slope * (np.float32(1.0) - np.float32(a) * u * u - np.float32(b) * v * v))


def background(scene: Scene) -> Float[np.ndarray, "h w"]:
    """Return what lies behind the sheet, in grey levels before illumination, float32."""
    shape = (scene.height_px, scene.width_px)
    if scene.clutter <= 0.0:
        return np.full(shape, _PLAIN_LEVEL, dtype=np.float32)
    rng = np.random.default_rng([scene.background_seed, 0])
    image = _cloudy(rng, shape, scene.clutter)
    _draw_things(image, rng, scene.clutter)
    _draw_tiling(image, rng, scene.clutter)
    np.clip(image, 8.0, 235.0, out=image)
    return np.asarray(cv2.GaussianBlur(image, (0, 0), float(np.hypot(scene.blur_px, 0.29))))


def _cloudy(rng: np.random.Generator, shape: tuple[int, int], clutter: float) -> Float[np.ndarray, "h w"]:
    """Return soft mottling of several scales."""
    height, width = shape
    image = np.full(shape, _PLAIN_LEVEL, dtype=np.float32)
    for cells, strength in ((4, 35.0), (16, 18.0), (90, 8.0)):
        coarse = rng.standard_normal((cells * height // width + 2, cells + 2), dtype=np.float32)
        coarse *= np.float32(clutter * strength)
        image += cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    return image


def _draw_things(image: Float[np.ndarray, "h w"], rng: np.random.Generator, clutter: float) -> None:
    """Draw boxes, discs, cables and screws of random greys."""
    height, width = image.shape
    size = float(np.hypot(height, width))
    for _ in range(round(60 * clutter)):
        centre = rng.uniform(0.0, 1.0, 2) * (width, height)
        half = rng.uniform(0.01, 0.08, 2) * size
        grey = float(rng.uniform(15, 225))
        kind = rng.integers(4)
        middle = (int(centre[0]), int(centre[1]))
        if kind == 0:
            box = cv2.boxPoints((tuple(centre), tuple(half), float(rng.uniform(0, 90))))
            cv2.fillConvexPoly(image, np.rint(box).astype(np.int32), grey, cv2.LINE_AA)
        elif kind == 1:
            axes = (max(1, int(half[0] / 2)), max(1, int(half[1] / 2)))
            cv2.ellipse(image, middle, axes, float(rng.uniform(0, 180)), 0.0, 360.0, grey, -1, cv2.LINE_AA)
        elif kind == 2:
            steps = rng.normal(0.0, 0.04 * size, (12, 2)).cumsum(axis=0) + centre
            path = np.rint(steps).astype(np.int32).reshape(-1, 1, 2)
            cv2.polylines(image, [path], False, grey, max(1, int(size / 400)), cv2.LINE_AA)
        else:
            cv2.circle(image, middle, max(1, int(0.006 * size)), grey, -1, cv2.LINE_AA)
            cv2.circle(image, middle, max(1, int(0.003 * size)), 240.0 - grey, -1, cv2.LINE_AA)


def _draw_tiling(image: Float[np.ndarray, "h w"], rng: np.random.Generator, clutter: float) -> None:
    """Draw a few grids of bars, as of grilles and perforated plates: regular, but no chessboards."""
    height, width = image.shape
    size = float(np.hypot(height, width))
    for _ in range(round(3 * clutter)):
        pitch = rng.uniform(0.008, 0.02) * size
        across, down = rng.integers(4, 14, 2)
        corner = rng.uniform(0.0, 0.9, 2) * (width, height)
        turn = rng.uniform(0.0, np.pi)
        axes = pitch * np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        grey = float(rng.uniform(20, 220))
        for i in range(across):
            for j in range(down):
                square = corner + np.array([(i, j), (i + 0.6, j), (i + 0.6, j + 0.7), (i, j + 0.7)]) @ axes
                cv2.fillConvexPoly(image, np.rint(square).astype(np.int32), grey, cv2.LINE_AA)
