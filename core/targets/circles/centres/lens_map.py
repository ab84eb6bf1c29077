"""The map from a plane to its image by a lens with radial distortion, fitted to a grid's points.

A homography q of the plane and, about a centre c of the image, a radial polynomial:

    p = q + d (k₁ ρ² + k₂ ρ⁴ + k₃ ρ⁶),   d = q - c,   ρ = |d|

It is the pinhole camera with the lens of D. C. Brown, "Close-range camera calibration", Photogrammetric Engineering 37
(1971) 855-866, whose focal length is in the k and whose pose is in q; moving c by δ adds to first order the terms of a
lens that is not centred. Thirteen parameters determine what a polynomial of fifth degree has fifty for
(`core.targets.subpixel`), so that the map is known at the grid's ends as well, where a polynomial's derivatives are
not. Lengths are in units of the points' spread.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from core.geometry import normalised_homography

PARAMETERS = 13
_NOISE_PX = 0.02  # of a centre, compared with which the priors count
_CENTRE_SD = 0.05  # of half of the image's diagonal, about its middle
_BEND_SD = (0.3, 0.2, 0.1)  # of half of the diagonal, at its end, by k₁ to k₃
_MAX_STEPS = 60
_SETTLED = 1e-6  # of the sum of squares
_FIRST_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-3, 1e-9, 1e6
_LEAST_SCALE = 1e-9  # of all: what hardly moves the points, as the centre of a lens that bends little, stays


@dataclass(frozen=True, slots=True)
class LensMap:
    """The map, in a plane and an image that are normalised: each about a middle and in units of a size."""

    parameters: Float[np.ndarray, "13"]
    """H row by row without its last element, which is 1; c; k."""
    middle: Float[np.ndarray, "2"]
    size: float
    middle_px: Float[np.ndarray, "2"]
    size_px: float

    def bend(self, plane: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Return how far the lens displaces points of the plane from their images by the homography, px."""
        q, _ = _projected(self.parameters, self._normalised(plane))
        d, radial, _ = _distorted(self.parameters, q)
        return np.asarray(self.size_px * d * radial[:, None])

    def bend_slopes(self, plane: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2 2"]:
        """Return the derivatives of `bend`, px per unit of the plane."""
        x = self._normalised(plane)
        q, depth = _projected(self.parameters, x)
        H = self.parameters[:6].reshape(2, 3)
        by_x = (H[:, :2] - q[:, :, None] * self.parameters[6:8]) / depth[:, None, None]
        by_q = _distorted(self.parameters, q)[2] - np.eye(2)
        return np.asarray(self.size_px / self.size * (by_q @ by_x))

    def _normalised(self, plane: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        return (plane - self.middle) / self.size


def fit_lens_map(
    plane: Float[np.ndarray, "n 2"],
    points_px: Float[np.ndarray, "n 2"],
    image_middle_px: Float[np.ndarray, "2"],
    start: LensMap | None = None,
) -> LensMap:
    """Fit the map to points by Levenberg's and Marquardt's method, from a homography with the lens's centre in the
    image's middle, or from the map of points near them. Priors say what few points leave open: ten coordinates of nine
    dots stand against five of a lens's parameters."""
    start = start or _plain(plane, points_px, image_middle_px)
    p = start.parameters
    expected, weight = _prior(start, image_middle_px)
    x, y = (plane - start.middle) / start.size, (points_px - start.middle_px) / start.size_px
    mapped, J = _mapped(p, x)
    residuals = (y - mapped).ravel()
    squares, damping = float(residuals @ residuals + weight @ (expected - p) ** 2), _FIRST_DAMPING
    for _ in range(_MAX_STEPS):
        N, g = J.T @ J + np.diag(weight), J.T @ residuals + weight * (expected - p)
        scale = np.maximum(np.diag(N), _LEAST_SCALE * np.trace(N))
        gain = 0.0
        while damping < _MOST_DAMPING:
            step = np.linalg.solve(N + np.diag(damping * scale), g)
            with np.errstate(over="ignore", divide="ignore", invalid="ignore"):  # of a step much too long
                mapped, J_there = _mapped(p + step, x)
                there = (y - mapped).ravel()
                gain = squares - float(there @ there + weight @ (expected - p - step) ** 2)
            if gain > 0.0:
                p, J, residuals, squares = p + step, J_there, there, squares - gain
                damping = max(0.1 * damping, _LEAST_DAMPING)
                break
            damping *= 10.0
        if not gain > _SETTLED * squares:
            break
    return replace(start, parameters=p)


def _plain(
    plane: Float[np.ndarray, "n 2"],
    points_px: Float[np.ndarray, "n 2"],
    image_middle_px: Float[np.ndarray, "2"],
) -> LensMap:
    """Return the homography of points as a lens that bends nothing."""
    middle, middle_px = plane.mean(axis=0), points_px.mean(axis=0)
    size, size_px = (max(float(np.std(values)), 1e-9) for values in (plane - middle, points_px - middle_px))
    x, y = (plane - middle) / size, (points_px - middle_px) / size_px
    H = normalised_homography(x, y, np.ones(len(x)))
    c = (image_middle_px - middle_px) / size_px
    parameters = np.concatenate([H.ravel()[:8] / H[2, 2], c, np.zeros(3)])
    return LensMap(parameters, middle, size, middle_px, size_px)


def _prior(
    start: LensMap, image_middle_px: Float[np.ndarray, "2"]
) -> tuple[Float[np.ndarray, "13"], Float[np.ndarray, "13"]]:
    """Return what the parameters are expected to be, and the weights of that, those of points being 1."""
    expected, deviation = np.zeros(PARAMETERS), np.full(PARAMETERS, np.inf)
    half_diagonal = float(np.hypot(*image_middle_px)) / start.size_px
    expected[8:10] = (image_middle_px - start.middle_px) / start.size_px
    deviation[8:10] = _CENTRE_SD * half_diagonal
    deviation[10:] = _BEND_SD / half_diagonal ** np.array([2, 4, 6])
    return expected, (_NOISE_PX / start.size_px / deviation) ** 2


def _mapped(
    p: Float[np.ndarray, "13"], x: Float[np.ndarray, "n 2"]
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "m 13"]]:
    """Return the map of points, and its derivatives by the parameters, coordinate by coordinate."""
    q, depth = _projected(p, x)
    d, radial, by_q = _distorted(p, q)
    ones = np.column_stack([x, np.ones(len(x))]) / depth[:, None]
    by_h = np.zeros((len(x), 2, 8))
    by_h[:, 0, 0:3] = by_h[:, 1, 3:6] = ones
    by_h[:, :, 6:8] = -q[:, :, None] * ones[:, None, :2]
    J = np.empty((len(x), 2, PARAMETERS))
    J[:, :, :8] = by_q @ by_h
    J[:, :, 8:10] = np.eye(2) - by_q
    square = np.sum(d**2, axis=1)
    J[:, :, 10:] = d[:, :, None] * np.stack([square, square**2, square**3], axis=1)[:, None, :]
    return q + d * radial[:, None], J.reshape(-1, PARAMETERS)


def _projected(
    p: Float[np.ndarray, "13"], x: Float[np.ndarray, "n 2"]
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]]:
    """Return q of points, and their depths, which are 1 in the plane's middle."""
    depth = x @ p[6:8] + 1.0
    return (x @ p[:6].reshape(2, 3)[:, :2].T + p[[2, 5]]) / depth[:, None], depth


def _distorted(
    p: Float[np.ndarray, "13"], q: Float[np.ndarray, "n 2"]
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"], Float[np.ndarray, "n 2 2"]]:
    """Return d, the radial polynomial, and the derivatives of the map by q."""
    d = q - p[8:10]
    square = np.sum(d**2, axis=1)
    k1, k2, k3 = p[10:]
    radial = square * (k1 + square * (k2 + square * k3))
    change = 2.0 * (k1 + square * (2.0 * k2 + square * 3.0 * k3))
    by_q = (1.0 + radial)[:, None, None] * np.eye(2) + change[:, None, None] * d[:, :, None] * d[:, None, :]
    return d, radial, by_q
