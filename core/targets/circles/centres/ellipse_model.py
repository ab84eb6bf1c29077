"""The model of one dot in the image's own pixels, an ellipse with a blurred edge, and its normal equations.

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
from jaxtyping import Float, Shaped
from scipy.special import erfcx

from core.jit import jit

TOGETHER = 256  # pixels
_VECTOR = 16  # pixels: a multiple of what a processor's vectors hold
ROWS = 14  # of the products: twelve parameters, the residuals, and one that is empty
RESIDUAL = 12
_ROOT_2_PI = math.sqrt(2.0 * math.pi)
_MAX_EDGE_SIGMAS = 6.0  # standard deviations: beyond, no pixel's grey depends on the edge
_FOLD = 0.5  # t = 1 / (1 + _FOLD z)


def _tail() -> tuple[float, ...]:
    """Return the polynomial in t for (1 - Φ(z)) exp(z² / 2), 0 ≤ z ≤ `_MAX_EDGE_SIGMAS`, lowest power first.

    It is within 2e-9.
    """
    low = 1.0 / (1.0 + _FOLD * _MAX_EDGE_SIGMAS)
    t = 0.5 * (1.0 + low) + 0.5 * (1.0 - low) * np.cos(np.pi * (np.arange(400) + 0.5) / 400.0)
    z = (1.0 / t - 1.0) / _FOLD
    values = 0.5 * erfcx(z / math.sqrt(2.0))
    return tuple(float(c) for c in np.polynomial.Polynomial.fit(t, values, 8).convert().coef)


_T0, _T1, _T2, _T3, _T4, _T5, _T6, _T7, _T8 = _tail()


@jit("f8")
def normal(z: float) -> tuple[float, float]:
    """Return the standard normal's distribution function and density, within 1e-8: without branches or tables, for the
    processor's vectors.

    exp(-z² / 2) is the 64th power of its series for a 64th of that; the tail is that times a polynomial in
    t = 1 / (1 + z / 2), the form of C. Hastings, "Approximations for Digital Computers", 1955.
    """
    x = min(abs(z), _MAX_EDGE_SIGMAS)
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


@jit("f8[:, ::1], i8, f8[::1], f8[::1], f8[:, ::1]", reassociates=True)
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


@jit("f8[:, ::1], i8, f8[:, ::1]", reassociates=True)
def _add_up(J: Float[np.ndarray, "14 together"], count: int, N: Float[np.ndarray, "14 16"]) -> None:
    """Add the products of J's rows with each other to N's lower triangle, by blocks of two by two."""
    for i in range(0, ROWS, 2):
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


@jit("f8[:, ::1], i8, f8[::1], f8[::1], f8[:, ::1], f8[:, ::1]")
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
    for i in range(ROWS):
        for k in range(count, whole):
            J[i, k] = 0.0
    _add_up(J, whole, N)


@jit(
    "u1[:, ::1], f8[::1], f8[::1], f8, i8, f8[:, ::1], f8[:, ::1], f8[:, ::1]",
    "u2[:, ::1], f8[::1], f8[::1], f8, i8, f8[:, ::1], f8[:, ::1], f8[:, ::1]",
)
def write_equations(
    image: Shaped[np.ndarray, "h w"],
    shape: Float[np.ndarray, "6"],
    light: Float[np.ndarray, "6"],
    reach_px: float,
    stride: int,
    N: Float[np.ndarray, "14 16"],
    J: Float[np.ndarray, "14 together"],
    pixels: Float[np.ndarray, "3 together"],
) -> int:
    """Write the normal equations into N: JᵀJ's lower triangle, below it Jᵀ(observed - model) and the sum of squares.
    Return how many pixels. The last row of J must be 0.

    Parameters
    ----------
    shape
        Centre u, v (px), M's elements uu, uv, vv (1/px²), blur s (px).
    light
        b₀, b₁, b₂, c₀, c₁, c₂, grey levels.
    stride
        Only every so manyth row and column is looked at.
    """
    for i in range(ROWS):
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
                if held == TOGETHER:
                    _take(pixels, held, shape, light, J, N)
                    total, held = total + held, 0
    _take(pixels, held, shape, light, J, N)
    return total + held
