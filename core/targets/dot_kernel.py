"""Maximum likelihood for one dot: an ellipse with a blurred edge, on the picture's own pixels.

The model at a pixel d = (x, y) from the centre, in units of the dot's mean radius r:

    g = b₀ + b₁ x + b₂ y + (c₀ + c₁ x + c₂ y) Φ(a / s),   a = (1 - F) F / |M d|,   F² = dᵀ M d

with a the distance to the edge, to first order in curvature, and s the blur. Parameters: centre (2), M's three
elements, s, and the six of the light. Pixels further than `reach` from the edge say nothing of the ellipse and are left
out. The model is symmetric about the centre, so that what it lacks (the curvature within the blur) moves the edge but
not the centre.

Derivatives are collected for many pixels at a time, one parameter after the other, so that the processor's vectors do
the sums of their products, which are most of the work.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Bool, Float, Shaped
from scipy.special import ndtr

from core.compiled import compiled

_SLOPE_DOUBT = 0.1  # of the contrast: how much it may change over the dot
_REACH_SETTLES = 3
_SPARSE_PIXELS = 100.0  # about so many pixels serve to come near, and tell twelve parameters
_SPARSEST = 3
_MOST_SPARSE_STEPS = 4
_MUCH_TOLD, _LITTLE_TOLD = 0.5, 0.25  # of the squares, by one step
_TOGETHER = 96  # pixels
_ROOT_2_PI = math.sqrt(2.0 * math.pi)
_PER_UNIT = 32
_AT = np.arange(0.0, 6.5, 1.0 / _PER_UNIT)
_PHI = ndtr(_AT)
_BELL = np.exp(-0.5 * _AT**2) / _ROOT_2_PI
_PHI.flags.writeable = _BELL.flags.writeable = False


@compiled
def normal(z: float) -> tuple[float, float]:
    """Return the standard normal's distribution function and density, by Taylor's series about a table's places."""
    x = abs(z)
    if x >= 6.0:
        return (1.0 if z > 0.0 else 0.0), 0.0
    k = int(x * _PER_UNIT + 0.5)
    at = k / _PER_UNIT
    h, bell = x - at, _BELL[k]
    second = at * at - 1.0
    upper = _PHI[k] + bell * h * (1.0 - 0.5 * at * h + second * h * h / 6.0)
    density = bell * (1.0 - at * h + 0.5 * second * h * h - at * (at * at - 3.0) * h * h * h / 6.0)
    return (upper if z >= 0.0 else 1.0 - upper), density


@compiled(reassociates=True)
def _add_up(
    J: Float[np.ndarray, "13 together"],
    count: int,
    N: Float[np.ndarray, "12 12"],
    g: Float[np.ndarray, "12"],
) -> float:
    """Add the products of the derivatives with each other, and with the residuals, which are J's last row; return the
    residuals' own."""
    for i in range(12):
        for j in range(i + 1):
            total = 0.0
            for k in range(count):
                total += J[i, k] * J[j, k]
            N[i, j] += total
        total = 0.0
        for k in range(count):
            total += J[i, k] * J[12, k]
        g[i] += total
    squares = 0.0
    for k in range(count):
        squares += J[12, k] * J[12, k]
    return squares


@compiled
def dot_equations(
    image: Shaped[np.ndarray, "h w"],
    shape: Float[np.ndarray, "6"],
    light: Float[np.ndarray, "6"],
    reach_px: float,
    stride: int,
) -> tuple[Float[np.ndarray, "12 12"], Float[np.ndarray, "12"], float, int]:
    """Return the normal equations JᵀJ and Jᵀ(observed - model), the residuals' sum of squares, and how many pixels.

    Parameters
    ----------
    shape
        Centre u, v (px), M's elements uu, uv, vv (1/px²), blur s (px).
    light
        b₀, b₁, b₂, c₀, c₁, c₂, grey levels.
    stride
        Only every so manyth row and column is looked at.
    """
    N = np.zeros((12, 12))
    g = np.zeros(12)
    J = np.empty((13, _TOGETHER))
    squares = 0.0
    count, held = 0, 0
    height, width = image.shape
    u0, v0, a, b, c, s = shape[0], shape[1], shape[2], shape[3], shape[4], shape[5]
    determinant = a * c - b * b
    unit = determinant**0.25  # 1/px
    # F changes by no more than this within reach: pixels nearer to the centre need no look
    steepest = math.sqrt(0.5 * (a + c) + math.sqrt(0.25 * (a - c) ** 2 + b * b))
    inner, outer = max(1.0 - reach_px * steepest, 0.05), 1.0 + reach_px * steepest
    half_v = min(math.sqrt(a / determinant) * outer, math.sqrt(a / determinant) + reach_px)
    for v in range(max(0, math.ceil(v0 - half_v)), min(height - 1, math.floor(v0 + half_v)) + 1, stride):
        y = v - v0
        # a x² + 2 b x y + c y² = F²
        middle, rest = -b * y / a, determinant * y * y / (a * a)
        half = math.sqrt(max(outer * outer / a - rest, 0.0))
        hole = math.sqrt(max(inner * inner / a - rest, 0.0))
        first = max(0, math.ceil(u0 + middle - half))
        last = min(width - 1, math.floor(u0 + middle + half))
        skip_from, skip_to = u0 + middle - hole, u0 + middle + hole
        u = first - stride
        while u + stride <= last:
            u += stride
            if skip_from < u < skip_to:
                u += max(math.floor((skip_to - u) / stride), 0) * stride
                continue
            x = u - u0
            mx, my = a * x + b * y, b * x + c * y
            F = math.sqrt(x * mx + y * my)
            steep = math.sqrt(mx * mx + my * my)
            if F < 0.05 or steep <= 0.0:
                continue
            t = (1.0 - F) * F / steep
            if abs(t) > reach_px:
                continue
            z = t / s
            P, p = normal(z)
            xn, yn = x * unit, y * unit
            contrast = light[3] + light[4] * xn + light[5] * yn
            model = light[0] + light[1] * xn + light[2] * yn + contrast * P
            # a's derivatives, at the edge (F = 1): da = -dF F / |M d| = -(½ dᵀ dM d + (M d)·dd) / |M d|
            slope = contrast * p / s
            per = slope / steep
            J[0, held] = per * mx
            J[1, held] = per * my
            J[2, held] = -0.5 * per * x * x
            J[3, held] = -per * x * y
            J[4, held] = -0.5 * per * y * y
            J[5, held] = -slope * z
            J[6, held] = 1.0
            J[7, held] = xn
            J[8, held] = yn
            J[9, held] = P
            J[10, held] = xn * P
            J[11, held] = yn * P
            J[12, held] = float(image[v, u]) - model
            held += 1
            if held == _TOGETHER:
                squares += _add_up(J, held, N, g)
                count += held
                held = 0
    squares += _add_up(J, held, N, g)
    count += held
    for i in range(12):
        for j in range(i):
            N[j, i] = N[i, j]
    return N, g, squares, count


@compiled
def _solve(N: Float[np.ndarray, "k k"], g: Float[np.ndarray, "k n"]) -> bool:
    """Replace g by N⁻¹ g by Cholesky's factors, which replace N's lower triangle; false where N is not positive."""
    size = len(N)
    for i in range(size):
        for j in range(i + 1):
            total = N[i, j]
            for k in range(j):
                total -= N[i, k] * N[j, k]
            if i > j:
                N[i, j] = total / N[j, j]
            elif total > 0.0:
                N[i, i] = math.sqrt(total)
            else:
                return False
    for n in range(g.shape[1]):
        for i in range(size):
            for k in range(i):
                g[i, n] -= N[i, k] * g[k, n]
            g[i, n] /= N[i, i]
        for i in range(size - 1, -1, -1):
            for k in range(i + 1, size):
                g[i, n] -= N[k, i] * g[k, n]
            g[i, n] /= N[i, i]
    return True


@compiled
def _light_of(
    image: Shaped[np.ndarray, "h w"], shape: Float[np.ndarray, "6"], reach_px: float, stride: int
) -> tuple[Float[np.ndarray, "6"], bool]:
    """Return the light that suits a shape best: it enters linearly."""
    light = np.zeros(6)
    N, g, _, count = dot_equations(image, shape, light, reach_px, stride)
    if count < 30:
        return light, False
    L, d = N[6:, 6:].copy(), g[6:].copy().reshape(6, 1)
    for i in range(6):
        L[i, i] += 1e-9 * (1.0 + L[i, i])
    done = _solve(L, d)
    return d[:, 0].copy(), done


@compiled
def fit_dot(
    image: Shaped[np.ndarray, "h w"],
    start: Float[np.ndarray, "6"],
    least_blur: float,
    most_steps: int,
    tolerance: float,
    shape_doubt: float,
    blur_doubt: float,
) -> tuple[Float[np.ndarray, "6"], Float[np.ndarray, "6"], Float[np.ndarray, "2 2"], float, bool]:
    """Fit one dot by Gauss-Newton steps, until the next one would be shorter than `tolerance` standard uncertainties of
    the centre. The first ones use a part of a large dot's pixels.

    Small dots have few pixels to tell twelve parameters: M is held near `start`'s by `shape_doubt` (of its size), the
    blur by `blur_doubt` (of itself), the contrast's slopes near none, each a standard deviation of a normal prior
    beside residuals of the variance found. On large dots all that weighs next to nothing.

    Returns
    -------
    shape, light
        As `dot_equations` takes them.
    covariance
        Of the centre (px²) for residuals of variance one.
    variance
        Of the residuals.
    converged
        False where a step left the picture, the dot, or did not settle.
    """
    shape = start.copy()
    covariance = np.zeros((2, 2))
    variance = 0.0
    size = math.sqrt(start[2] * start[4] - start[3] * start[3])
    radius = size**-0.5
    reach = max(3.5 * shape[5] + 1.0, 3.0)
    pixels = 4.0 * math.pi * radius * min(reach, radius)
    stride = min(max(int(math.sqrt(pixels / _SPARSE_PIXELS)), 1), _SPARSEST)
    light, lit = _light_of(image, shape, reach, stride)
    if not lit:
        return shape, light, covariance, variance, False
    scale = np.zeros(12)
    d = np.zeros((12, 3))
    for step in range(most_steps):
        if step <= _REACH_SETTLES:  # then it stays: steps that change the pixels they rest on need not end
            reach = max(3.5 * shape[5] + 1.0, 3.0)
        N, g, squares, count = dot_equations(image, shape, light, reach, stride)
        if count < 30:
            return shape, light, covariance, variance, False
        noise = squares / max(count - 12, 1) + 1.0 / 12.0
        for i in range(2, 5):
            weight = noise / (shape_doubt * size) ** 2
            N[i, i] += weight
            g[i] += weight * (start[i] - shape[i])
        weight = noise / (blur_doubt * start[5]) ** 2
        N[5, 5] += weight
        g[5] += weight * (start[5] - shape[5])
        for i in range(10, 12):
            weight = noise / (_SLOPE_DOUBT * light[3]) ** 2
            N[i, i] += weight
            g[i] -= weight * light[i - 6]
        for i in range(12):
            if not N[i, i] > 0.0:
                return shape, light, covariance, variance, False
            scale[i] = 1.0 / math.sqrt(N[i, i])
        for i in range(12):
            for j in range(12):
                N[i, j] *= scale[i] * scale[j]
            N[i, i] += 1e-10
            d[i, 0], d[i, 1], d[i, 2] = g[i] * scale[i], 0.0, 0.0
        d[0, 1] = d[1, 2] = 1.0
        if not _solve(N, d):
            return shape, light, covariance, variance, False
        told = 0.0  # of the squares, by the step
        for i in range(12):
            d[i, 0] *= scale[i]
            told += d[i, 0] * g[i]
        length = math.sqrt(d[0, 0] * d[0, 0] + d[1, 0] * d[1, 0])
        if not length < 0.5 * radius:
            return shape, light, covariance, variance, False
        wider = max(-0.5 * shape[5], min(d[5, 0], shape[5]))
        for i in range(5):
            shape[i] += d[i, 0]
        shape[5] = max(least_blur, min(shape[5] + wider, 0.6 * radius))
        light += d[6:, 0]
        determinant = shape[2] * shape[4] - shape[3] * shape[3]
        if not (determinant > 0.0 and shape[2] > 0.0):
            return shape, light, covariance, variance, False
        for i in range(2):
            for j in range(2):
                covariance[i, j] = d[i, 1 + j] * scale[i] * scale[j]
        variance = max(squares - told, 0.0) / max(count - 12, 1)
        doubt = math.sqrt(0.5 * (covariance[0, 0] + covariance[1, 1]) * (variance + 0.1))
        # a step leaves about its square, in units of the blur
        left = length * length / shape[5]
        if stride > 1:
            if (left < doubt and told < _MUCH_TOLD * squares) or step + 1 >= _MOST_SPARSE_STEPS:
                stride = 1
        elif left < tolerance * doubt and told < _LITTLE_TOLD * squares:
            return shape, light, covariance, variance, True
    return shape, light, covariance, variance, False


@compiled
def fit_each(
    image: Shaped[np.ndarray, "h w"],
    starts: Float[np.ndarray, "n 6"],
    least_blur: float,
    most_steps: int,
    tolerance: float,
    shape_doubt: float,
    blur_doubt: float,
    shapes: Float[np.ndarray, "n 6"],
    contrast: Float[np.ndarray, " n"],
    covariance: Float[np.ndarray, "n 2 2"],
    variance: Float[np.ndarray, " n"],
    converged: Bool[np.ndarray, " n"],
) -> None:
    """Fit many dots as `fit_dot` does one, and write what comes of it; c₀ as `contrast`."""
    for n in range(len(starts)):
        shape, light, of_centre, variance[n], converged[n] = fit_dot(
            image, starts[n], least_blur, most_steps, tolerance, shape_doubt, blur_doubt
        )
        shapes[n], contrast[n], covariance[n] = shape, light[3], of_centre
