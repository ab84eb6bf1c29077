"""Is a found grid a chessboard, the whole of it and nothing more? Tests on its geometry and on the
picture."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32

_SMOOTH_TERMS = ((1, 3), (2, 6), (3, 10), (4, 15))  # degree of a polynomial in two variables, its terms
_LARGEST_RESIDUAL = 0.2  # of the local spacing
_LARGEST_BEND = 0.8  # of the local spacing: how far a lens may bend the board's lines
_LEAST_RIGHT_SQUARES = 0.93
_QUADRANTS = ((-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0))
_QUADRANT_REACH = 0.3  # of the spacing
_CONTINUES = 0.6  # of a line's visible places


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
    H, _ = cv2.findHomography(ideal, (pixels - middle) / size, 0)
    if H is None:
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
    """Tell whether the grid is one that a lens could make of a plane: detectors do return wrong ones."""
    local = spacing(grid)
    bend, rest = (np.linalg.norm(r, axis=2) for r in smooth_residuals(grid))
    return bool(
        np.all(np.isfinite(rest))
        and np.all(rest < _LARGEST_RESIDUAL * local)
        and np.all(bend < _LARGEST_BEND * local)
    )


class Squares:
    """The grey values of the squares between a grid's points."""

    def __init__(self, image: np.ndarray, grid: Float[np.ndarray, "rows columns 2"]) -> None:
        self._image = image
        self._grid = grid
        centres = (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:]) / 4.0
        x_step, y_step = self._steps(centres.shape[:2])
        offsets = [a * x_step + b * y_step for a in (-0.2, 0.0, 0.2) for b in (-0.2, 0.0, 0.2)]
        levels = np.median([sample(image, centres + offset)[0] for offset in offsets], axis=0)
        j, i = np.mgrid[0 : levels.shape[0], 0 : levels.shape[1]]
        sign = np.where((i + j) % 2 == 0, -1.0, 1.0)
        steps = np.concatenate(
            [
                (np.diff(levels, axis=1) * sign[:, 1:]).ravel(),
                (np.diff(levels, axis=0) * sign[1:]).ravel(),
            ]
        )
        middle = float(np.median(steps))
        self.origin_is_black = middle > 0.0
        self.contrast = abs(middle)
        """Median difference of neighbouring squares, grey levels."""
        self.right = float(np.mean(steps * np.sign(middle) > 0.25 * self.contrast)) if middle != 0.0 else 0.0
        """Share of the neighbours whose difference has the sign that a chessboard's has, and is no trifle."""

    def are_a_chessboard(self) -> bool:
        """Tell whether neighbouring squares differ in colour as a chessboard's do."""
        return self.right >= _LEAST_RIGHT_SQUARES

    def continue_beyond(self) -> Bool[np.ndarray, "4"]:
        """Tell on which sides (top, bottom, left, right) the lattice goes on beyond the grid."""
        return np.array([self._line_beyond(*side)[0] for side in self._sides()])

    def leave_the_image(self) -> Bool[np.ndarray, "4"]:
        """Tell on which sides the next line of points would not be wholly in the image."""
        return np.array([not self._line_beyond(*side)[1] for side in self._sides()])

    def _sides(self) -> list[tuple[Float[np.ndarray, "three n 2"], bool]]:
        """Return per side the three outermost lines, outermost first, and whether the origin's parity is
        even."""
        g, black = self._grid, self.origin_is_black
        rows, columns = g.shape[:2]
        turned = np.swapaxes(g, 0, 1)
        return [
            (g[:3], not black),
            (g[::-1][:3], black != (rows % 2 == 1)),
            (turned[:3], not black),
            (turned[::-1][:3], black != (columns % 2 == 1)),
        ]

    def _line_beyond(self, lines: Float[np.ndarray, "three n 2"], first_black: bool) -> tuple[bool, bool]:
        """Return whether the next line beyond is one of saddle points, and whether all of it is in the image.

        A place is a saddle if its four quadrants' colours alternate as the board's do; `first_black`: is the
        quadrant that lies outward and forward along the line, at the line's first place, black?
        """
        place = 3.0 * lines[0] - 3.0 * lines[1] + lines[2]
        outward = place - lines[0]
        along = np.gradient(place, axis=0)
        levels = []
        visible = np.ones(len(place), dtype=bool)
        for a, b in _QUADRANTS:
            level, inside = sample(self._image, place + _QUADRANT_REACH * (a * outward + b * along))
            levels.append(level)
            visible &= inside
        diagonal, other = np.stack([levels[0], levels[3]]), np.stack([levels[1], levels[2]])
        dark_diagonal = other.min(axis=0) - diagonal.max(axis=0)
        dark_other = diagonal.min(axis=0) - other.max(axis=0)
        even = np.arange(len(place)) % 2 == 0
        gap = np.where(even == first_black, dark_diagonal, dark_other)
        saddles = (gap > 0.3 * self.contrast) & visible
        seen = int(visible.sum())
        goes_on = seen >= 2 and int(saddles.sum()) >= max(2.0, _CONTINUES * seen)
        return goes_on, bool(visible.all())

    def _steps(self, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        g = self._grid
        x_step = (g[:-1, 1:] - g[:-1, :-1] + g[1:, 1:] - g[1:, :-1]) / 2.0
        y_step = (g[1:, :-1] - g[:-1, :-1] + g[1:, 1:] - g[:-1, 1:]) / 2.0
        return x_step, y_step


def sample(
    image: np.ndarray, places: Float[np.ndarray, "*n 2"]
) -> tuple[Float32[np.ndarray, "*n"], Bool[np.ndarray, "*n"]]:
    """Return grey values at pixel places by bilinear interpolation, and which of the places are in the
    image."""
    flat = places.reshape(1, -1, 2).astype(np.float32)
    levels = cv2.remap(image, flat[..., 0], flat[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    height, width = image.shape
    inside = np.all((places >= 0.0) & (places <= np.array([width - 1.0, height - 1.0])), axis=-1)
    return levels.astype(np.float32).reshape(places.shape[:-1]), inside
