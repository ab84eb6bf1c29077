"""Sub-pixel refinement of chessboard corners at full resolution, and what doubt is left.

Around a corner q every gradient g at a pixel p is perpendicular to p - q: on an edge the difference runs
along it, in a flat square g = 0. So q minimises Σ (gᵀ(p - q))² over a window (W. Förstner, E. Gülch, 1987),
which OpenCV's `cornerSubPix` iterates. The window follows the local spacing: as large as reaches no other
corner's edges, up to where it gains nothing.
"""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float, Float32

from core.targets.lattice import spacing

_WINDOW_OF_SPACING = 0.38
_LEAST_WINDOW, _LARGEST_WINDOW = 2, 11
_STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-4)

_DERIVATIVE_NOISE = 12.0 / 64.0  # variance that 3 x 3 Sobel / 8 makes of unit white noise
_OVER_BOUND = 2.6
"""How far this estimator's error lies above the bound of its window, measured on rendered images: 2 to
2.6."""
_OWN_ERROR_PX = 0.012
"""What this estimator is off by without any noise: its window is not centred on the corner's own gradients. Root
mean square over rendered standard scenes, .011 to .012."""
_ROUNDING = 1.0 / np.sqrt(12.0)


def refine(
    image: Float32[np.ndarray, "h w"], grid: Float[np.ndarray, "rows columns 2"]
) -> Float[np.ndarray, "rows columns 2"]:
    """Return the corners refined, px; one that runs away, or is not in the image, is left where it was."""
    half = windows(grid)
    refined = grid.copy()
    inside = np.all((grid >= 0.0) & (grid <= np.array(image.shape[::-1]) - 1.0), axis=2)
    for window in np.unique(half[inside]):
        chosen = (half == window) & inside
        corners = np.ascontiguousarray(grid[chosen].reshape(-1, 1, 2), dtype=np.float32)
        found = cv2.cornerSubPix(image, corners, (int(window), int(window)), (-1, -1), _STOP)
        refined[chosen] = np.asarray(found, dtype=np.float64).reshape(-1, 2)
    moved = np.linalg.norm(refined - grid, axis=2)
    lost = (moved > half) | ~np.isfinite(moved)
    refined[lost] = grid[lost]
    return refined


def windows(grid: Float[np.ndarray, "rows columns 2"]) -> np.ndarray:
    """Return the half width (px, whole) of each corner's window."""
    half = np.floor(_WINDOW_OF_SPACING * spacing(grid))
    return np.clip(half, _LEAST_WINDOW, _LARGEST_WINDOW).astype(int)


def standard_uncertainties(
    image: Float32[np.ndarray, "h w"], grid: Float[np.ndarray, "rows columns 2"]
) -> Float[np.ndarray, "rows columns"]:
    """Return each corner's standard uncertainty for u and v alike, px, from noise and gradients in its
    window.

    In white noise of variance s² no estimator does better than the covariance s² M⁻¹, M = Σ g gᵀ over the
    window (the Cramér-Rao bound of a shift). Stated is √(½ trace) of that, times what this estimator loses
    against it, and its own error beside. s comes from the picture; M is freed of what the noise adds to it.
    """
    noise = noise_level(image, grid)
    uncertainties = np.full(grid.shape[:2], np.inf)
    half = windows(grid)
    for index in np.ndindex(*grid.shape[:2]):
        u, v = np.rint(grid[index]).astype(int)
        reach = half[index] + 1
        patch = image[max(v - reach, 0) : v + reach + 1, max(u - reach, 0) : u + reach + 1]
        gu = cv2.Sobel(patch, cv2.CV_32F, 1, 0, scale=0.125)[1:-1, 1:-1].astype(np.float64)
        gv = cv2.Sobel(patch, cv2.CV_32F, 0, 1, scale=0.125)[1:-1, 1:-1].astype(np.float64)
        added = gu.size * _DERIVATIVE_NOISE * noise**2
        a, b, c = np.sum(gu * gu) - added, np.sum(gu * gv), np.sum(gv * gv) - added
        determinant = a * c - b * b
        if a > 0.0 and c > 0.0 and determinant > 0.0:
            uncertainties[index] = _OVER_BOUND * noise * np.sqrt(0.5 * (a + c) / determinant)
    # a corner without gradients is worth next to nothing: as uncertain as its window is wide
    return np.minimum(np.hypot(uncertainties, _OWN_ERROR_PX), half.astype(np.float64))


def noise_level(image: Float32[np.ndarray, "h w"], grid: Float[np.ndarray, "rows columns 2"]) -> float:
    """Return the standard deviation of white noise over the board, in the image's grey levels.

    J. Immerkær, "Fast noise variance estimation", CVIU 64 (1996) 300-302, with the median in place of the
    mean, so that edges do not count; never below the rounding to whole levels.
    """
    (left, top), (right, bottom) = (np.rint(f(grid, axis=(0, 1))).astype(int) for f in (np.min, np.max))
    part = image[max(top, 0) : bottom + 1, max(left, 0) : right + 1]
    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], dtype=np.float32) / 6.0
    filtered = cv2.filter2D(part, cv2.CV_32F, kernel)
    return max(float(np.median(np.abs(filtered))) / 0.6745, _ROUNDING)
