"""The ideal image of a rectilinear pattern or a sheet of dots, slightly blurred, at any pixel, in closed form.

Dots: around a fine sample the edge of a dot is a curve: the level line F = 1 of F = |X - centre| / radius, with X the
place in the target plane. Its distance is a = (1 - F) / |∇F|, its curvature κ = tᵀ M t / (F |∇F|) with M = ∇X ∇Xᵀ /
radius² and t along the edge, all at the sample. A Gaussian of standard deviation σ sees the share Φ(a/σ) - ½ κ σ φ(a/σ)
of the dot, but for terms of the order (κσ)²: blurring moves an edge by ½ κ σ² toward its centre of curvature (B.
Merriman, J. Bence, S. Osher, "Diffusion generated motion by mean curvature", UCLA CAM report 92-18, 1992).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from core.geometry import Camera
from core.jit import jit
from core.simulation.tiled_lens import LensTile, TiledLens
from core.targets import DotPattern, RectilinearPattern

_BINS_PER_CELL = 16
_REACH = 5.0  # standard deviations; Φ(-5) = 3e-7
_LEGENDRE_POINTS = (6, 12, 20)
_LEGENDRE_NODES, _LEGENDRE_WEIGHTS = np.stack(
    [np.pad(np.polynomial.legendre.leggauss(n), ((0, 0), (0, 20 - n))) for n in _LEGENDRE_POINTS], axis=1
)
_NO_DOTS = (np.eye(2), np.zeros(2), np.zeros((0, 0)))


class Coverage:
    """A pattern seen by a camera: how much white and how much sheet a small Gaussian around a place sees."""

    def __init__(
        self,
        pattern: RectilinearPattern | DotPattern,
        camera: Camera,
        T_camera_target: Float[np.ndarray, "4 4"],
        blur_px: float,
    ) -> None:
        self._camera = camera
        self._H_target_image = np.linalg.inv(T_camera_target[:3, [0, 1, 3]])
        if np.linalg.det(T_camera_target[:3, [0, 1, 3]]) < 0.0:  # seen from behind: the sheet is its own back
            self._H_target_image = -self._H_target_image
        self._blur_px = blur_px
        cells, dots = pattern, _NO_DOTS
        if isinstance(pattern, DotPattern):
            cells, dots = pattern.blank, (pattern.to_index, np.array(pattern.first, float), pattern.radius_mm)
        assert isinstance(cells, RectilinearPattern)
        inks = np.stack([cells.white, cells.sheet], axis=2)
        self._sheet: tuple[Any, ...] = (*_binned(cells.x_edges), *_binned(cells.y_edges), inks, *dots)

    def lens(self, u_px: list[Float[np.ndarray, " _"]], v_px: list[Float[np.ndarray, " _"]]) -> TiledLens:
        """Return the lens over tiles, given the places of each column of tiles and of each row."""
        return TiledLens(u_px, v_px, self._camera, self._H_target_image)

    def sample(self, tile: LensTile, samples: Float[np.ndarray, "2 h w"]) -> None:
        """Write white and sheet at the places of a tile."""
        reach_mm = _REACH * self._blur_px * tile.steepest_mm
        lens, H = tile[:-1], self._H_target_image
        arguments: tuple[Any, ...] = (*lens, H, *self._sheet, self._blur_px, reach_mm, samples)
        sample_tile(*arguments)


def _binned(
    edges: Float[np.ndarray, " n"],
) -> tuple[Float[np.ndarray, " n"], Int[np.ndarray, " m"], float, float]:
    """Return parallel lines' places, and a table of bins with the nearest line of each: where it begins, bins per mm.

    Near a cell's middle it is either of its two.
    """
    spacings = np.diff(edges)
    width = float(spacings[spacings > 0.0].min()) / _BINS_PER_CELL
    first = float(edges[0]) - width
    centres = first + (np.arange(math.ceil((float(edges[-1]) - first) / width) + 2) + 0.5) * width
    after = np.clip(np.searchsorted(edges, centres), 1, len(edges) - 1)
    nearest = np.where(centres - edges[after - 1] < edges[after] - centres, after - 1, after)
    return np.asarray(edges, dtype=np.float64), nearest, first, 1.0 / width


@jit("f8[:, :, ::1], f8[::1], f8[:, ::1]")
def sum_down(
    coefficients: Float[np.ndarray, "2 k k"], down: Float[np.ndarray, " k"], sums: Float[np.ndarray, "2 k"]
) -> None:
    """Write Σ down[m] coefficients[:, m, k]: the polynomials along one row."""
    for axis in range(2):
        for k in range(len(down)):
            total = 0.0
            for m in range(len(down)):
                total += down[m] * coefficients[axis, m, k]
            sums[axis, k] = total


@jit("f8[:, ::1], f8[::1], f8[::1]")
def sum_along(
    sums: Float[np.ndarray, "2 k"], along: Float[np.ndarray, " k"], place: Float[np.ndarray, "2"]
) -> None:
    """Write Σ sums[:, k] along[k]: the polynomials at one place of the row."""
    for axis in range(2):
        total = 0.0
        for k in range(len(along)):
            total += sums[axis, k] * along[k]
        place[axis] = total


@jit("f8")
def normal_share(limit: float) -> float:
    """Return Φ; 0 or 1 beyond 6 standard deviations, where it differs from them by less than 1e-9."""
    if abs(limit) > 6.0:
        return 1.0 if limit > 0.0 else 0.0
    return 0.5 * math.erfc(-limit * math.sqrt(0.5))


@jit("f8, f8, f8")
def bivariate_excess(a: float, b: float, correlation: float) -> float:
    """Return P(X < a, Y < b) - Φ(a) Φ(b) of standard normals with a correlation.

    = 1/2π ∫ exp(-(a² - 2 a b sin t + b²) / (2 cos² t)) dt from 0 to asin(correlation), by Gauss-Legendre with as many
    points as the correlation needs.

    References: A. Genz, "Numerical computation of rectangular bivariate and trivariate normal and t
    probabilities", Statistics and Computing 14 (2004) 251-260, eq. 3, doi:10.1023/B:STCO.0000035304.20635.31.
    """
    half = 0.5 * math.asin(min(max(correlation, -1.0), 1.0))
    rule = 0 if abs(correlation) < 0.3 else 1 if abs(correlation) < 0.75 else 2
    total = 0.0
    for n in range(_LEGENDRE_POINTS[rule]):
        sine = math.sin(half * (1.0 + _LEGENDRE_NODES[rule, n]))
        total += _LEGENDRE_WEIGHTS[rule, n] * math.exp(
            (sine * a * b - 0.5 * (a * a + b * b)) / (1.0 - sine * sine)
        )
    return total * half / (2.0 * math.pi)


@jit("f8[:, ::1], f8, f8, f8[::1], f8[::1], f8[::1], f8, f8")
def shares(
    H: Float[np.ndarray, "3 3"],
    x_line: float,
    y_line: float,
    n: Float[np.ndarray, "2"],
    du: Float[np.ndarray, "2"],
    dv: Float[np.ndarray, "2"],
    blur_px: float,
    reach: float,
) -> tuple[float, float, float]:
    """Return the probabilities that a normal about a place falls right of a line, below another, and both.

    Beyond `reach` standard deviations of either line, both are taken as independent. A line x = c is L(n) = (h1 - c
    h3)·(n, 1) = 0 in undistorted n; h3·(n, 1) > 0 makes L's sign that of x - c.
    """
    a, b, c = H[0, 0] - x_line * H[2, 0], H[0, 1] - x_line * H[2, 1], H[0, 2] - x_line * H[2, 2]
    gu, gv = a * du[0] + b * du[1], a * dv[0] + b * dv[1]
    steepness = math.sqrt(gu * gu + gv * gv)
    right_by = (a * n[0] + b * n[1] + c) / (steepness * blur_px)
    gu, gv = gu / steepness, gv / steepness
    a, b, c = H[1, 0] - y_line * H[2, 0], H[1, 1] - y_line * H[2, 1], H[1, 2] - y_line * H[2, 2]
    hu, hv = a * du[0] + b * du[1], a * dv[0] + b * dv[1]
    steepness = math.sqrt(hu * hu + hv * hv)
    below_by = (a * n[0] + b * n[1] + c) / (steepness * blur_px)
    right, below = normal_share(right_by), normal_share(below_by)
    both = right * below
    if abs(right_by) < reach and abs(below_by) < reach:
        both += bivariate_excess(right_by, below_by, (gu * hu + gv * hv) / steepness)
    return right, below, both


@jit("f8[:, ::1], f8, f8, f8, f8, f8, f8[::1], f8[::1], f8, f8")
def dot_share(
    H: Float[np.ndarray, "3 3"],
    x: float,
    y: float,
    dx: float,
    dy: float,
    radius: float,
    du: Float[np.ndarray, "2"],
    dv: Float[np.ndarray, "2"],
    scale: float,
    blur_px: float,
) -> float:
    """Return the share of a dot that a place near its edge sees; (dx, dy) is the place from the dot's centre, mm."""
    a, b = H[0, 0] - x * H[2, 0], H[0, 1] - x * H[2, 1]
    xu, xv = (a * du[0] + b * du[1]) / scale, (a * dv[0] + b * dv[1]) / scale  # mm/px
    a, b = H[1, 0] - y * H[2, 0], H[1, 1] - y * H[2, 1]
    yu, yv = (a * du[0] + b * du[1]) / scale, (a * dv[0] + b * dv[1]) / scale
    away = max(math.sqrt(dx * dx + dy * dy), 1e-12)
    out_u, out_v = (dx * xu + dy * yu) / away, (dx * xv + dy * yv) / away
    steepness = math.sqrt(out_u * out_u + out_v * out_v)
    along_u, along_v = -out_v / steepness, out_u / steepness
    bend = (along_u * xu + along_v * xv) ** 2 + (along_u * yu + along_v * yv) ** 2
    curvature = bend / (away * steepness)
    distance = (radius - away) / (steepness * blur_px)
    density = math.exp(-0.5 * distance * distance) / math.sqrt(2.0 * math.pi)
    share = normal_share(distance) - 0.5 * curvature * blur_px * density
    return min(max(share, 0.0), 1.0)


@jit(
    "f8[:, :, ::1], f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[::1], i8[::1], f8, f8, f8[::1], "
    "i8[::1], f8, f8, f8[:, :, ::1], f8[:, ::1], f8[::1], f8[:, ::1], f8, f8, f4[:, :, ::1]"
)
def sample_tile(
    coefficients: Float[np.ndarray, "2 k k"],
    B_u: Float[np.ndarray, "w k"],
    B_v: Float[np.ndarray, "h k"],
    D_u: Float[np.ndarray, "w k"],
    D_v: Float[np.ndarray, "h k"],
    H: Float[np.ndarray, "3 3"],
    x_edges: Float[np.ndarray, " nx"],
    x_bins: Int[np.ndarray, " mx"],
    x_first: float,
    x_per_mm: float,
    y_edges: Float[np.ndarray, " ny"],
    y_bins: Int[np.ndarray, " my"],
    y_first: float,
    y_per_mm: float,
    inks: Float[np.ndarray, "ny+1 nx+1 2"],
    to_index: Float[np.ndarray, "2 2"],
    first: Float[np.ndarray, "2"],
    radius_mm: Float[np.ndarray, "nq np"],
    blur_px: float,
    reach_mm: float,
    samples: Float[np.ndarray, "2 h w"],
) -> None:
    """Write white and sheet at the places of a tile: B are the polynomials' values there, D their derivatives.

    Places within `reach_mm` of a line, in mm on the target, are near it. Where there are no dots, `radius_mm` is empty.
    """
    nq, np_ = radius_mm.shape
    determinant = to_index[0, 0] * to_index[1, 1] - to_index[0, 1] * to_index[1, 0]
    along, down = np.empty((2, B_u.shape[1])), np.empty((2, B_u.shape[1]))
    n, du, dv, places = np.empty(2), np.empty(2), np.empty(2), np.empty((3, B_u.shape[0]))
    B_rows = np.ascontiguousarray(B_u.T)
    for j in range(B_v.shape[0]):
        sum_down(coefficients, B_v[j], along)
        sum_down(coefficients, D_v[j], down)
        for axis in range(3):
            for i in range(B_u.shape[0]):
                places[axis, i] = H[axis, 2]
            for k in range(B_u.shape[1]):
                slope = H[axis, 0] * along[0, k] + H[axis, 1] * along[1, k]
                for i in range(B_u.shape[0]):
                    places[axis, i] += slope * B_rows[k, i]
        for i in range(B_u.shape[0]):
            scale = places[2, i]
            if not scale > 0.0:  # beyond the horizon
                samples[0, j, i], samples[1, j, i] = inks[-1, -1, 0], inks[-1, -1, 1]
                continue
            x, y = places[0, i] / scale, places[1, i] / scale
            p = x_bins[int(min(max((x - x_first) * x_per_mm, 0.0), len(x_bins) - 1.0))]
            q = y_bins[int(min(max((y - y_first) * y_per_mm, 0.0), len(y_bins) - 1.0))]
            column, row = p + (x > x_edges[p]), q + (y > y_edges[q])
            white, sheet = inks[row, column, 0], inks[row, column, 1]
            known = False
            if abs(x - x_edges[p]) < reach_mm or abs(y - y_edges[q]) < reach_mm:
                same, crossed = True, False
                for ink in range(2):
                    value, to_right = inks[q, p, ink], inks[q, p + 1, ink]
                    to_below, to_both = inks[q + 1, p, ink], inks[q + 1, p + 1, ink]
                    same &= to_right == value and to_below == value and to_both == value
                    crossed |= value + to_both != to_right + to_below
                if not same:
                    known = True
                    sum_along(along, B_u[i], n)
                    sum_along(along, D_u[i], du)
                    sum_along(down, B_u[i], dv)
                    right, below, both = shares(
                        H, x_edges[p], y_edges[q], n, du, dv, blur_px, _REACH if crossed else 0.0
                    )
                    neither = 1.0 - right - below + both
                    white = (
                        neither * inks[q, p, 0]
                        + (right - both) * inks[q, p + 1, 0]
                        + (below - both) * inks[q + 1, p, 0]
                        + both * inks[q + 1, p + 1, 0]
                    )
                    sheet = (
                        neither * inks[q, p, 1]
                        + (right - both) * inks[q, p + 1, 1]
                        + (below - both) * inks[q + 1, p, 1]
                        + both * inks[q + 1, p + 1, 1]
                    )
            if nq > 0:
                p_all = np.rint(to_index[0, 0] * x + to_index[0, 1] * y - first[0])
                q_all = np.rint(to_index[1, 0] * x + to_index[1, 1] * y - first[1])
                if 0.0 <= p_all < np_ and 0.0 <= q_all < nq and radius_mm[int(q_all), int(p_all)] > 0.0:
                    radius = radius_mm[int(q_all), int(p_all)]
                    p_all, q_all = p_all + first[0], q_all + first[1]
                    dx = x - (to_index[1, 1] * p_all - to_index[0, 1] * q_all) / determinant
                    dy = y - (to_index[0, 0] * q_all - to_index[1, 0] * p_all) / determinant
                    away = math.sqrt(dx * dx + dy * dy)
                    inked = 1.0 if away < radius else 0.0
                    if abs(away - radius) < reach_mm * math.sqrt(2.0):
                        if not known:
                            sum_along(along, D_u[i], du)
                            sum_along(down, B_u[i], dv)
                        inked = dot_share(H, x, y, dx, dy, radius, du, dv, scale, blur_px)
                    white = white + inked - 2.0 * white * inked
            samples[0, j, i], samples[1, j, i] = white, sheet
