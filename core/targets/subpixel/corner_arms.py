"""The arms of a corner: pixels along one edge and far from the other, which polynomials describe many at a time."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from scipy.special import erf

from core.jit import jit
from core.targets.subpixel.corner_model import (
    N1_U,
    N1_V,
    N2_U,
    N2_V,
    PER_CONTRAST,
    SIGMA_1,
    SIGN,
    flat_top,
)

_MAX_BAND_SIGMAS = 2.3  # σ from an edge; a bent one's band is a little wider than BAND
_LACKING = math.erfc(_MAX_BAND_SIGMAS / math.sqrt(2.0))  # of P there
_BELL_THERE = math.exp(-0.5 * _MAX_BAND_SIGMAS**2) / math.sqrt(2.0 * math.pi)
_TAIL, _TAIL_OF_BELL = 3.06, 3.41  # beyond it both end as eighth powers do, over so many σ: to 7e-5


def _series(function: Callable[[Float[np.ndarray, " n"]], Float[np.ndarray, " n"]]) -> tuple[float, ...]:
    """Return the polynomial in x² of degree 8 nearest to an even function of |x| ≤ `_MAX_BAND_SIGMAS`."""
    t = np.linspace(1e-9, 1.0, 1001) * _MAX_BAND_SIGMAS**2
    fit = np.polynomial.Chebyshev.fit(t, function(np.sqrt(t)), 8, domain=[0.0, _MAX_BAND_SIGMAS**2])
    return tuple(fit.convert(kind=np.polynomial.Polynomial).coef.tolist())


# on the arms, polynomials: vectors of pixels at once need no table
_P_SERIES = _series(lambda x: erf(x / math.sqrt(2.0)) / x)
_BELL_SERIES = _series(lambda x: np.exp(-0.5 * x**2) / math.sqrt(2.0 * math.pi))


@jit("f8, f8, f8, f8, f8, f8", reassociates=True, inlined=True)
def _model_at(
    a: float, slope: float, top: float, side: float, sigma: float, per_contrast: float
) -> tuple[float, float, float, float]:
    """Return the factors of c d, c₀, c Δln σ and c spread at a pixel of an arm; that of b₀ is 1."""
    t = min(a * a, _MAX_BAND_SIGMAS**2)
    c = _P_SERIES
    value = c[0] + t * (
        c[1] + t * (c[2] + t * (c[3] + t * (c[4] + t * (c[5] + t * (c[6] + t * (c[7] + t * c[8]))))))
    )
    c = _BELL_SERIES
    bell = c[0] + t * (
        c[1] + t * (c[2] + t * (c[3] + t * (c[4] + t * (c[5] + t * (c[6] + t * (c[7] + t * c[8]))))))
    )
    if a * a > _MAX_BAND_SIGMAS**2:  # of sharp edges alone, whose band is wider
        size = abs(a)
        q = max(1.0 - (size - _MAX_BAND_SIGMAS) / _TAIL, 0.0) ** 2
        value = (1.0 - _LACKING * q * q * q * q) / size
        q = max(1.0 - (size - _MAX_BAND_SIGMAS) / _TAIL_OF_BELL, 0.0) ** 2
        bell = _BELL_THERE * q * q * q * q
    T = side * a * (value - 2.0 * top * bell * (t - 3.0))
    strong = 1.0 + slope * per_contrast
    bump = side * strong * 2.0 * bell * (1.0 + top * (t * (t - 6.0) + 3.0))
    return -bump / sigma, T, -a * bump, strong * (1.0 - T * T)


@jit("f8[::1], i8")
def _edge_of(s: Float[np.ndarray, " state"], arm: int) -> tuple[int, float, float, float]:
    """Return which edge an arm lies on, the pixel's shape in its profile, the side of the crossing, and its blur."""
    edge = arm // 2
    sigma, side = s[SIGMA_1 + edge], s[SIGN] if arm % 2 else -s[SIGN]
    top = flat_top(s[N1_U], s[N1_V], sigma) if edge == 0 else flat_top(s[N2_U], s[N2_V], sigma)
    return edge, top, side, sigma


@jit("f8[:, ::1], i8, f8[::1], i8, f8[:, ::1]", reassociates=True)
def sum_arm(
    pixels: Float[np.ndarray, "4 m"],
    count: int,
    state: Float[np.ndarray, " state"],
    arm: int,
    A: Float[np.ndarray, "8 8"],
) -> None:
    """Set A to the products of the columns, as X has them, over the pixels of an arm.

    Sums in registers, in whatever order suits the processor's vectors.
    """
    # In one piece for the compiler.
    distance, weights, slopes, greys = pixels[0], pixels[1], pixels[2], pixels[3]
    edge, top, side, sigma = _edge_of(state, arm)
    per_contrast = state[PER_CONTRAST]
    dd, d1, dt, dw, ds, dy, n, t1, w1, s1, y1 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    tt, tw, ts, ty, ww, ws, wy, ss, sy, yy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(count):
        d, t, w, s = _model_at(distance[k], slopes[k], top, side, sigma, per_contrast)
        y = greys[k] - t * slopes[k]
        weight = weights[k]
        dd += weight * d * d
        d1 += weight * d
        dt += weight * d * t
        dw += weight * d * w
        ds += weight * d * s
        dy += weight * d * y
        n += weight
        t1 += weight * t
        w1 += weight * w
        s1 += weight * s
        y1 += weight * y
        tt += weight * t * t
        tw += weight * t * w
        ts += weight * t * s
        ty += weight * t * y
        ww += weight * w * w
        ws += weight * w * s
        wy += weight * w * y
        ss += weight * s * s
        sy += weight * s * y
        yy += weight * y * y
    A[:] = 0.0
    i, j = edge, 4 + edge
    A[i, i], A[2, i], A[3, i], A[j, i], A[6, i], A[7, i] = dd, d1, dt, dw, ds, dy
    A[2, 2], A[3, 2], A[j, 2], A[6, 2], A[7, 2] = n, t1, w1, s1, y1
    A[3, 3], A[j, 3], A[6, 3], A[7, 3] = tt, tw, ts, ty
    A[j, j], A[6, j], A[7, j], A[6, 6], A[7, 6], A[7, 7] = ww, ws, wy, ss, sy, yy


@jit("f8[:, ::1], i8, f8[::1], i8, f8[::1], f8", reassociates=True)
def count_strays(
    pixels: Float[np.ndarray, "4 m"],
    count: int,
    state: Float[np.ndarray, " state"],
    arm: int,
    b: Float[np.ndarray, " 7"],
    limit: float,
) -> int:
    """Count an arm's pixels whose residual's square is beyond the limit."""
    # In one piece for the compiler.
    distance, weights, slopes, greys = pixels[0], pixels[1], pixels[2], pixels[3]
    edge, top, side, sigma = _edge_of(state, arm)
    per_contrast = state[PER_CONTRAST]
    by_d, by_1, by_t, by_w, by_s = b[edge], b[2], b[3], b[4 + edge], b[6]
    found = 0
    for k in range(count):
        d, t, w, s = _model_at(distance[k], slopes[k], top, side, sigma, per_contrast)
        r = greys[k] - t * slopes[k] - d * by_d - by_1 - t * by_t - w * by_w - s * by_s
        if weights[k] * r * r > limit:
            found += 1
    return found


@jit("f8[:, ::1], i8, f8[::1], i8, f8[::1], f8")
def drop_strays(
    pixels: Float[np.ndarray, "4 m"],
    count: int,
    state: Float[np.ndarray, " state"],
    arm: int,
    b: Float[np.ndarray, " 7"],
    limit: float,
) -> None:
    """Take the weight from an arm's pixels whose residual's square is beyond the limit."""
    edge, top, side, sigma = _edge_of(state, arm)
    per_contrast = state[PER_CONTRAST]
    for k in range(count):
        slope = pixels[2, k]
        d, t, w, s = _model_at(pixels[0, k], slope, top, side, sigma, per_contrast)
        r = pixels[3, k] - t * slope - d * b[edge] - b[2] - t * b[3] - w * b[4 + edge] - s * b[6]
        if pixels[1, k] * r * r > limit:
            pixels[1, k] = 0.0
