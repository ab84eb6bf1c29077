"""Fields of corner noise over the image: white, correlated between neighbours, and waves over the image's rows.

Air that shimmers, a board's texture under the detector's window and demosaicing make noise that neighbouring grid
points share; a rolling shutter before a shaking camera makes waves over the rows. Each is a stationary Gaussian field
of displacement, of unit variance in u and in v where nothing else is said:

- squared exponential exp(-d² / 2 l²), and Matérn of order 3/2, (1 + a) exp(-a) with a = √3 d / l, of a distance d in
  the image (px);
- a wave of random phase and wavelength λ, cos(2π (v - v') / λ), in u alone or in v alone.

Reference: C. E. Rasmussen, C. K. I. Williams, "Gaussian Processes for Machine Learning", 2006, §4.2.1.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float
from scipy.spatial.distance import cdist

from core.jit import jit

SQUARED_EXPONENTIALS = (1.0, 2.0, 4.0)
"""Lengths l in squares of the grid as the image shows it, each twice the one before: `smooth_mixture` relies on it."""
MATERNS = (2.0, 8.0)
"""Each four times the one before."""
WAVELENGTHS = (*(0.1 * 1.2**k for k in range(14)), 1.5, 2.2, 4.0)
"""In image heights. A coarser grid would take one wave for a mixture of its neighbours, of which some move the pose."""
_SMOOTH = len(SQUARED_EXPONENTIALS) + len(MATERNS)
FIELDS = _SMOOTH + 2 * len(WAVELENGTHS)
"""How many fields there are, in addition to white noise."""
_CHUNK = 512


def propagated_fields(
    along: Float[np.ndarray, "2 p d"], points_px: Float[np.ndarray, "p 2"], height_px: float
) -> Float[np.ndarray, "k d d"]:
    """Return Aᵀ K_k A for each field, of linear combinations A of displacements (u, v) at p points.

    A square is the median distance of a point from its nearest neighbour. The cost is quadratic in the points, the
    memory linear.
    """
    d = along.shape[2]
    result = np.empty((FIELDS, d, d))
    result[:_SMOOTH] = 0.0
    for part, kernels in _smooth_kernels(points_px):
        for k, kernel in enumerate(kernels):
            for component in along:
                result[k] += component[part].T @ (kernel @ component)
    quadratures = _quadratures(points_px, height_px)
    for j, component in enumerate(along):
        moved = quadratures @ component
        waves = np.einsum("qkd,qke->kde", moved, moved)
        result[_SMOOTH + j * len(WAVELENGTHS) : _SMOOTH + (j + 1) * len(WAVELENGTHS)] = waves
    return result


def propagated_mixture(
    along: Float[np.ndarray, "2 p d"],
    points_px: Float[np.ndarray, "p 2"],
    height_px: float,
    sizes: Float[np.ndarray, " k"],
) -> Float[np.ndarray, "d d"]:
    """Return Σ θ_k Aᵀ K_k A of `propagated_fields`, in a fraction of its time."""
    d = along.shape[2]
    half = np.zeros((d, d))
    spacing = median_spacing(points_px)
    for begin in range(0, len(points_px), _CHUNK):
        lower = smooth_mixture(points_px, begin, begin + _CHUNK, spacing, sizes[:_SMOOTH])
        for component in along:
            half += component[begin : begin + _CHUNK].T @ (lower @ component[: lower.shape[1]])
    result = half + half.T
    quadratures = _quadratures(points_px, height_px)
    for component, of_waves in zip(along, sizes[_SMOOTH:].reshape(2, -1), strict=True):
        moved = (quadratures @ component) * np.sqrt(of_waves)[:, None]
        flat = moved.reshape(-1, d)
        result += flat.T @ flat
    return result


def _smooth_kernels(
    points_px: Float[np.ndarray, "p 2"],
) -> Iterator[tuple[slice, list[Float[np.ndarray, "c p"]]]]:
    """Yield some points, and the covariances of the smooth fields between these and all."""
    spacing = median_spacing(points_px)
    for begin in range(0, len(points_px), _CHUNK):
        part = slice(begin, begin + _CHUNK)
        distance = cdist(points_px[part], points_px) / spacing
        kernels = [np.exp(-0.5 * (distance / length) ** 2) for length in SQUARED_EXPONENTIALS]
        kernels += [_matern(np.sqrt(3.0) * distance / length) for length in MATERNS]
        yield part, kernels


@jit("f8[:, ::1]")
def median_spacing(points_px: Float[np.ndarray, "p 2"]) -> float:
    """Return the median distance of a point from its nearest neighbour."""
    nearest = np.full(len(points_px), np.inf)
    for i in range(len(points_px)):
        for j in range(i):
            u, v = points_px[i, 0] - points_px[j, 0], points_px[i, 1] - points_px[j, 1]
            square = u * u + v * v
            nearest[i], nearest[j] = min(nearest[i], square), min(nearest[j], square)
    return float(np.median(np.sqrt(nearest)))


@jit("f8[:, ::1], i8, i8, f8, f8[::1]")
def smooth_mixture(
    points_px: Float[np.ndarray, "p 2"], begin: int, end: int, spacing: float, sizes: Float[np.ndarray, " k"]
) -> Float[np.ndarray, "c e"]:
    """Return rows `begin` to `end` of L, of which L + Lᵀ is the covariance of a mixture of the smooth fields: its lower
    triangle with half of the diagonal.
    """
    end = min(end, len(points_px))
    lower = np.zeros((end - begin, end))
    for i in range(begin, end):
        for j in range(i):
            u, v = points_px[i, 0] - points_px[j, 0], points_px[i, 1] - points_px[j, 1]
            square = (u * u + v * v) / (spacing * spacing)
            total = 0.0
            # Exponentials are most of the time: one of each kind, the longest; the shorter ones are its powers.
            power = np.exp(-0.5 * square / (SQUARED_EXPONENTIALS[-1] * SQUARED_EXPONENTIALS[-1]))
            for k in range(len(SQUARED_EXPONENTIALS) - 1, -1, -1):
                total += sizes[k] * power
                power = (power * power) * (power * power)
            scaled = np.sqrt(3.0 * square) / MATERNS[-1]
            power = np.exp(-scaled)
            for k in range(len(MATERNS) - 1, -1, -1):
                total += sizes[len(SQUARED_EXPONENTIALS) + k] * (1.0 + scaled) * power
                scaled *= 4.0
                power = (power * power) * (power * power)
            lower[i - begin, j] = total
        lower[i - begin, i] = 0.5 * sizes.sum()
    return lower


def _quadratures(points_px: Float[np.ndarray, "p 2"], height_px: float) -> Float[np.ndarray, "2 w p"]:
    """Return c and s of each wave, whose covariance is c cᵀ + s sᵀ."""
    phase = 2.0 * np.pi * points_px[:, 1] / (np.array(WAVELENGTHS)[:, None] * height_px)
    return np.stack([np.cos(phase), np.sin(phase)])


def _matern(scaled: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    return np.asarray((1.0 + scaled) * np.exp(-scaled))
