"""The compiled part of corner refinement: one Gauss-Newton step per corner, on the picture's own pixels.

Two edge lines cross at the corner q. With a₁, a₂ a pixel's signed distances from them (they may bend: a = n·d -
½ κ s², d from q, s along the line), x = a/σ and P = 2Φ - 1, a blurred chessboard is

    grey = b(d) + c(d) T,    T = ± E[sgn(x₁ + ε₁) sgn(x₂ + ε₂)] = ± (P(x₁) P(x₂) + excess),

with b, c linear in d, and ε normal of correlation ρ = n₁·n₂, whose excess over the product is near the crossing only
(Mehler's series). σ² is the blur's variance plus the pixel's own 1/12; that a pixel is a square and no Gaussian is
left is the fourth cumulant κ₄ = -(n_u⁴ + n_v⁴)/120 (Gram-Charlier). Where σ is not small against the squares, the
lines of the neighbouring corners are seen too: P(x) - P(x - D/σ) - P(x + D/σ).

Moving the corner by d₁ along n₁ adds c d₁ D₁, D₁ = -∂T/∂a₁. So every step is a linear least-squares problem: no pixel
is interpolated, and white noise in the picture is white noise in it. T is symmetric about q and D is antisymmetric;
samples are taken (almost) symmetrically about q, so whatever is symmetric in the picture and not in the model (ink that
spreads, a camera's gamma, a blur of another shape) moves no corner.

Only pixels near an edge, within `BAND` σ, tell where it is. They do not tell the slopes of b and c, which look much
like a shift of the edge: these are given.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int
from scipy.special import erf

from core.compiled import compiled

BAND = 2.0
"""Half width of the band of pixels along an edge, in σ: D² ∝ exp(-x²) beyond it is 4e-4 of the whole."""
LEAST_BAND_PX = 2.0
"""And in px at least this less two thirds of `BAND` σ, which is more where σ < .6: the one or two pixels across a
sharper edge do not tell its blur from its contrast. Still wider, the band has what cameras do to sharpen edges."""
NEAR = 3.0
"""Within so many σ of the other edge its P is not yet ±1."""

STRAY, LEAST_STRAY = 5.0, 0.1
"""Pixels are left out whose residual is so many times the root mean square, and this share of half the contrast."""
_MOST_WIDER = 0.7  # the logarithm of the blur, in one step
_MOST_ROUNDS, _LEAST_LEFT = 4, 0.9

# columns of a corner's state
Q_U, Q_V, N1_U, N1_V, BEND_1, REACH_1, N2_U, N2_V, BEND_2, REACH_2, SIGN = range(11)
SIGMA_1, SIGMA_2, SPACING_1, SPACING_2, LEVEL_U, LEVEL_V, CONTRAST_U, CONTRAST_V, PER_CONTRAST = range(11, 20)
STATE = 20

# columns of a step
STEP_U, STEP_V, LEVEL, CONTRAST, WIDER_1, WIDER_2, SPREAD = range(7)
SQUARES, SAMPLES, COV_UU, COV_UV, COV_VV, UNEVEN, UNEVEN_VARIANCE = range(7, 14)
WEAKEST_ARM, WEAKEST_ARM_DOUBT = 14, 15
STEP = 16

_PER_UNIT = 32
_AT = np.arange(0.0, 6.5, 1.0 / _PER_UNIT)
_P = erf(_AT / math.sqrt(2.0))
_BELL = np.exp(-0.5 * _AT**2) / math.sqrt(2.0 * math.pi)
_P.flags.writeable = _BELL.flags.writeable = False

_WIDEST = 2.3  # σ from an edge; a bent one's band is a little wider than BAND
_LACKING = math.erfc(_WIDEST / math.sqrt(2.0))  # of P there
_BELL_THERE = math.exp(-0.5 * _WIDEST**2) / math.sqrt(2.0 * math.pi)
_TAIL, _TAIL_OF_BELL = 3.06, 3.41  # beyond it both end as eighth powers do, over so many σ: to 7e-5


def _series(function: Callable[[Float[np.ndarray, " n"]], Float[np.ndarray, " n"]]) -> tuple[float, ...]:
    """Return the polynomial in x² of degree 8 nearest to an even function of |x| ≤ `_WIDEST`."""
    t = np.linspace(1e-9, 1.0, 1001) * _WIDEST**2
    fit = np.polynomial.Chebyshev.fit(t, function(np.sqrt(t)), 8, domain=[0.0, _WIDEST**2])
    return tuple(fit.convert(kind=np.polynomial.Polynomial).coef.tolist())


# on the arms, polynomials: vectors of pixels at once need no table
_P_SERIES = _series(lambda x: erf(x / math.sqrt(2.0)) / x)
_BELL_SERIES = _series(lambda x: np.exp(-0.5 * x**2) / math.sqrt(2.0 * math.pi))


@compiled
def _step(x: float) -> tuple[float, float]:
    """Return P(x) = 2Φ(x) - 1 and the normal density, from a table's nearest place by Taylor's series."""
    size = abs(x)
    if not size < 6.0:
        return math.copysign(1.0, x), 0.0
    k = int(size * _PER_UNIT + 0.5)
    at = k / _PER_UNIT
    d = size - at
    bell = _BELL[k]
    value = _P[k] + 2.0 * bell * d * (1.0 - 0.5 * d * at)
    return math.copysign(value, x), bell * (1.0 - d * (at - 0.5 * d * (at * at - 1.0)))


@compiled
def _profile(x: float, flat_top: float, spacing: float) -> tuple[float, float, float]:
    """Return P with the pixel's shape and the neighbouring lines, half its derivative, and its own density."""
    value, bell = _step(x)
    xx = x * x
    value -= 2.0 * flat_top * bell * x * (xx - 3.0)
    half = bell * (1.0 + flat_top * (xx * (xx - 6.0) + 3.0))
    if abs(x) + NEAR > spacing:
        before, bell_before = _step(x + spacing)
        after, bell_after = _step(x - spacing)
        value -= before + after
        half -= bell_before + bell_after
    return value, half, bell


@compiled
def _half_band(sigma: float) -> float:
    """Return half the width (px) of the band of pixels along an edge."""
    return max(BAND * sigma, LEAST_BAND_PX - BAND * sigma / 1.5)


@compiled
def _flat_top(n_u: float, n_v: float, sigma: float) -> float:
    """Return κ₄ / (24 σ⁴) of the pixel's square in an edge's profile."""
    return -(n_u**4 + n_v**4) / (120.0 * 24.0 * sigma**4)


@compiled
def _band(
    flat: np.ndarray,
    height: int,
    width: int,
    s: Float[np.ndarray, " state"],
    first: bool,
    stride: int,
    pixels: Float[np.ndarray, "4 4 m"],
    X: Float[np.ndarray, "n 8"],
    counts: Int[np.ndarray, "5"],
) -> None:
    """Collect the pixels along one edge, and count them.

    Those of its arms go to `pixels[arm]`: distance from the edge in σ, weight, slope of the contrast, and the grey less
    the level's slope. To those near the other edge too, the model is rows of X: the factors of the unknowns (c d₁,
    c d₂, b₀, c₀, c Δln σ₁, c Δln σ₂, c spread) and the grey, all times the root of the pixel's weight.
    """
    if first:
        nu, nv, bend, reach, sigma, gap = s[N1_U], s[N1_V], s[BEND_1], s[REACH_1], s[SIGMA_1], s[SPACING_1]
        mu, mv, bend_m, sigma_m, gap_m = s[N2_U], s[N2_V], s[BEND_2], s[SIGMA_2], s[SPACING_2]
        own, other, arm = 0, 1, 0
    else:
        nu, nv, bend, reach, sigma, gap = s[N2_U], s[N2_V], s[BEND_2], s[REACH_2], s[SIGMA_2], s[SPACING_2]
        mu, mv, bend_m, sigma_m, gap_m = s[N1_U], s[N1_V], s[BEND_1], s[SIGMA_1], s[SPACING_1]
        own, other, arm = 1, 0, 2
    sign, per_contrast = s[SIGN], s[PER_CONTRAST]
    gap, gap_m = gap / sigma, gap_m / sigma_m
    band, band_m = _half_band(sigma) / sigma, _half_band(sigma_m) / sigma_m
    clear = max(NEAR, band_m)
    top, top_m = _flat_top(nu, nv, sigma), _flat_top(mu, mv, sigma_m)
    rho = nu * mu + nv * mv
    rest = 1.0 / math.sqrt(max(1.0 - rho * rho, 1e-4))
    # The edge is followed along the pixels' rows or columns, whichever it crosses more steeply.
    if abs(nu) >= abs(nv):
        q_along, q_across, n_along, n_across, m_along, m_across = s[Q_V], s[Q_U], nv, nu, mv, mu
        size_along, size_across, to_next_line, to_next = height, width, width, 1
        level_along, level_across = s[LEVEL_V], s[LEVEL_U]
        contrast_along, contrast_across = s[CONTRAST_V], s[CONTRAST_U]
    else:
        q_along, q_across, n_along, n_across, m_along, m_across = s[Q_U], s[Q_V], nu, nv, mu, mv
        size_along, size_across, to_next_line, to_next = width, height, 1, width
        level_along, level_across = s[LEVEL_U], s[LEVEL_V]
        contrast_along, contrast_across = s[CONTRAST_U], s[CONTRAST_V]
    extent = reach * abs(n_across)
    half = _half_band(sigma) / abs(n_across)
    per_across, per_sigma, per_sigma_m = 1.0 / n_across, 1.0 / sigma, 1.0 / sigma_m
    begin = max(0, math.ceil(q_along - extent - 0.5))
    end = min(size_along - 1, math.floor(q_along + extent + 0.5))
    for line in range(begin, end + 1, stride):
        along = line - q_along
        weight = min(extent + 0.5 - abs(along), 1.0)
        if weight <= 0.0:
            continue
        # where the edge is on this line, and s there; a and o are linear in the pixel so near it
        place = along * per_across
        middle = (0.5 * bend * place * place - n_along * along) * per_across
        low = max(0, math.ceil(q_across + middle - half))
        high = min(size_across - 1, math.floor(q_across + middle + half))
        count = high - low + 1
        if count <= 0:
            continue
        da = (n_across + bend * place * n_along) * per_sigma
        place_m = m_across * along - m_along * middle
        o_middle = (m_across * middle + m_along * along - 0.5 * bend_m * place_m * place_m) * per_sigma_m
        do = (m_across + bend_m * place_m * m_along) * per_sigma_m
        across = low - q_across
        a = (across - middle) * da
        o = o_middle + (across - middle) * do
        level = level_along * along + level_across * across
        slope = contrast_along * along + contrast_across * across
        at = line * to_next_line + low * to_next
        span = half * abs(do)
        is_arm = abs(o_middle) - span >= clear and abs(o_middle) + span + NEAR <= gap_m and gap >= band + NEAR
        if is_arm:
            at_arm = arm + 1 if o_middle > 0.0 else arm
            place_a, place_w, place_s, place_g = pixels[at_arm]
            k = counts[at_arm]
            count = min(count, pixels.shape[2] - k)
            for i in range(count):
                place_a[k + i] = a + i * da
                place_w[k + i] = weight
                place_s[k + i] = slope + i * contrast_across
                place_g[k + i] = flat[at + i * to_next] - (level + i * level_across)
            counts[at_arm] += count
            continue
        root = math.sqrt(weight)
        samples = counts[4]
        count = min(count, X.shape[0] - samples)
        for pixel in range(count):
            place_m = m_across * along - m_along * (across + pixel)
            # pixels in the other edge's band are in already
            if first or abs(o) > band_m or abs(place_m) > s[REACH_1]:
                value, h, bell = _profile(a, top, gap)
                value_m, h_m, bell_m = _profile(o, top_m, gap_m)
                P_given, _ = _step((o - rho * a) * rest)
                P_given_m, _ = _step((a - rho * o) * rest)
                if gap_m < 2.0 * NEAR:
                    P_given += value_m - _step(o)[0]
                if gap < 2.0 * NEAR:
                    P_given_m += value - _step(a)[0]
                aa, oo, ao = a * a, o * o, a * o
                excess = rho * rho * ao * (aa - 3.0) * (oo - 3.0) / 24.0 + rho * (aa - 1.0) * (oo - 1.0) / 6.0
                excess = rho * (1.0 + rho * (0.5 * ao + rho * excess))
                T = sign * (value * value_m + 4.0 * bell * bell_m * excess)
                strong = root * (1.0 + slope * per_contrast)
                bump = sign * strong * 2.0 * h * P_given
                bump_m = sign * strong * 2.0 * h_m * P_given_m
                row = X[samples]
                row[own], row[other], row[2], row[3] = (
                    -bump * per_sigma,
                    -bump_m * per_sigma_m,
                    root,
                    root * T,
                )
                row[4 + own], row[4 + other], row[6] = -a * bump, -o * bump_m, strong * (1.0 - T * T)
                row[7] = root * (flat[at] - level - T * slope)
                samples += 1
            at += to_next
            a += da
            o += do
            level += level_across
            slope += contrast_across
        counts[4] = samples


@compiled(reassociates=True)
def _on_arm(
    a: float, slope: float, top: float, side: float, sigma: float, per_contrast: float
) -> tuple[float, float, float, float]:
    """Return the factors of c d, c₀, c Δln σ and c spread at a pixel of an arm; that of b₀ is 1."""
    t = min(a * a, _WIDEST**2)
    c = _P_SERIES
    value = c[0] + t * (
        c[1] + t * (c[2] + t * (c[3] + t * (c[4] + t * (c[5] + t * (c[6] + t * (c[7] + t * c[8]))))))
    )
    c = _BELL_SERIES
    bell = c[0] + t * (
        c[1] + t * (c[2] + t * (c[3] + t * (c[4] + t * (c[5] + t * (c[6] + t * (c[7] + t * c[8]))))))
    )
    if a * a > _WIDEST**2:  # of sharp edges alone, whose band is wider
        size = abs(a)
        q = max(1.0 - (size - _WIDEST) / _TAIL, 0.0) ** 2
        value = (1.0 - _LACKING * q * q * q * q) / size
        q = max(1.0 - (size - _WIDEST) / _TAIL_OF_BELL, 0.0) ** 2
        bell = _BELL_THERE * q * q * q * q
    T = side * a * (value - 2.0 * top * bell * (t - 3.0))
    strong = 1.0 + slope * per_contrast
    bump = side * strong * 2.0 * bell * (1.0 + top * (t * (t - 6.0) + 3.0))
    return -bump / sigma, T, -a * bump, strong * (1.0 - T * T)


@compiled(reassociates=True)
def _add_arm(
    pixels: Float[np.ndarray, "4 m"],
    count: int,
    top: float,
    side: float,
    sigma: float,
    per_contrast: float,
    edge: int,
    A: Float[np.ndarray, "8 8"],
) -> None:
    """Set A to the products of the columns, as X has them, over the pixels of an arm.

    Sums in registers, in whatever order suits the processor's vectors.
    """
    distance, weights, slopes, greys = (
        pixels[0],
        pixels[1],
        pixels[2],
        pixels[3],
    )  # in one piece for the compiler
    dd, d1, dt, dw, ds, dy, n, t1, w1, s1, y1 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    tt, tw, ts, ty, ww, ws, wy, ss, sy, yy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(count):
        d, t, w, s = _on_arm(distance[k], slopes[k], top, side, sigma, per_contrast)
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


@compiled(reassociates=True)
def _strays_on_arm(
    pixels: Float[np.ndarray, "4 m"],
    count: int,
    top: float,
    side: float,
    sigma: float,
    per_contrast: float,
    edge: int,
    b: Float[np.ndarray, " 7"],
    limit: float,
) -> int:
    """Count an arm's pixels whose residual's square is beyond the limit."""
    distance, weights, slopes, greys = (
        pixels[0],
        pixels[1],
        pixels[2],
        pixels[3],
    )  # in one piece for the compiler
    by_d, by_1, by_t, by_w, by_s = b[edge], b[2], b[3], b[4 + edge], b[6]
    found = 0
    for k in range(count):
        d, t, w, s = _on_arm(distance[k], slopes[k], top, side, sigma, per_contrast)
        r = greys[k] - t * slopes[k] - d * by_d - by_1 - t * by_t - w * by_w - s * by_s
        if weights[k] * r * r > limit:
            found += 1
    return found


@compiled
def _drop_on_arm(
    pixels: Float[np.ndarray, "4 m"],
    count: int,
    top: float,
    side: float,
    sigma: float,
    per_contrast: float,
    edge: int,
    b: Float[np.ndarray, " 7"],
    limit: float,
) -> None:
    """Take the weight from an arm's pixels whose residual's square is beyond the limit."""
    for k in range(count):
        slope = pixels[2, k]
        d, t, w, s = _on_arm(pixels[0, k], slope, top, side, sigma, per_contrast)
        r = pixels[3, k] - t * slope - d * b[edge] - b[2] - t * b[3] - w * b[4 + edge] - s * b[6]
        if pixels[1, k] * r * r > limit:
            pixels[1, k] = 0.0


@compiled
def place_edges(
    states: Float[np.ndarray, "n state"],
    along_x: Float[np.ndarray, "n 2"],
    along_y: Float[np.ndarray, "n 2"],
    bend_x: Float[np.ndarray, "n 2"],
    bend_y: Float[np.ndarray, "n 2"],
    reach_px: float,
    reach_share: float,
    width: int,
    height: int,
) -> None:
    """Set directions, bends, spacings and reaches of the two edges of each corner.

    `along_` and `bend_` are the first and second derivatives of the grid's map. An edge reaches `reach_px`,
    `reach_share` of the spacing, and as far as its band is in the picture to both sides.
    """
    for k in range(states.shape[0]):
        s = states[k]
        room_u, room_v = min(s[Q_U], width - 1.0 - s[Q_U]), min(s[Q_V], height - 1.0 - s[Q_V])
        for edge in range(2):
            along, across = (along_y[k], along_x[k]) if edge == 0 else (along_x[k], along_y[k])
            bend = bend_y[k] if edge == 0 else bend_x[k]
            at = N1_U if edge == 0 else N2_U
            length = max(math.hypot(along[0], along[1]), 1e-9)
            n_u, n_v = along[1] / length, -along[0] / length
            spacing = n_u * across[0] + n_v * across[1]
            if spacing < 0.0:
                n_u, n_v, spacing = -n_u, -n_v, -spacing
            beside = _half_band(s[SIGMA_1 + edge])
            reach = min(reach_px, reach_share * length)
            reach = min(reach, (room_u - beside * abs(n_u)) / max(abs(n_v), 1e-9))
            reach = min(reach, (room_v - beside * abs(n_v)) / max(abs(n_u), 1e-9))
            s[at], s[at + 1], s[at + 2] = n_u, n_v, (n_u * bend[0] + n_v * bend[1]) / length**2
            s[at + 3], s[SPACING_1 + edge] = max(reach, 0.0), spacing


@compiled
def move_corners(
    states: Float[np.ndarray, "n state"],
    steps: Float[np.ndarray, "n step"],
    chosen: Int[np.ndarray, " k"],
    knows_blur: bool,
    most_sigmas: float,
    variation: float,
    least_sigma: float,
    largest_sigma: float,
) -> None:
    """Move the chosen corners by their steps, at most so many σ, and their blur; steps that are NaN move nothing.

    Blurs stay within a factor `variation` of the median of those chosen, and between the two limits.
    """
    found = np.zeros(states.shape[0], np.bool_)
    sigmas = np.empty(2 * len(chosen))
    count = 0
    for k in chosen:
        s, step = states[k], steps[k]
        length = math.hypot(step[STEP_U], step[STEP_V])
        found[k] = math.isfinite(length) and step[CONTRAST] > 0.0
        if not found[k]:
            continue
        scale = min(1.0, most_sigmas * max(s[SIGMA_1], s[SIGMA_2]) / max(length, 1e-12))
        s[Q_U] += scale * step[STEP_U]
        s[Q_V] += scale * step[STEP_V]
        if knows_blur:
            for edge in range(2):
                wider = min(max(step[WIDER_1 + edge], -_MOST_WIDER), _MOST_WIDER)
                s[SIGMA_1 + edge] *= math.exp(wider)
                sigmas[count] = s[SIGMA_1 + edge]
                count += 1
    if not knows_blur:
        return
    typical = np.median(sigmas[:count]) if count > 0 else 1.0
    for k in range(states.shape[0]):
        for at in (SIGMA_1, SIGMA_2):
            sigma = min(max(states[k, at], typical / variation), typical * variation)
            states[k, at] = min(max(sigma, least_sigma), largest_sigma)


@compiled
def follow_edges(
    states: Float[np.ndarray, "n state"],
    steps: Float[np.ndarray, "n step"],
    along_x: Float[np.ndarray, "n 2"],
    along_y: Float[np.ndarray, "n 2"],
    bend_x: Float[np.ndarray, "n 2"],
    bend_y: Float[np.ndarray, "n 2"],
) -> None:
    """Move the corners by what their edges' bends differ from those that the last step had; see `place_edges`.

    An edge bent by κ stands ½ κ s² aside, over its reach r to both sides on average κ r² / 6. Its arms, on average at
    ± r / 2, are as uneven as the turn from the directions used, too, and no more.
    """
    shifts = np.empty(2)
    for k in range(states.shape[0]):
        s = states[k]
        for edge in range(2):
            along, bend = (along_y[k], bend_y[k]) if edge == 0 else (along_x[k], bend_x[k])
            at = N1_U if edge == 0 else N2_U
            length = max(math.hypot(along[0], along[1]), 1e-9)
            reach = s[at + 3]
            bend_now = (s[at] * bend[0] + s[at + 1] * bend[1]) / length**2
            turn = (s[at] * along[0] + s[at + 1] * along[1]) / length * reach
            shifts[edge] = (s[at + 2] - bend_now) * reach**2 / 6.0
            s[at + 2] = bend_now
            steps[k, UNEVEN] += turn if edge == 1 else -turn
        skew = s[N1_U] * s[N2_V] - s[N1_V] * s[N2_U]
        s[Q_U] += (s[N2_V] * shifts[0] - s[N1_V] * shifts[1]) / skew
        s[Q_V] += (s[N1_U] * shifts[1] - s[N2_U] * shifts[0]) / skew


@compiled
def _room(states: Float[np.ndarray, "n state"], chosen: Int[np.ndarray, " k"]) -> int:
    """Return how many pixels the bands of one corner can have."""
    most = 1.0
    for k in chosen:
        s = states[k]
        room = 0.0
        for reach, sigma in ((s[REACH_1], s[SIGMA_1]), (s[REACH_2], s[SIGMA_2])):
            room += (2.0 * reach + 3.0) * (2.0 * _half_band(sigma) * math.sqrt(2.0) + 2.0)
        if room > most:
            most = room
    return int(min(most, 1e6))


@compiled
def _factor(A: Float[np.ndarray, "7 7"], size: int) -> bool:
    """Replace the lower triangle by its Cholesky factor; False where A is not positive definite."""
    for i in range(size):
        for j in range(i + 1):
            value = A[i, j]
            for k in range(j):
                value -= A[i, k] * A[j, k]
            if i == j:
                if not value > 1e-10 * A[i, i] or not math.isfinite(value):
                    return False
                A[i, i] = math.sqrt(value)
            else:
                A[i, j] = value / A[j, j]
    return True


@compiled
def _substitute(L: Float[np.ndarray, "7 7"], size: int, b: Float[np.ndarray, " 7"]) -> None:
    """Replace b by the solution of L Lᵀ x = b."""
    for i in range(size):
        for k in range(i):
            b[i] -= L[i, k] * b[k]
        b[i] /= L[i, i]
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            b[i] -= L[k, i] * b[k]
        b[i] /= L[i, i]


@compiled
def step_corners(
    image: np.ndarray,
    states: Float[np.ndarray, "n state"],
    chosen: Int[np.ndarray, " k"],
    stride: int,
    knows_blur: bool,
    steps: Float[np.ndarray, "n step"],
) -> None:
    """Do one Gauss-Newton step for the chosen corners, on every stride-th line of pixels; see the columns' names.

    A template much wider than the picture's blur serves to come near, and then the columns of blur and spread are left
    out: they could all but cancel its contrast.

    Where the samples do not determine the corner its step is NaN. Covariances are those for noise of unit variance;
    what the residuals tell is told of a step on all lines only.
    """
    height, width = image.shape
    flat = image.reshape(-1)
    parts, A, L, b, y = np.zeros((5, 8, 8)), np.zeros((8, 8)), np.zeros((7, 7)), np.zeros(7), np.zeros(7)
    size = 7 if knows_blur else 4
    most = _room(states, chosen)
    pixels, X, counts = np.empty((4, 4, most)), np.empty((most, 8)), np.zeros(5, np.int64)
    for k in range(chosen.shape[0]):
        s, out = states[chosen[k]], steps[chosen[k]]
        out[:] = np.nan
        counts[:] = 0
        _band(flat, height, width, s, True, stride, pixels, X, counts)
        _band(flat, height, width, s, False, stride, pixels, X, counts)
        samples = counts.sum()
        samples_left = samples
        solved = False
        for _ in range(_MOST_ROUNDS):
            _add_up(s, pixels, X, counts, parts)
            for i in range(8):
                for j in range(i + 1):
                    A[i, j] = (
                        parts[0, i, j] + parts[1, i, j] + parts[2, i, j] + parts[3, i, j] + parts[4, i, j]
                    )
            L[:], b[:] = A[:7, :7], A[7, :7]
            b[size:] = 0.0
            solved = _factor(L, size)
            if not solved:
                break
            _substitute(L, size, b)
            dropped = _drop_strays(s, pixels, X, counts, b, A) if knows_blur else 0
            samples_left -= dropped
            if dropped == 0 or samples_left < _LEAST_LEFT * samples:
                break
        c = b[3]
        if not solved or not abs(c) > 1e-9 or samples_left < _LEAST_LEFT * samples:
            continue
        # N δ = d, and so the covariance of δ = N⁻¹ d
        n1u, n1v, n2u, n2v = s[N1_U], s[N1_V], s[N2_U], s[N2_V]
        skew = n1u * n2v - n1v * n2u
        out[STEP_U] = (n2v * b[0] - n1v * b[1]) / (skew * c)
        out[STEP_V] = (n1u * b[1] - n2u * b[0]) / (skew * c)
        out[LEVEL], out[CONTRAST] = b[2], c
        out[WIDER_1], out[WIDER_2], out[SPREAD] = b[4] / c, b[5] / c, b[6] / c
        if stride == 1:
            _look_back(parts, A, b, out)
        y[:] = 0.0
        y[0] = 1.0
        _substitute(L, size, y)
        v11, v12 = y[0], y[1]
        y[:] = 0.0
        y[1] = 1.0
        _substitute(L, size, y)
        v22 = y[1]
        scale = 1.0 / (skew * c) ** 2
        out[COV_UU] = scale * (n2v * n2v * v11 - 2.0 * n1v * n2v * v12 + n1v * n1v * v22)
        out[COV_VV] = scale * (n2u * n2u * v11 - 2.0 * n1u * n2u * v12 + n1u * n1u * v22)
        out[COV_UV] = scale * (-n2u * n2v * v11 + (n1u * n2v + n1v * n2u) * v12 - n1u * n1v * v22)


@compiled
def _add_up(
    s: Float[np.ndarray, " state"],
    pixels: Float[np.ndarray, "4 4 m"],
    X: Float[np.ndarray, "n 8"],
    counts: Int[np.ndarray, "5"],
    parts: Float[np.ndarray, "5 8 8"],
) -> None:
    """Set the lower triangles of Xᵀ X over each of the four arms, and over the pixels near the crossing."""
    for arm in range(4):
        edge = arm // 2
        sigma, side = s[SIGMA_1 + edge], s[SIGN] if arm % 2 else -s[SIGN]
        top = _flat_top(s[N1_U], s[N1_V], sigma) if edge == 0 else _flat_top(s[N2_U], s[N2_V], sigma)
        _add_arm(pixels[arm], counts[arm], top, side, sigma, s[PER_CONTRAST], edge, parts[arm])
    rows = X[: counts[4]]
    parts[4] = np.dot(rows.T, rows)


@compiled
def _drop_strays(
    s: Float[np.ndarray, " state"],
    pixels: Float[np.ndarray, "4 4 m"],
    X: Float[np.ndarray, "n 8"],
    counts: Int[np.ndarray, "5"],
    b: Float[np.ndarray, " 7"],
    A: Float[np.ndarray, "8 8"],
) -> int:
    """Take the weight from pixels far off the model (dead ones, hot ones, dust); return how many there were."""
    squares = A[7, 7]
    for i in range(7):
        squares -= b[i] * A[7, i]
    limit = max(STRAY**2 * squares / max(A[2, 2], 1.0), (LEAST_STRAY * b[3]) ** 2)
    dropped = 0
    for arm in range(4):
        edge = arm // 2
        sigma, side = s[SIGMA_1 + edge], s[SIGN] if arm % 2 else -s[SIGN]
        top = _flat_top(s[N1_U], s[N1_V], sigma) if edge == 0 else _flat_top(s[N2_U], s[N2_V], sigma)
        found = _strays_on_arm(pixels[arm], counts[arm], top, side, sigma, s[PER_CONTRAST], edge, b, limit)
        if found > 0:
            _drop_on_arm(pixels[arm], counts[arm], top, side, sigma, s[PER_CONTRAST], edge, b, limit)
        dropped += found
    for k in range(counts[4]):
        x = X[k]
        r = x[7] - x[0] * b[0] - x[1] * b[1] - x[2] * b[2] - x[3] * b[3]
        r -= x[4] * b[4] + x[5] * b[5] + x[6] * b[6]
        if r * r > limit:
            X[k] = 0.0
            dropped += 1
    return dropped


@compiled
def _look_back(
    parts: Float[np.ndarray, "5 8 8"],
    A: Float[np.ndarray, "8 8"],
    b: Float[np.ndarray, " 7"],
    out: Float[np.ndarray, " step"],
) -> None:
    """Sum up the residuals' squares, and by how much the arms disagree, in place and in contrast.

    An arm's own shift is Σ D r / (c Σ D²), of variance 1 / (c² Σ D²) in unit noise. Position moves both arms of an
    edge alike, spread ink moves them apart and does so for both edges: left is the difference of the differences.
    """
    squares = A[7, 7]
    for i in range(7):
        squares -= b[i] * A[7, i]
    out[SQUARES], out[SAMPLES] = max(squares, 0.0), A[2, 2]
    _compare_arms(parts, b, out)
    uneven, variance = 0.0, 0.0
    for arm in range(4):
        edge = arm // 2
        of_arm = parts[arm]
        steepness = of_arm[edge, edge]
        if not steepness > 0.0:
            return
        score = of_arm[7, edge]
        for i in range(7):
            score -= b[i] * of_arm[max(i, edge), min(i, edge)]
        shift = score / (b[3] * steepness)
        uneven += shift if arm == 1 or arm == 2 else -shift
        variance += 1.0 / (steepness * b[3] ** 2)
    out[UNEVEN], out[UNEVEN_VARIANCE] = uneven, variance


@compiled
def _compare_arms(
    parts: Float[np.ndarray, "5 8 8"], b: Float[np.ndarray, " 7"], out: Float[np.ndarray, " step"]
) -> None:
    """Set the contrast across the arm that shows least, in the corner's own, and its doubt in unit noise.

    A line through the grey over T along one arm has the contrast as its slope. Where the picture has a bend of an
    outline, or the end of one, in place of a crossing, two arms or one show none.
    """
    for arm in range(4):
        of_arm = parts[arm]
        samples = of_arm[2, 2]
        if samples <= 0.0:
            continue
        spread = of_arm[3, 3] - of_arm[3, 2] ** 2 / samples
        if spread <= 0.0:
            continue
        share = (of_arm[7, 3] - of_arm[3, 2] * of_arm[7, 2] / samples) / (spread * b[3])
        if not share >= out[WEAKEST_ARM]:
            out[WEAKEST_ARM] = share
            out[WEAKEST_ARM_DOUBT] = 1.0 / (abs(b[3]) * math.sqrt(spread))
