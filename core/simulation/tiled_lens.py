"""Undistorted coordinates over the tiles of an image, as polynomials through exact values at Chebyshev nodes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.polynomial import chebyshev

from core.geometry import Camera, undistort_points

_DEGREE = 5  # of the polynomial that stands for the lens over one tile
_NODES = chebyshev.chebpts1(_DEGREE + 1)
_B_NODES = chebyshev.chebvander(_NODES, _DEGREE)
_TO_COEFFICIENTS = np.linalg.inv(_B_NODES)
_DIFFERENTIATE = np.pad(np.stack([chebyshev.chebder(unit) for unit in np.eye(_DEGREE + 1)]), ((0, 0), (0, 1)))
"""Polynomials' values -> those of their derivatives, with the transpose multiplied from the right."""
_AT_NODES = _B_NODES @ _DIFFERENTIATE.T @ _TO_COEFFICIENTS  # values at the nodes -> derivatives there


class LensTile(NamedTuple):
    """The lens over one tile: (x, y) at the place (v, u) is Σ B_v[v, m] coefficients[:, m, k] B_u[u, k]; with D_u or
    D_v instead of B, their derivatives, 1/px."""

    coefficients: Float[np.ndarray, "2 k k"]
    B_u: Float[np.ndarray, "w k"]
    B_v: Float[np.ndarray, "h k"]
    D_u: Float[np.ndarray, "w k"]
    D_v: Float[np.ndarray, "h k"]
    steepest_mm: float
    """A bound of the length of the target coordinates' gradients, mm/px; infinite where the tile reaches the target
    plane's horizon."""


class TiledLens:
    """The lens over rows and columns of tiles; `tile` returns one."""

    def __init__(
        self,
        u_px: list[Float[np.ndarray, " _"]],
        v_px: list[Float[np.ndarray, " _"]],
        camera: Camera,
        H_target_image: Float[np.ndarray, "3 3"],
    ) -> None:
        u, v = ([_Places(places) for places in tiles] for tiles in (u_px, v_px))
        grid = np.meshgrid(*(np.concatenate([places.nodes for places in tiles]) for tiles in (u, v)))
        shape = (len(v), _DEGREE + 1, len(u), _DEGREE + 1, 2)
        values = undistort_points(np.stack([a.ravel() for a in grid], axis=1), camera).reshape(shape)
        self._values = np.ascontiguousarray(values.transpose(0, 2, 4, 1, 3))
        """By row and column of tiles: (x, y) at the nodes, v before u."""
        self._u, self._v, self._H = u, v, H_target_image

    def tile(self, row: int, column: int) -> LensTile:
        """Return the tile."""
        u, v, values = self._u[column], self._v[row], self._values[row, column]
        coefficients = _TO_COEFFICIENTS @ values @ _TO_COEFFICIENTS.T
        du, dv = values @ _AT_NODES.T / u.half_px, _AT_NODES @ values / v.half_px
        steepest = _steepest(self._H, values, du, dv)
        return LensTile(np.ascontiguousarray(coefficients), u.values, v.values, u.slopes, v.slopes, steepest)


class _Places:
    """The polynomials along one side of a tile."""

    def __init__(self, places: Float[np.ndarray, " n"]) -> None:
        middle, self.half_px = (places[0] + places[-1]) / 2.0, float((places[-1] - places[0]) / 2.0)
        self.nodes = middle + self.half_px * _NODES
        self.values = chebyshev.chebvander((places - middle) / self.half_px, _DEGREE)
        self.values = np.ascontiguousarray(self.values)
        self.slopes = np.ascontiguousarray(self.values @ _DIFFERENTIATE.T / self.half_px)


def _steepest(
    H: Float[np.ndarray, "3 3"],
    n: Float[np.ndarray, "2 k k"],
    du: Float[np.ndarray, "2 k k"],
    dv: Float[np.ndarray, "2 k k"],
) -> float:
    X, Y, scale = (H[k, 0] * n[0] + H[k, 1] * n[1] + H[k, 2] for k in range(3))
    if np.any(scale <= 1e-3 * np.max(np.abs(scale))):
        return float("inf")
    steepest = 0.0
    for k, numerator in ((0, X), (1, Y)):
        a, b = (H[k, i] - numerator / scale * H[2, i] for i in range(2))
        length = np.hypot(a * du[0] + b * du[1], a * dv[0] + b * dv[1]) / scale
        steepest = max(steepest, float(length.max()))
    return 1.1 * steepest  # the nodes lie within the tile's border
