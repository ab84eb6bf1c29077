"""The ideal image of a rectilinear pattern or a sheet of dots, slightly blurred, at any pixel, in closed form.

Dots: around a fine sample the edge of a dot is a curve: the level line F = 1 of F = |X - centre| / radius, with X the
place in the target plane. Its distance is a = (1 - F) / |∇F|, its curvature κ = tᵀ M t / (F |∇F|) with M = ∇X ∇Xᵀ /
radius² and t along the edge, all at the sample. A Gaussian of standard deviation σ sees the share Φ(a/σ) - ½ κ σ φ(a/σ)
of the dot, but for terms of the order (κσ)²: blurring moves an edge by ½ κ σ² toward its centre of curvature (B.
Merriman, J. Bence, S. Osher, "Diffusion generated motion by mean curvature", UCLA CAM report 92-18, 1992).
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.polynomial import chebyshev
from scipy.special import ndtr

from core.geometry import Camera, undistort_points
from core.targets import DotPattern, RectilinearPattern

_DEGREE = 5  # of the polynomial that stands for the lens over one tile
_NODES = chebyshev.chebpts1(_DEGREE + 1)
_BINS_PER_CELL = 16
_LEGENDRE_NODES, _LEGENDRE_WEIGHTS = np.polynomial.legendre.leggauss(20)
_B_NODES = chebyshev.chebvander(_NODES, _DEGREE)
_TO_COEFFICIENTS = np.linalg.inv(_B_NODES)
_I = np.eye(_DEGREE + 1)
# coefficients -> coefficients of the derivative, as a matrix to multiply from the right: c @ _DIFFERENTIATE
_DIFFERENTIATE = np.pad(np.stack([chebyshev.chebder(unit) for unit in _I]), ((0, 0), (0, 1)))


class Coverage:
    """A pattern seen by a camera: how much white and how much sheet a small Gaussian around a place sees."""

    def __init__(
        self,
        pattern: RectilinearPattern,
        camera: Camera,
        T_camera_target: Float[np.ndarray, "4 4"],
        blur_px: float,
        reach: float,
    ) -> None:
        self._pattern = pattern
        self.camera = camera
        self.H_target_image = np.linalg.inv(T_camera_target[:3, [0, 1, 3]])
        if np.linalg.det(T_camera_target[:3, [0, 1, 3]]) < 0.0:  # seen from behind: the sheet is its own back
            self.H_target_image = -self.H_target_image
        self._blur_px = blur_px
        self._reach = reach
        self._x_lines = _Lines(pattern.x_edges)
        self._y_lines = _Lines(pattern.y_edges)

    def sample(
        self, u_px: Float[np.ndarray, " w"], v_px: Float[np.ndarray, " h"]
    ) -> tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w"]]:
        """Return white and sheet at the places (v_px[j], u_px[i])."""
        lens = TileLens(u_px, v_px, self.camera)
        H = self.H_target_image
        scale = lens.combine(H[2])
        in_front = scale > 0.0
        scale = np.where(in_front, scale, 1.0)
        x = np.where(in_front, lens.combine(H[0]) / scale, np.inf)
        y = np.where(in_front, lens.combine(H[1]) / scale, np.inf)
        column, x_near = self._x_lines.nearest(x)
        row, y_near = self._y_lines.nearest(y)
        reach = self._reach * self._blur_px * lens.steepest(H)
        near = (np.abs(x - x_near) < reach) | (np.abs(y - y_near) < reach)
        cell_row, cell_column = row + (y > y_near), column + (x > x_near)
        white = self._pattern.white[cell_row, cell_column]
        sheet = self._pattern.sheet[cell_row, cell_column]
        if near.any():
            weights = self._quadrants(lens, near, x_near[near], y_near[near])
            i, j = column[near], row[near]
            for values, table in ((white, self._pattern.white), (sheet, self._pattern.sheet)):
                values[near] = (
                    weights[0] * table[j, i]
                    + weights[1] * table[j, i + 1]
                    + weights[2] * table[j + 1, i]
                    + weights[3] * table[j + 1, i + 1]
                )
        return white, sheet

    def _quadrants(
        self,
        lens: TileLens,
        near: Bool[np.ndarray, "h w"],
        x_line: Float[np.ndarray, " n"],
        y_line: Float[np.ndarray, " n"],
    ) -> Float[np.ndarray, "4 n"]:
        """Return the probabilities that a normal about each place falls on either side of two lines.

        A line x = c is L(n) = (h1 - c h3)·(n, 1) = 0 in undistorted n; h3·(n, 1) > 0 makes L's sign
        that of x - c. Order: left above, right above, left below, right below.
        """
        H = self.H_target_image
        (xn, yn), du, dv = lens.at(near)
        distances, gradients = [], []
        for row, line in ((H[0], x_line), (H[1], y_line)):
            a, b, c = (row[k] - line * H[2, k] for k in range(3))
            gradient = np.stack([a * du[0] + b * du[1], a * dv[0] + b * dv[1]])
            steepness = np.hypot(gradient[0], gradient[1])
            distances.append((a * xn + b * yn + c) / (steepness * self._blur_px))
            gradients.append(gradient / steepness)
        right, below = ndtr(distances[0]), ndtr(distances[1])
        both = right * below
        crossing = (np.abs(distances[0]) < self._reach) & (np.abs(distances[1]) < self._reach)
        correlation = np.sum(gradients[0] * gradients[1], axis=0)[crossing]
        both[crossing] += _bivariate_excess(distances[0][crossing], distances[1][crossing], correlation)
        return np.stack([1.0 - right - below + both, right - both, below - both, both])


class _Lines:
    """Parallel lines, asked for the nearest one by a table of bins."""

    def __init__(self, edges: Float[np.ndarray, " n"]) -> None:
        self._edges = edges
        spacings = np.diff(edges)
        width = float(spacings[spacings > 0.0].min()) / _BINS_PER_CELL
        self._first = float(edges[0]) - width
        self._per_mm = 1.0 / width
        bins = math.ceil((float(edges[-1]) - self._first) / width) + 2
        centres = self._first + (np.arange(bins) + 0.5) * width
        after = np.clip(np.searchsorted(edges, centres), 1, len(edges) - 1)
        self._table = np.where(centres - edges[after - 1] < edges[after] - centres, after - 1, after)

    def nearest(self, x: Float[np.ndarray, "h w"]) -> tuple[Int[np.ndarray, "h w"], Float[np.ndarray, "h w"]]:
        """Return index and place of the nearest line; near a cell's middle of either of its two."""
        bins = np.clip((x - self._first) * self._per_mm, 0.0, len(self._table) - 1.0).astype(np.intp)
        index = self._table[bins]
        return index, self._edges[index]


class TileLens:
    """Undistorted coordinates over one tile, as a polynomial through exact values at Chebyshev nodes."""

    def __init__(self, u_px: Float[np.ndarray, " w"], v_px: Float[np.ndarray, " h"], camera: Camera) -> None:
        u_unit, u_nodes, u_half = _to_unit(u_px)
        v_unit, v_nodes, v_half = _to_unit(v_px)
        places = np.stack([a.ravel() for a in np.meshgrid(u_nodes, v_nodes)], axis=1)
        values = undistort_points(places, camera).reshape(_DEGREE + 1, _DEGREE + 1, 2)
        self._coefficients = [_TO_COEFFICIENTS @ values[:, :, k] @ _TO_COEFFICIENTS.T for k in range(2)]
        self._B_u = chebyshev.chebvander(u_unit, _DEGREE)
        self._B_v = chebyshev.chebvander(v_unit, _DEGREE)
        self._D_u = _DIFFERENTIATE / u_half
        self._D_v = _DIFFERENTIATE / v_half

    def combine(self, row: Float[np.ndarray, "3"]) -> Float[np.ndarray, "h w"]:
        """Return row · (x, y, 1) at every place."""
        coefficients = row[0] * self._coefficients[0] + row[1] * self._coefficients[1]
        return np.asarray(self._B_v @ coefficients @ self._B_u.T + row[2])

    def at(self, where: Bool[np.ndarray, "h w"]) -> Float[np.ndarray, "3 2 n"]:
        """Return (x, y), and their derivatives by u and by v, 1/px, at some places."""
        return np.array([[a[where] for a in pair] for pair in self._values(self._B_u, self._B_v)])

    def steepest(self, H: Float[np.ndarray, "3 3"]) -> float:
        """Return a bound of the length of the target coordinates' gradients over the tile, mm/px.

        Infinite where the tile reaches the target plane's horizon.
        """
        n, du, dv = (np.array(pair) for pair in self._values(_B_NODES, _B_NODES))
        X, Y, scale = (H[k, 0] * n[0] + H[k, 1] * n[1] + H[k, 2] for k in range(3))
        if np.any(scale <= 1e-3 * np.max(np.abs(scale))):
            return math.inf
        steepest = 0.0
        for k, numerator in ((0, X), (1, Y)):
            a, b = (H[k, i] - numerator / scale * H[2, i] for i in range(2))
            length = np.hypot(a * du[0] + b * du[1], a * dv[0] + b * dv[1]) / scale
            steepest = max(steepest, float(length.max()))
        return 1.1 * steepest  # the nodes lie within the tile's border

    def _values(
        self, B_u: Float[np.ndarray, "w k"], B_v: Float[np.ndarray, "h k"]
    ) -> tuple[list[Float[np.ndarray, "h w"]], ...]:
        """Return x and y, their derivatives by u, and by v, for polynomials' values along u and v."""
        return tuple(
            [B_v @ L @ c @ R @ B_u.T for c in self._coefficients]
            for L, R in ((_I, _I), (_I, self._D_u), (self._D_v.T, _I))
        )


def _to_unit(
    places: Float[np.ndarray, " n"],
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " k"], float]:
    """Return the places mapped to [-1, 1], the Chebyshev nodes mapped back, and half the length."""
    middle, half = (places[0] + places[-1]) / 2.0, (places[-1] - places[0]) / 2.0
    return (places - middle) / half, middle + half * _NODES, float(half)


def _bivariate_excess(
    a: Float[np.ndarray, " n"], b: Float[np.ndarray, " n"], correlation: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Return P(X < a, Y < b) - Φ(a) Φ(b) of standard normals with a correlation.

    = 1/2π ∫ exp(-(a² - 2 a b sin t + b²) / (2 cos² t)) dt from 0 to asin(correlation), by Gauss-Legendre.

    References: A. Genz, "Numerical computation of rectangular bivariate and trivariate normal and t
    probabilities", Statistics and Computing 14 (2004) 251-260, eq. 3, doi:10.1023/B:STCO.0000035304.20635.31.
    """
    half = 0.5 * np.arcsin(np.clip(correlation, -1.0, 1.0))
    total = np.zeros_like(a)
    for node, weight in zip(_LEGENDRE_NODES, _LEGENDRE_WEIGHTS, strict=True):
        sine = np.sin(half * (1.0 + node))
        total += weight * np.exp((sine * a * b - 0.5 * (a * a + b * b)) / (1.0 - sine * sine))
    return np.asarray(total * half / (2.0 * math.pi))


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
