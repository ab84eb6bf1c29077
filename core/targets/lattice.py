"""The geometry of a found grid: its spacing, and whether a lens could make it of a plane."""

from __future__ import annotations

from typing import cast

import cv2
import numpy as np
from jaxtyping import Float

_SMOOTH_TERMS = ((1, 3), (2, 6), (3, 10), (4, 15))  # degree of a polynomial in two variables, its terms
_LARGEST_RESIDUAL = 0.2  # of the local spacing
_LARGEST_KINK = 0.35  # of the longer of two successive steps
_LARGEST_BEND = 1.5  # of the local spacing: how far a lens may bend the board's lines (wide-angle ones: .9)


def spacing(grid: Float[np.ndarray, "rows columns 2"]) -> Float[np.ndarray, "rows columns"]:
    """Return each point's distance to its nearest neighbour in the grid, px."""
    across = np.linalg.norm(np.diff(grid, axis=1), axis=2)
    down = np.linalg.norm(np.diff(grid, axis=0), axis=2)
    wide = np.pad(across, ((0, 0), (1, 1)), constant_values=np.inf)
    high = np.pad(down, ((1, 1), (0, 0)), constant_values=np.inf)
    return np.minimum(np.minimum(wide[:, 1:], wide[:, :-1]), np.minimum(high[1:], high[:-1]))


def smooth_residuals(
    grid: Float[np.ndarray, "rows columns 2"],
) -> tuple[Float[np.ndarray, "rows columns 2"], Float[np.ndarray, "rows columns 2"]]:
    """Return what a homography leaves, and what a homography and a low polynomial (for the lens) leave, px.

    The polynomial has at most a third as many terms as there are points, so that it cannot follow single
    ones.
    """
    rows, columns = grid.shape[:2]
    y, x = np.mgrid[-1.0 : 1.0 : rows * 1j, -1.0 : 1.0 : columns * 1j]
    ideal = np.stack([x.ravel(), y.ravel()], axis=1)
    pixels = grid.reshape(-1, 2)
    middle, size = pixels.mean(axis=0), pixels.std()
    # None, which OpenCV's types leave out, for points that lie on a line
    H = cast("np.ndarray | None", cv2.findHomography(ideal, (pixels - middle) / max(size, 1e-9), 0)[0])
    if H is None or not np.all(np.isfinite(pixels)):
        return np.full_like(grid, np.inf), np.full_like(grid, np.inf)
    seen = np.column_stack([ideal, np.ones(len(ideal))]) @ H.T
    bend = pixels - (seen[:, :2] / seen[:, 2:] * size + middle)
    degree = max(d for d, terms in _SMOOTH_TERMS if d == 1 or terms <= len(pixels) // 3)
    degree = min(degree, rows, columns)
    powers = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
    A = np.stack([ideal[:, 0] ** i * ideal[:, 1] ** j for i, j in powers], axis=1)
    coefficients, *_ = np.linalg.lstsq(A, bend, rcond=None)
    return bend.reshape(grid.shape), (bend - A @ coefficients).reshape(grid.shape)


def is_smooth(grid: Float[np.ndarray, "rows columns 2"]) -> bool:
    """Tell whether the grid is one that a lens could make of a plane: detectors do return wrong ones.

    As a whole by what a homography and a low polynomial leave, and from point to point by the second differences,
    since lines that are shifted or swapped hide from a polynomial where there are few of them.
    """
    if not np.all(np.isfinite(grid)):
        return False
    local = spacing(grid)
    for along in (grid, np.swapaxes(grid, 0, 1)):
        steps = np.diff(along, axis=0)
        length = np.linalg.norm(steps, axis=2)
        if np.any(
            np.linalg.norm(np.diff(steps, axis=0), axis=2)
            > _LARGEST_KINK * np.maximum(length[1:], length[:-1])
        ):
            return False
    bend, rest = (np.linalg.norm(r, axis=2) for r in smooth_residuals(grid))
    return bool(
        np.all(np.isfinite(rest))
        and np.all(rest < _LARGEST_RESIDUAL * local)
        and np.all(bend < _LARGEST_BEND * local)
    )
