"""The ideal image of a sheet of dots, slightly blurred, at any pixel places, in closed form.

Around a fine sample the edge of a dot is a curve: the level line F = 1 of F = |X - centre| / radius, with X the place
in the target plane. Its distance is a = (1 - F) / |∇F|, its curvature κ = tᵀ M t / (F |∇F|) with M = ∇X ∇Xᵀ / radius²
and t along the edge, all at the sample. A Gaussian of standard deviation σ sees the share Φ(a/σ) - ½ κ σ φ(a/σ) of the
dot, but for terms of the order (κσ)²: blurring moves an edge by ½ κ σ² toward its centre of curvature (B. Merriman,
J. Bence, S. Osher, "Diffusion generated motion by mean curvature", UCLA CAM report 92-18, 1992).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.special import ndtr

from core.camera import Camera
from core.simulation.coverage import Coverage, TileLens
from core.simulation.patterns import DotPattern

_ROOT_2_PI = float(np.sqrt(2.0 * np.pi))


class DotCoverage:
    """Dots on a sheet seen by a camera: how much white and how much sheet a small Gaussian around a place sees."""

    def __init__(
        self,
        pattern: DotPattern,
        camera: Camera,
        T_camera_target: Float[np.ndarray, "4 4"],
        blur_px: float,
        reach: float,
    ) -> None:
        self._pattern = pattern
        self._sheet = Coverage(pattern.blank, camera, T_camera_target, blur_px, reach)
        self._blur_px = blur_px
        self._reach = reach

    def sample(
        self, u_px: Float[np.ndarray, " w"], v_px: Float[np.ndarray, " h"]
    ) -> tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w"]]:
        """Return white and sheet at the places (v_px[j], u_px[i])."""
        white, sheet = self._sheet.sample(u_px, v_px)
        lens, H = TileLens(u_px, v_px, self._sheet.camera), self._sheet.H_target_image
        scale = lens.combine(H[2])
        in_front = scale > 0.0
        scale = np.where(in_front, scale, 1.0)
        x, y = (np.where(in_front, lens.combine(H[k]) / scale, np.inf) for k in range(2))
        centre_x, centre_y, radius = self._pattern.nearest(x, y)
        dx, dy = x - centre_x, y - centre_y
        away = np.hypot(dx, dy)
        reach = self._reach * self._blur_px * lens.steepest(H) * np.sqrt(2.0)
        near = (np.abs(away - radius) < reach) & (radius > 0.0)
        inked = np.where(radius > 0.0, away < radius, False).astype(np.float64)
        if near.any():
            inked[near] = self._blurred(lens, near, dx[near], dy[near], radius[near], x[near], y[near])
        return white + inked - 2.0 * white * inked, sheet

    def _blurred(
        self,
        lens: TileLens,
        near: np.ndarray,
        dx: Float[np.ndarray, " n"],
        dy: Float[np.ndarray, " n"],
        radius: Float[np.ndarray, " n"],
        x: Float[np.ndarray, " n"],
        y: Float[np.ndarray, " n"],
    ) -> Float[np.ndarray, " n"]:
        H = self._sheet.H_target_image
        (xn, yn), du, dv = lens.at(near)
        scale = H[2, 0] * xn + H[2, 1] * yn + H[2, 2]
        gradients = []  # of the target's x and y by (u, v), mm/px
        for row, value in ((H[0], x), (H[1], y)):
            a, b = row[0] - value * H[2, 0], row[1] - value * H[2, 1]
            gradients.append(np.stack([a * du[0] + b * du[1], a * dv[0] + b * dv[1]]) / scale)
        away = np.maximum(np.hypot(dx, dy), 1e-12)
        outward = (dx * gradients[0] + dy * gradients[1]) / away
        steepness = np.hypot(outward[0], outward[1])
        along = np.stack([-outward[1], outward[0]]) / steepness
        bend = np.sum(along * gradients[0], axis=0) ** 2 + np.sum(along * gradients[1], axis=0) ** 2
        curvature = bend / (away * steepness)
        distance = (radius - away) / (steepness * self._blur_px)
        density = np.exp(-0.5 * distance**2) / _ROOT_2_PI
        return np.asarray(np.clip(ndtr(distance) - 0.5 * curvature * self._blur_px * density, 0.0, 1.0))
