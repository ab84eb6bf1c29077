"""Maximum likelihood for dots: Gauss-Newton steps on the equations of `ellipse_model`."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Bool, Float, Shaped

from core.jit import jit
from core.targets.circles.centres.ellipse_model import RESIDUAL, ROWS, TOGETHER, write_equations

_SLOPE_SIGMA = 0.1  # of the contrast: how much it may change over the dot
_REACH_SETTLES = 3
_SPARSE_PIXELS = 100.0  # about so many pixels serve to come near, and determine twelve parameters
_SPARSEST = 3
_MAX_SPARSE_STEPS = 4
_MAX_SPARSE_GAIN, _MAX_SETTLED_GAIN = 0.5, 0.25  # of the squares, by one step
_MIN_PIXELS = 30
_HELD = 1e9  # of a parameter's own weight


@jit("f8[:, ::1], i8, f8[::1], f8[:, ::1]")
def solve_equations(
    N: Float[np.ndarray, "14 16"],
    first: int,
    solution: Float[np.ndarray, "12"],
    covariance: Float[np.ndarray, "2 2"],
) -> tuple[float, bool]:
    """Solve the equations for the parameters from `first` on, the others held; return how much of the sum of squares
    that explains, and false where they have no solution.

    Parameters are eliminated from the last one on, so that what is left of N for the first two is the inverse of their
    `covariance`. N is written over.
    """
    row = np.zeros(12)
    explained = 0.0
    for p in range(11, first - 1, -1):
        pivot = N[p, p] * (1.0 + 1e-10)
        if not pivot > 0.0:
            return explained, False
        if p == 1:
            corner, side, other = N[0, 0] * (1.0 + 1e-10), N[1, 0], pivot
            determinant = corner * other - side * side
            if not determinant > 0.0:
                return explained, False
            covariance[0, 0], covariance[1, 1] = other / determinant, corner / determinant
            covariance[0, 1] = covariance[1, 0] = -side / determinant
        N[p, p] = 1.0 / pivot
        for k in range(12):
            row[k] = N[p, k] if k < p else 0.0
        for i in range(first, p):
            factor = row[i] * N[p, p]
            for k in range(12):
                N[i, k] -= factor * row[k]
        factor = N[RESIDUAL, p] * N[p, p]
        explained += factor * N[RESIDUAL, p]
        for k in range(12):
            N[RESIDUAL, k] -= factor * row[k]
    for p in range(first, 12):
        total = N[RESIDUAL, p]
        for k in range(first, p):
            total -= N[p, k] * solution[k]
        solution[p] = total * N[p, p]
    return explained, True


@jit("u1[:, ::1], f8[::1], f8, i8, f8, f8, f8", "u2[:, ::1], f8[::1], f8, i8, f8, f8, f8")
def fit_dot(
    image: Shaped[np.ndarray, "h w"],
    start: Float[np.ndarray, "6"],
    least_blur: float,
    most_steps: int,
    tolerance: float,
    shape_sigma: float,
    blur_sigma: float,
) -> tuple[Float[np.ndarray, "6"], Float[np.ndarray, "6"], Float[np.ndarray, "2 2"], float, bool]:
    """Fit one dot by Gauss-Newton steps, until the next one would be shorter than `tolerance` standard uncertainties of
    the centre. The first ones use a part of a large dot's pixels.

    Small dots have few pixels to determine twelve parameters: M is held near `start`'s by `shape_sigma` (of its
    size), the blur by `blur_sigma` (of itself), the contrast's slopes near zero. Each is the standard deviation of a
    normal prior, relative to residuals of the variance found. On large dots the priors have hardly any weight.

    Returns
    -------
    shape, light
        As `write_equations` takes them.
    covariance
        Of the centre (px²) for residuals of variance one.
    variance
        Of the residuals.
    converged
        False where a step left the image, the dot, or did not settle.
    """
    shape, light, d = start.copy(), np.zeros(6), np.zeros(12)
    N, J, pixels = np.empty((ROWS, 16)), np.zeros((ROWS, TOGETHER)), np.empty((3, TOGETHER))
    covariance = np.zeros((2, 2))
    variance = 0.0
    size = math.sqrt(start[2] * start[4] - start[3] * start[3])
    radius = size**-0.5
    reach = max(3.5 * shape[5] + 1.0, 3.0)
    expected = 4.0 * math.pi * radius * min(reach, radius)
    stride = min(max(int(math.sqrt(expected / _SPARSE_PIXELS)), 1), _SPARSEST)
    # the light enters linearly: that which suits the start best
    if write_equations(image, shape, light, reach, stride, N, J, pixels) < _MIN_PIXELS:
        return shape, light, covariance, variance, False
    for i in range(6, 12):
        N[i, i] += 1e-9 * (1.0 + N[i, i])
    _, solved = solve_equations(N, 6, d, covariance)
    light += d[6:]
    if not solved:
        return shape, light, covariance, variance, False
    for step in range(most_steps):
        if step <= _REACH_SETTLES:  # then it stays: steps that change the pixels they rest on need not end
            reach = max(3.5 * shape[5] + 1.0, 3.0)
        count = write_equations(image, shape, light, reach, stride, N, J, pixels)
        if count < _MIN_PIXELS:
            return shape, light, covariance, variance, False
        squares = N[RESIDUAL, RESIDUAL]
        noise = squares / max(count - 12, 1) + 1.0 / 12.0
        for i in range(2, 5):
            weight = noise / (shape_sigma * size) ** 2
            N[i, i] += weight
            N[RESIDUAL, i] += weight * (start[i] - shape[i])
        weight = noise / (blur_sigma * start[5]) ** 2
        N[5, 5] += weight
        N[RESIDUAL, 5] += weight * (start[5] - shape[5])
        # At its least the blur is held: what less of it would explain is no step.
        if shape[5] <= least_blur and N[RESIDUAL, 5] < 0.0:
            N[5, 5] += _HELD * (1.0 + N[5, 5])
        for i in range(10, 12):
            weight = noise / (_SLOPE_SIGMA * light[3]) ** 2
            N[i, i] += weight
            N[RESIDUAL, i] -= weight * light[i - 6]
        explained, solved = solve_equations(N, 0, d, covariance)
        if not solved:
            return shape, light, covariance, variance, False
        length = math.sqrt(d[0] * d[0] + d[1] * d[1])
        if not length < 0.5 * radius:
            return shape, light, covariance, variance, False
        wider = max(-0.5 * shape[5], min(d[5], shape[5]))
        for i in range(5):
            shape[i] += d[i]
        shape[5] = max(least_blur, min(shape[5] + wider, 0.6 * radius))
        light += d[6:]
        determinant = shape[2] * shape[4] - shape[3] * shape[3]
        if not (determinant > 0.0 and shape[2] > 0.0):
            return shape, light, covariance, variance, False
        variance = max(squares - explained, 0.0) / max(count - 12, 1)
        sigma = math.sqrt(0.5 * (covariance[0, 0] + covariance[1, 1]) * (variance + 0.1))
        # a step leaves about its square, in units of the blur
        left = length * length / shape[5]
        if stride > 1:
            if (left < sigma and explained < _MAX_SPARSE_GAIN * squares) or step + 1 >= _MAX_SPARSE_STEPS:
                stride = 1
        elif left < tolerance * sigma and explained < _MAX_SETTLED_GAIN * squares:
            return shape, light, covariance, variance, True
    return shape, light, covariance, variance, False


@jit(
    "u1[:, ::1], f8[:, ::1], f8, i8, f8, f8, f8, f8[:, ::1], f8[::1], f8[:, :, ::1], f8[::1], b1[::1]",
    "u2[:, ::1], f8[:, ::1], f8, i8, f8, f8, f8, f8[:, ::1], f8[::1], f8[:, :, ::1], f8[::1], b1[::1]",
)
def fit_each(
    image: Shaped[np.ndarray, "h w"],
    starts: Float[np.ndarray, "n 6"],
    least_blur: float,
    most_steps: int,
    tolerance: float,
    shape_sigma: float,
    blur_sigma: float,
    shapes: Float[np.ndarray, "n 6"],
    contrast: Float[np.ndarray, " n"],
    covariance: Float[np.ndarray, "n 2 2"],
    variance: Float[np.ndarray, " n"],
    converged: Bool[np.ndarray, " n"],
) -> None:
    """Fit many dots as `fit_dot` does one, and write what comes of it; c₀ as `contrast`."""
    for n in range(len(starts)):
        shape, light, of_centre, variance[n], converged[n] = fit_dot(
            image, starts[n], least_blur, most_steps, tolerance, shape_sigma, blur_sigma
        )
        shapes[n], contrast[n], covariance[n] = shape, light[3], of_centre
