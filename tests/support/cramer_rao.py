"""The Cramér-Rao bound of corners in a rendered scene: what no unbiased estimator can beat.

A corner is given the pixels whose nearest grid point, in the target's own coordinates, it is: half-way to its
neighbours, so that no pixel serves two. If the pattern there moved by δ (px), the noise-free image g would change
by J δ, J = ∂g/∂δ. With white noise of variance s² the information about δ is I = Σ Jᵀ J / s² over these pixels, and
any unbiased estimator's covariance is at least I⁻¹ (C. R. Rao, Bull. Calcutta Math. Soc. 37 (1945) 81-91). s² is that
of the scene's noise and of the rounding to whole levels, 1/12.

Everything but the position is held to be known: the light, the blur, the edges' directions. The bound with the light
unknown, a plane of level and a plane of contrast at each corner, is stated next to it.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from core.geometry.camera import undistort_points
from core.simulation.renderer import render_levels
from core.simulation.scenes import Scene

_SHIFT_PX = 0.05
_LEVELS_OF_16_BIT = 257.0


@dataclass(frozen=True, slots=True)
class CornerBounds:
    """Bounds of each grid point's covariance (row-major, px²): light known, and light unknown."""

    covariance_px2: Float[np.ndarray, "n 2 2"]
    covariance_light_free_px2: Float[np.ndarray, "n 2 2"]

    @property
    def standard_deviation_px(self) -> Float[np.ndarray, " n"]:
        """The root of half the trace: for both u and v."""
        return np.asarray(np.sqrt(0.5 * np.trace(self.covariance_px2, axis1=1, axis2=2)))

    @property
    def standard_deviation_light_free_px(self) -> Float[np.ndarray, " n"]:
        """The same where the light has to be estimated too."""
        return np.asarray(np.sqrt(0.5 * np.trace(self.covariance_light_free_px2, axis1=1, axis2=2)))


def corner_bounds(scene: Scene) -> CornerBounds:
    """Return the bounds for all grid points of a chessboard scene, from five noise-free images of it."""
    plain = dataclasses.replace(scene, clutter=0.0)
    rounding = 1.0 if scene.bit_depth == 8 else 1.0 / _LEVELS_OF_16_BIT
    deviation = np.sqrt(scene.noise_levels**2 + rounding**2 / 12.0)
    left, top, right, bottom = _bounds(scene)
    part = np.s_[top:bottom, left:right]
    v, u = (a.ravel() for a in np.mgrid[top:bottom, left:right].astype(np.float64))
    corner, places = _nearest_corners(scene, u, v)
    inside = corner >= 0
    corner, places = corner[inside], places[inside]
    columns = [
        sheet_derivative(plain, du, dv)[part].ravel()[inside].astype(np.float64) / deviation
        for du, dv in ((1.0, 0.0), (0.0, 1.0))
    ]
    pattern = render_levels(plain)[part].ravel()[inside].astype(np.float64)
    light = [w * p for w in (np.ones_like(pattern), pattern) for p in (np.ones_like(pattern), *places.T)]
    columns += [a / deviation for a in light]
    information = np.zeros((scene.target.size, 8, 8))
    for i in range(8):
        for j in range(i + 1):
            total = np.bincount(corner, weights=columns[i] * columns[j], minlength=scene.target.size)
            information[:, i, j] = information[:, j, i] = total
    size = np.sqrt(np.einsum("nii->ni", information))
    size = np.where(size > 0.0, size, 1.0)
    scaled = information / (size[:, :, None] * size[:, None, :])
    free = np.linalg.inv(scaled)[:, :2, :2] / (size[:, :2, None] * size[:, None, :2])
    return CornerBounds(np.linalg.inv(information[:, :2, :2]), free)


def sheet_derivative(scene: Scene, du: float, dv: float) -> Float[np.ndarray, "h w"]:
    """Return the derivative of the noise-free image by a shift of the sheet along (du, dv), levels per px.

    Moving the principal point moves the sheet's image, exactly; the light stays where it is.
    """
    images = []
    for step in (_SHIFT_PX, -_SHIFT_PX):
        camera = dataclasses.replace(
            scene.camera, cx_px=scene.camera.cx_px + step * du, cy_px=scene.camera.cy_px + step * dv
        )
        images.append(render_levels(dataclasses.replace(scene, camera=camera)))
    return np.asarray((images[0] - images[1]) / (2.0 * _SHIFT_PX))


def _bounds(scene: Scene) -> tuple[int, int, int, int]:
    """Return left, top, right, bottom of the pixels that can belong to a grid point."""
    points = scene.points_px.reshape(scene.target.rows, scene.target.columns, 2)
    steps = [np.linalg.norm(np.diff(points, axis=axis), axis=2).max() for axis in (0, 1)]
    margin = float(sum(steps))
    least, most = points.min(axis=(0, 1)) - margin, points.max(axis=(0, 1)) + margin
    size = np.array([scene.width_px, scene.height_px])
    (left, top), (right, bottom) = (np.clip(np.rint(a), 0, size).astype(int) for a in (least, most))
    return int(left), int(top), int(right), int(bottom)


def _nearest_corners(
    scene: Scene, u: Float[np.ndarray, " k"], v: Float[np.ndarray, " k"]
) -> tuple[Int[np.ndarray, " k"], Float[np.ndarray, "k 2"]]:
    """Return each pixel's nearest grid point, -1 where it is beyond half a square of all, and where it is from that."""
    # In parts that the processor's cache holds: millions of pixels at once take several times as long.
    parts = np.array_split(np.stack([u, v], axis=1), 1 + len(u) // 4096)
    normalised = np.concatenate([undistort_points(part, scene.camera) for part in parts])
    H = np.linalg.inv(scene.T_camera_target[:3, [0, 1, 3]])
    homogeneous = np.column_stack([normalised, np.ones(len(u))]) @ H.T
    xy = homogeneous[:, :2] / homogeneous[:, 2:] / scene.target.pitch_mm
    nearest = np.rint(xy)
    column, row = nearest.astype(int).T
    inside = (column >= 0) & (column < scene.target.columns) & (row >= 0) & (row < scene.target.rows)
    return np.where(inside, row * scene.target.columns + column, -1), xy - nearest
