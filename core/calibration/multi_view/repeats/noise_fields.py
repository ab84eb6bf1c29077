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

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

SQUARED_EXPONENTIALS = (1.0, 2.0, 4.0)
"""Lengths l in squares of the grid as the image shows it."""
MATERNS = (2.0, 8.0)
WAVELENGTHS = (*(0.1 * 1.2**k for k in range(14)), 1.5, 2.2, 4.0)
"""In image heights. A coarser grid would take one wave for a mixture of its neighbours, of which some move the pose."""
FIELDS = len(SQUARED_EXPONENTIALS) + len(MATERNS) + 2 * len(WAVELENGTHS)
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
    spacing = float(np.median(KDTree(points_px).query(points_px, k=2)[0][:, 1]))
    result = np.empty((FIELDS, d, d))
    smooth = len(SQUARED_EXPONENTIALS) + len(MATERNS)
    result[:smooth] = 0.0
    for begin in range(0, len(points_px), _CHUNK):
        part = slice(begin, begin + _CHUNK)
        distance = cdist(points_px[part], points_px) / spacing
        kernels = [np.exp(-0.5 * (distance / length) ** 2) for length in SQUARED_EXPONENTIALS]
        kernels += [_matern(np.sqrt(3.0) * distance / length) for length in MATERNS]
        for k, kernel in enumerate(kernels):
            for component in along:
                result[k] += component[part].T @ (kernel @ component)
    phase = 2.0 * np.pi * points_px[:, 1] / (np.array(WAVELENGTHS)[:, None] * height_px)
    quadratures = np.stack([np.cos(phase), np.sin(phase)])  # K = c cᵀ + s sᵀ
    for j, component in enumerate(along):
        moved = quadratures @ component
        waves = np.einsum("qkd,qke->kde", moved, moved)
        result[smooth + j * len(WAVELENGTHS) : smooth + (j + 1) * len(WAVELENGTHS)] = waves
    return result


def _matern(scaled: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    return np.asarray((1.0 + scaled) * np.exp(-scaled))
