"""Maximum likelihood for one dot: an ellipse with a blurred edge, on the picture's own pixels.

The model at a pixel d = (x, y) from the centre, in units of the dot's mean radius r:

    g = b₀ + b₁ x + b₂ y + (c₀ + c₁ x + c₂ y) Φ(a / s),   a = (1 - F) F / |M d|,   F² = dᵀ M d

with a the distance to the edge, to first order in curvature, and s the blur. Parameters: centre (2), M's three
elements, s, and the six of the light. Pixels further than `reach` from the edge say nothing of the ellipse and are left
out. The model is symmetric about the centre, so that what it lacks (the curvature within the blur) moves the edge but
not the centre.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float, Shaped

from core.compiled import compiled

_SLOPE_DOUBT = 0.1  # of the contrast: how much it may change over the dot
_REACH_SETTLES = 3
_SPARSE_FROM_PX = 8.0  # of the radius: larger dots begin with a quarter of their pixels
_ROOT_2_PI = math.sqrt(2.0 * math.pi)


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
    J = np.zeros(12)
    squares = 0.0
    count = 0
    height, width = image.shape
    u0, v0, a, b, c, s = shape[0], shape[1], shape[2], shape[3], shape[4], shape[5]
    determinant = a * c - b * b
    half_u = math.sqrt(c / determinant) + reach_px
    half_v = math.sqrt(a / determinant) + reach_px
    unit = determinant**0.25  # 1/px
    for v in range(max(0, math.ceil(v0 - half_v)), min(height - 1, math.floor(v0 + half_v)) + 1, stride):
        for u in range(max(0, math.ceil(u0 - half_u)), min(width - 1, math.floor(u0 + half_u)) + 1, stride):
            x, y = u - u0, v - v0
            mx, my = a * x + b * y, b * x + c * y
            F = math.sqrt(x * mx + y * my)
            steep = math.sqrt(mx * mx + my * my)
            if F < 0.05 or steep <= 0.0:
                continue
            t = (1.0 - F) * F / steep
            if abs(t) > reach_px:
                continue
            z = t / s
            P = 0.5 * math.erfc(-z * 0.7071067811865476)
            p = math.exp(-0.5 * z * z) / _ROOT_2_PI
            xn, yn = x * unit, y * unit
            contrast = light[3] + light[4] * xn + light[5] * yn
            model = light[0] + light[1] * xn + light[2] * yn + contrast * P
            # a's derivatives, at the edge (F = 1): da = -dF F / |M d| = -(½ dᵀ dM d + (M d)·dd) / |M d|
            slope = contrast * p / s
            J[0] = slope * mx / steep
            J[1] = slope * my / steep
            J[2] = -slope * 0.5 * x * x / steep
            J[3] = -slope * x * y / steep
            J[4] = -slope * 0.5 * y * y / steep
            J[5] = -slope * z
            J[6] = 1.0
            J[7] = xn
            J[8] = yn
            J[9] = P
            J[10] = xn * P
            J[11] = yn * P
            r = float(image[v, u]) - model
            squares += r * r
            count += 1
            for i in range(12):
                w = J[i]
                g[i] += w * r
                for j in range(i + 1):
                    N[i, j] += w * J[j]
    for i in range(12):
        for j in range(i):
            N[j, i] = N[i, j]
    return N, g, squares, count


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
    """Fit one dot by Gauss-Newton steps, until one is shorter than `tolerance` standard uncertainties of the centre.

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
    light = np.zeros(6)
    covariance = np.zeros((2, 2))
    variance = 0.0
    radius = (shape[2] * shape[4] - shape[3] * shape[3]) ** -0.25
    reach = 0.0
    size = math.sqrt(start[2] * start[4] - start[3] * start[3])
    for step in range(most_steps):
        if step <= _REACH_SETTLES:  # then it stays: steps that change the pixels they rest on need not end
            reach = max(3.5 * shape[5] + 1.0, 3.0)
        stride = 2 if step < 2 and radius > _SPARSE_FROM_PX else 1
        N, g, squares, count = dot_equations(image, shape, light, reach, stride)
        if count < 30:
            return shape, light, covariance, variance, False
        if step == 0:  # the light first: it enters linearly
            L = N[6:, 6:].copy()
            for i in range(6):
                L[i, i] += 1e-9 * (1.0 + L[i, i])
            light += np.linalg.solve(L, g[6:])
            N, g, squares, count = dot_equations(image, shape, light, reach, stride)
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
        scale = np.zeros(12)
        for i in range(12):
            if not N[i, i] > 0.0:
                return shape, light, covariance, variance, False
            scale[i] = 1.0 / math.sqrt(N[i, i])
        for i in range(12):
            for j in range(12):
                N[i, j] *= scale[i] * scale[j]
            N[i, i] += 1e-10
        inverse = np.linalg.inv(N)
        d = np.zeros(12)
        for i in range(12):
            for j in range(12):
                d[i] += inverse[i, j] * g[j] * scale[j]
            d[i] *= scale[i]
        length = math.sqrt(d[0] * d[0] + d[1] * d[1])
        if not length < 0.5 * radius:
            return shape, light, covariance, variance, False
        for i in range(5):
            shape[i] += d[i]
        shape[5] = max(least_blur, min(shape[5] + max(-0.5 * shape[5], min(d[5], shape[5])), 0.6 * radius))
        light += d[6:]
        determinant = shape[2] * shape[4] - shape[3] * shape[3]
        if not (determinant > 0.0 and shape[2] > 0.0):
            return shape, light, covariance, variance, False
        for i in range(2):
            for j in range(2):
                covariance[i, j] = inverse[i, j] * scale[i] * scale[j]
        variance = squares / max(count - 12, 1)
        doubt = math.sqrt(0.5 * (covariance[0, 0] + covariance[1, 1]) * (variance + 0.1))
        if length < tolerance * doubt and stride == 1:
            return shape, light, covariance, variance, True
    return shape, light, covariance, variance, False
