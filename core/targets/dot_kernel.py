"""Maximum likelihood for one dot: an ellipse with a blurred edge, on the picture's own pixels.

The model at a pixel d = (x, y) from the centre, in units of the dot's mean radius r:

    g = b₀ + b₁ x + b₂ y + (c₀ + c₁ x + c₂ y) Φ(a / s),   a = (1 - F) F / |M d|,   F² = dᵀ M d

with a the distance to the edge, to first order in curvature, and s the blur. Parameters: centre (2), M's three
elements, s, and the six of the light. Pixels further than `reach` from the edge say nothing of the ellipse and are left
out. The model is symmetric about the centre, so that what it lacks (the curvature within the blur) moves the edge but
not the centre.

Pixels near the edge are collected first, then their derivatives are taken many at a time, one parameter after the
other, so that the processor's vectors do both these and the sums of their products.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Bool, Float, Shaped
from scipy.special import erfcx

from core.compiled import compiled

_SLOPE_DOUBT = 0.1  # of the contrast: how much it may change over the dot
_REACH_SETTLES = 3
_SPARSE_PIXELS = 100.0  # about so many pixels serve to come near, and tell twelve parameters
_SPARSEST = 3
_MOST_SPARSE_STEPS = 4
_MUCH_TOLD, _LITTLE_TOLD = 0.5, 0.25  # of the squares, by one step
_LEAST_PIXELS = 30
_TOGETHER = 256  # pixels
_VECTOR = 16  # pixels: a multiple of what a processor's vectors hold
_ROWS = 14  # of the products: twelve parameters, the residuals, and one that is empty
_RESIDUAL = 12
_ROOT_2_PI = math.sqrt(2.0 * math.pi)
_FURTHEST = 6.0  # standard deviations: beyond, no pixel's grey tells of the edge
_FOLD = 0.5  # t = 1 / (1 + _FOLD z)


def _tail() -> tuple[float, ...]:
    """Return the polynomial in t for (1 - Φ(z)) exp(z² / 2), 0 ≤ z ≤ `_FURTHEST`, lowest power first: within 2e-9."""
    low = 1.0 / (1.0 + _FOLD * _FURTHEST)
    t = 0.5 * (1.0 + low) + 0.5 * (1.0 - low) * np.cos(np.pi * (np.arange(400) + 0.5) / 400.0)
    z = (1.0 / t - 1.0) / _FOLD
    values = 0.5 * erfcx(z / math.sqrt(2.0))
    return tuple(float(c) for c in np.polynomial.Polynomial.fit(t, values, 8).convert().coef)


_T0, _T1, _T2, _T3, _T4, _T5, _T6, _T7, _T8 = _tail()


@compiled
def normal(z: float) -> tuple[float, float]:
    """Return the standard normal's distribution function and density, within 1e-8: without branches or tables, for the
    processor's vectors.

    exp(-z² / 2) is the 64th power of its series for a 64th of that; the tail is that times a polynomial in
    t = 1 / (1 + z / 2), the form of C. Hastings, "Approximations for Digital Computers", 1955.
    """
    x = min(abs(z), _FURTHEST)
    h = x * x * (-0.5 / 64.0)
    e = 1.0 + h * (
        1.0 + h * (0.5 + h * (1.0 / 6.0 + h * (1.0 / 24.0 + h * (1.0 / 120.0 + h * (1.0 / 720.0)))))
    )
    e *= e
    e *= e
    e *= e
    e *= e
    e *= e
    e *= e
    t = 1.0 / (1.0 + _FOLD * x)
    tail = _T8
    tail = _T7 + t * tail
    tail = _T6 + t * tail
    tail = _T5 + t * tail
    tail = _T4 + t * tail
    tail = _T3 + t * tail
    tail = _T2 + t * tail
    tail = _T1 + t * tail
    tail = e * (_T0 + t * tail)
    return (1.0 - tail if z >= 0.0 else tail), e * (1.0 / _ROOT_2_PI)


@compiled(reassociates=True)
def _derive(
    pixels: Float[np.ndarray, "3 together"],
    count: int,
    shape: Float[np.ndarray, "6"],
    light: Float[np.ndarray, "6"],
    J: Float[np.ndarray, "14 together"],
) -> None:
    """Write the model's derivatives at pixels (x, y and grey level) and the residuals into J's first 13 rows."""
    a, b, c, sharp = shape[2], shape[3], shape[4], 1.0 / shape[5]
    unit = (a * c - b * b) ** 0.25  # 1/px
    b0, b1, b2, c0, c1, c2 = light[0], light[1], light[2], light[3], light[4], light[5]
    for k in range(count):
        x, y = pixels[0, k], pixels[1, k]
        mx, my = a * x + b * y, b * x + c * y
        F = math.sqrt(x * mx + y * my)
        flat = 1.0 / math.sqrt(mx * mx + my * my)
        z = (1.0 - F) * F * flat * sharp
        P, p = normal(z)
        xn, yn = x * unit, y * unit
        contrast = c0 + c1 * xn + c2 * yn
        # a's derivatives, at the edge (F = 1): da = -dF F / |M d| = -(½ dᵀ dM d + (M d)·dd) / |M d|
        slope = contrast * p * sharp
        per = slope * flat
        J[0, k] = per * mx
        J[1, k] = per * my
        J[2, k] = -0.5 * per * x * x
        J[3, k] = -per * x * y
        J[4, k] = -0.5 * per * y * y
        J[5, k] = -slope * z
        J[6, k] = 1.0
        J[7, k] = xn
        J[8, k] = yn
        J[9, k] = P
        J[10, k] = xn * P
        J[11, k] = yn * P
        J[12, k] = pixels[2, k] - (b0 + b1 * xn + b2 * yn + contrast * P)


@compiled(reassociates=True)
def _add_up(J: Float[np.ndarray, "14 together"], count: int, N: Float[np.ndarray, "14 16"]) -> None:
    """Add the products of J's rows with each other to N's lower triangle, by blocks of two by two."""
    for i in range(0, _ROWS, 2):
        for j in range(0, i + 2, 2):
            ac, ad, bc, bd = 0.0, 0.0, 0.0, 0.0
            for k in range(count):
                a, b, c, d = J[i, k], J[i + 1, k], J[j, k], J[j + 1, k]
                ac += a * c
                ad += a * d
                bc += b * c
                bd += b * d
            N[i, j] += ac
            N[i, j + 1] += ad
            N[i + 1, j] += bc
            N[i + 1, j + 1] += bd


@compiled
def _take(
    pixels: Float[np.ndarray, "3 together"],
    count: int,
    shape: Float[np.ndarray, "6"],
    light: Float[np.ndarray, "6"],
    J: Float[np.ndarray, "14 together"],
    N: Float[np.ndarray, "14 16"],
) -> None:
    """Add some pixels to N; J is filled up with zeros to whole vectors."""
    _derive(pixels, count, shape, light, J)
    whole = -(-count // _VECTOR) * _VECTOR
    for i in range(_ROWS):
        for k in range(count, whole):
            J[i, k] = 0.0
    _add_up(J, whole, N)


@compiled
def _equations(
    image: Shaped[np.ndarray, "h w"],
    shape: Float[np.ndarray, "6"],
    light: Float[np.ndarray, "6"],
    reach_px: float,
    stride: int,
    N: Float[np.ndarray, "14 16"],
    J: Float[np.ndarray, "14 together"],
    pixels: Float[np.ndarray, "3 together"],
) -> int:
    """Write the normal equations into N as `dot_equations` returns them: JᵀJ's lower triangle, below it Jᵀ(observed -
    model) and the sum of squares. Return how many pixels. The last row of J must be 0."""
    for i in range(_ROWS):
        for j in range(N.shape[1]):
            N[i, j] = 0.0
    total, held = 0, 0
    height, width = image.shape
    u0, v0, a, b, c = shape[0], shape[1], shape[2], shape[3], shape[4]
    determinant = a * c - b * b
    # F changes by no more than this within reach: pixels nearer to the centre need no look
    steepest = math.sqrt(0.5 * (a + c) + math.sqrt(0.25 * (a - c) ** 2 + b * b))
    inner, outer = max(1.0 - reach_px * steepest, 0.05), 1.0 + reach_px * steepest
    half_v = min(math.sqrt(a / determinant) * outer, math.sqrt(a / determinant) + reach_px)
    reach_2 = reach_px * reach_px
    for v in range(max(0, math.ceil(v0 - half_v)), min(height - 1, math.floor(v0 + half_v)) + 1, stride):
        y = v - v0
        # a x² + 2 b x y + c y² = F²
        middle, rest = u0 - b * y / a, determinant * y * y / (a * a)
        half = math.sqrt(max(outer * outer / a - rest, 0.0))
        hole = math.sqrt(max(inner * inner / a - rest, 0.0))
        first = max(0, math.ceil(middle - half))
        last = min(width - 1, math.floor(middle + half))
        for side in range(2):
            begin, end = first, last
            if side == 0 and hole > 0.0:
                end = min(last, math.floor(middle - hole))
            elif side == 1:
                if hole == 0.0:
                    break
                begin += math.ceil(max(middle + hole - first, 0.0) / stride) * stride
            for u in range(begin, end + 1, stride):
                x = u - u0
                mx, my = a * x + b * y, b * x + c * y
                square = x * mx + y * my
                t = (1.0 - math.sqrt(square)) ** 2 * square
                pixels[0, held], pixels[1, held], pixels[2, held] = x, y, image[v, u]
                held += (t <= reach_2 * (mx * mx + my * my)) & (square >= 0.0025)
                if held == _TOGETHER:
                    _take(pixels, held, shape, light, J, N)
                    total, held = total + held, 0
    _take(pixels, held, shape, light, J, N)
    return total + held


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
    A, J, pixels = np.empty((_ROWS, 16)), np.zeros((_ROWS, _TOGETHER)), np.empty((3, _TOGETHER))
    count = _equations(image, shape, light, reach_px, stride, A, J, pixels)
    N = np.empty((12, 12))
    for i in range(12):
        for j in range(i + 1):
            N[i, j] = N[j, i] = A[i, j]
    return N, A[_RESIDUAL, :12].copy(), A[_RESIDUAL, _RESIDUAL], count


@compiled
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
    told = 0.0
    for p in range(11, first - 1, -1):
        pivot = N[p, p] * (1.0 + 1e-10)
        if not pivot > 0.0:
            return told, False
        if p == 1:
            corner, side, other = N[0, 0] * (1.0 + 1e-10), N[1, 0], pivot
            determinant = corner * other - side * side
            if not determinant > 0.0:
                return told, False
            covariance[0, 0], covariance[1, 1] = other / determinant, corner / determinant
            covariance[0, 1] = covariance[1, 0] = -side / determinant
        N[p, p] = 1.0 / pivot
        for k in range(12):
            row[k] = N[p, k] if k < p else 0.0
        for i in range(first, p):
            factor = row[i] * N[p, p]
            for k in range(12):
                N[i, k] -= factor * row[k]
        factor = N[_RESIDUAL, p] * N[p, p]
        told += factor * N[_RESIDUAL, p]
        for k in range(12):
            N[_RESIDUAL, k] -= factor * row[k]
    for p in range(first, 12):
        total = N[_RESIDUAL, p]
        for k in range(first, p):
            total -= N[p, k] * solution[k]
        solution[p] = total * N[p, p]
    return told, True


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
    shape, light, d = start.copy(), np.zeros(6), np.zeros(12)
    N, J, pixels = np.empty((_ROWS, 16)), np.zeros((_ROWS, _TOGETHER)), np.empty((3, _TOGETHER))
    covariance = np.zeros((2, 2))
    variance = 0.0
    size = math.sqrt(start[2] * start[4] - start[3] * start[3])
    radius = size**-0.5
    reach = max(3.5 * shape[5] + 1.0, 3.0)
    expected = 4.0 * math.pi * radius * min(reach, radius)
    stride = min(max(int(math.sqrt(expected / _SPARSE_PIXELS)), 1), _SPARSEST)
    # the light enters linearly: that which suits the start best
    if _equations(image, shape, light, reach, stride, N, J, pixels) < _LEAST_PIXELS:
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
        count = _equations(image, shape, light, reach, stride, N, J, pixels)
        if count < _LEAST_PIXELS:
            return shape, light, covariance, variance, False
        squares = N[_RESIDUAL, _RESIDUAL]
        noise = squares / max(count - 12, 1) + 1.0 / 12.0
        for i in range(2, 5):
            weight = noise / (shape_doubt * size) ** 2
            N[i, i] += weight
            N[_RESIDUAL, i] += weight * (start[i] - shape[i])
        weight = noise / (blur_doubt * start[5]) ** 2
        N[5, 5] += weight
        N[_RESIDUAL, 5] += weight * (start[5] - shape[5])
        for i in range(10, 12):
            weight = noise / (_SLOPE_DOUBT * light[3]) ** 2
            N[i, i] += weight
            N[_RESIDUAL, i] -= weight * light[i - 6]
        told, solved = solve_equations(N, 0, d, covariance)
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
