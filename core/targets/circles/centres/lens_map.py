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
from core.jit import jit

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
        q, _ = _projected(self.parameters, self.normalised(plane))
        d, _, radial = _radial(self.parameters, q)
        return np.asarray(self.size_px * d * radial[:, None])

    def bend_slopes(self, plane: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2 2"]:
        """Return the derivatives of `bend`, px per unit of the plane."""
        x = self.normalised(plane)
        q, depth = _projected(self.parameters, x)
        H = self.parameters[:6].reshape(2, 3)
        by_x = (H[:, :2] - q[:, :, None] * self.parameters[6:8]) / depth[:, None, None]
        d, square, radial = _radial(self.parameters, q)
        k1, k2, k3 = self.parameters[10:]
        change = 2.0 * (k1 + square * (2.0 * k2 + square * 3.0 * k3))
        by_q = radial[:, None, None] * np.eye(2) + change[:, None, None] * d[:, :, None] * d[:, None, :]
        return np.asarray(self.size_px / self.size * (by_q @ by_x))

    def normalised(self, plane: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Return points of the plane about its middle, in units of its size."""
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
    x = np.ascontiguousarray(start.normalised(plane))
    y = np.ascontiguousarray((points_px - start.middle_px) / start.size_px)

    def at(p: Float[np.ndarray, "13"]) -> tuple[Float[np.ndarray, "13 13"], Float[np.ndarray, "13"], float]:
        N, g, squares = equations(p, x, y)
        return N + np.diag(weight), g + weight * (expected - p), squares + float(weight @ (expected - p) ** 2)

    (N, g, squares), damping = at(p), _FIRST_DAMPING
    for _ in range(_MAX_STEPS):
        scale = np.maximum(np.diag(N), _LEAST_SCALE * np.trace(N))
        gain = 0.0
        while damping < _MOST_DAMPING:
            step = np.linalg.solve(N + np.diag(damping * scale), g)
            with np.errstate(over="ignore", invalid="ignore"):  # of a step much too long
                there = at(p + step)
            gain = squares - there[2]
            if gain > 0.0:
                p, (N, g, squares) = p + step, there
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


@jit("f8[::1], f8[:, ::1], f8[:, ::1]", reassociates=True)
def equations(
    p: Float[np.ndarray, "13"], x: Float[np.ndarray, "n 2"], y: Float[np.ndarray, "n 2"]
) -> tuple[Float[np.ndarray, "13 13"], Float[np.ndarray, "13"], float]:
    """Return JᵀJ and Jᵀ(y - mapped) of points that are equally weighted, J being the map's derivatives by the
    parameters, and the sum of squares."""
    N, g, squares = np.zeros((13, 13)), np.zeros(13), 0.0
    J = np.zeros((2, 13))
    c_u, c_v, k1, k2, k3 = p[8], p[9], p[10], p[11], p[12]
    for n in range(len(x)):
        x_u, x_v = x[n, 0], x[n, 1]
        per_depth = 1.0 / (p[6] * x_u + p[7] * x_v + 1.0)
        q_u = (p[0] * x_u + p[1] * x_v + p[2]) * per_depth
        q_v = (p[3] * x_u + p[4] * x_v + p[5]) * per_depth
        d_u, d_v = q_u - c_u, q_v - c_v
        square = d_u * d_u + d_v * d_v
        radial = square * (k1 + square * (k2 + square * k3))
        change = 2.0 * (k1 + square * (2.0 * k2 + square * 3.0 * k3))
        for c in range(2):
            d = d_u if c == 0 else d_v
            # the map's derivatives by q
            by_u = change * d * d_u + (1.0 + radial if c == 0 else 0.0)
            by_v = change * d * d_v + (1.0 + radial if c == 1 else 0.0)
            for k in range(3):
                along = (x_u if k == 0 else x_v if k == 1 else 1.0) * per_depth
                J[c, k], J[c, 3 + k] = by_u * along, by_v * along
                if k < 2:
                    J[c, 6 + k] = -(by_u * q_u + by_v * q_v) * along
            J[c, 8], J[c, 9] = (1.0 if c == 0 else 0.0) - by_u, (1.0 if c == 1 else 0.0) - by_v
            J[c, 10], J[c, 11], J[c, 12] = d * square, d * square * square, d * square * square * square
            rest = y[n, c] - (q_u if c == 0 else q_v) - d * radial
            squares += rest * rest
            for i in range(13):
                g[i] += J[c, i] * rest
                for j in range(i + 1):
                    N[i, j] += J[c, i] * J[c, j]
    for i in range(13):
        for j in range(i):
            N[j, i] = N[i, j]
    return N, g, squares


def _projected(
    p: Float[np.ndarray, "13"], x: Float[np.ndarray, "n 2"]
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]]:
    """Return q of points, and their depths, which are 1 in the plane's middle."""
    depth = x @ p[6:8] + 1.0
    return (x @ p[:6].reshape(2, 3)[:, :2].T + p[[2, 5]]) / depth[:, None], depth


def _radial(
    p: Float[np.ndarray, "13"], q: Float[np.ndarray, "n 2"]
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Return d, its squared length, and the radial polynomial."""
    d = q - p[8:10]
    square = d[:, 0] ** 2 + d[:, 1] ** 2
    k1, k2, k3 = p[10:]
    return d, square, square * (k1 + square * (k2 + square * k3))
