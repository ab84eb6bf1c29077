"""The model of a chessboard corner in the image's own pixels, and the columns of a corner's state and step.

Two edge lines cross at the corner q. With a₁, a₂ a pixel's signed distances from them (they may bend: a = n·d -
½ κ s², d from q, s along the line), x = a/σ and P = 2Φ - 1, a blurred chessboard is

    grey = b(d) + c(d) T,    T = ± E[sgn(x₁ + ε₁) sgn(x₂ + ε₂)] = ± (P(x₁) P(x₂) + excess),

with b, c linear in d, and ε normal of correlation ρ = n₁·n₂, whose excess over the product is near the crossing only
(Mehler's series). σ² is the blur's variance plus the pixel's own 1/12; that a pixel is a square and no Gaussian is
left is the fourth cumulant κ₄ = -(n_u⁴ + n_v⁴)/120 (Gram-Charlier). Where σ is not small against the squares, the
lines of the neighbouring corners are seen too: P(x) - P(x - D/σ) - P(x + D/σ).

Moving the corner by d₁ along n₁ adds c d₁ D₁, D₁ = -∂T/∂a₁. So every step is a linear least-squares problem: no pixel
is interpolated, and white noise in the image is white noise in it. T is symmetric about q and D is antisymmetric;
samples are taken (almost) symmetrically about q, so whatever is symmetric in the image and not in the model (ink that
spreads, a camera's gamma, a blur of another shape) moves no corner.

A marker in each bright square, with a white margin m around it and a black border w wide, adds to T on the bright
sides, with x and y counted from the edges toward the marker's middle (its bits half white, on average),

    M = -2 (Φ(x - m) Φ(y - m) - ½ Φ(x - m - w) Φ(y - m - w)).

It matters where the margin is few σ wide. It moves with the corner, so its edges determine the place as well.

Only pixels near an edge, within `BAND` σ, determine its place. They do not determine the slopes of b and c, which look
much like a shift of the edge: these are given.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import erf

from core.jit import jit

BAND = 2.0
"""Half width of the band of pixels along an edge, in σ: D² ∝ exp(-x²) beyond it is 4e-4 of the whole."""
MIN_BAND_PX = 2.0
"""And in px at least this less two thirds of `BAND` σ, which is more where σ < .6: the one or two pixels across a
sharper edge do not separate its blur from its contrast. Still wider, the band has what cameras do to sharpen edges."""
NEAR = 3.0
"""Within so many σ of the other edge its P is not yet ±1."""
MIN_PRINT_BAND, CLEAR_OF_BITS = 1.2, 1.3
"""In σ: half width of the band where markers are near, at least; and how far it stays away from their bits."""

# columns of a corner's state
Q_U, Q_V, N1_U, N1_V, BEND_1, REACH_1, N2_U, N2_V, BEND_2, REACH_2, SIGN = range(11)
SIGMA_1, SIGMA_2, SPACING_1, SPACING_2, LEVEL_U, LEVEL_V, CONTRAST_U, CONTRAST_V, PER_CONTRAST = range(11, 20)
MARGIN, BORDER = (
    20,
    21,
)  # of the markers in bright squares: the white around them, their black border; spacings
STATE = 22

# columns of a step
STEP_U, STEP_V, LEVEL, CONTRAST, WIDER_1, WIDER_2, SPREAD = range(7)
SQUARES, SAMPLES, COV_UU, COV_UV, COV_VV, UNEVEN, UNEVEN_VARIANCE = range(7, 14)
WEAKEST_ARM, WEAKEST_ARM_SIGMA, EXPLAINED = range(14, 17)
STEP = 17

_PER_UNIT = 32
_AT = np.arange(0.0, 6.5, 1.0 / _PER_UNIT)
_P = erf(_AT / math.sqrt(2.0))
_BELL = np.exp(-0.5 * _AT**2) / math.sqrt(2.0 * math.pi)
_P.flags.writeable = _BELL.flags.writeable = False


@jit("f8")
def normal_step(x: float) -> tuple[float, float]:
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


@jit("f8, f8, f8")
def edge_profile(x: float, top: float, spacing: float) -> tuple[float, float, float]:
    """Return P with the pixel's shape and the neighbouring lines, half its derivative, and its own density."""
    value, bell = normal_step(x)
    xx = x * x
    value -= 2.0 * top * bell * x * (xx - 3.0)
    half = bell * (1.0 + top * (xx * (xx - 6.0) + 3.0))
    if abs(x) + NEAR > spacing:
        before, bell_before = normal_step(x + spacing)
        after, bell_after = normal_step(x - spacing)
        value -= before + after
        half -= bell_before + bell_after
    return value, half, bell


@jit("f8")
def half_band(sigma: float) -> float:
    """Return half the width (px) of the band of pixels along an edge."""
    return max(BAND * sigma, MIN_BAND_PX - BAND * sigma / 1.5)


@jit("f8, f8, f8")
def flat_top(n_u: float, n_v: float, sigma: float) -> float:
    """Return κ₄ / (24 σ⁴) of the pixel's square in an edge's profile."""
    return -(n_u**4 + n_v**4) / (120.0 * 24.0 * sigma**4)


@jit("f8, f8, f8, f8, f8, f8, f8")
def marker_profile(
    a: float, o: float, sign: float, margin: float, border: float, margin_o: float, border_o: float
) -> tuple[float, float, float, float, float]:
    """Return M of the markers in the two bright squares, its derivatives by a and o, and those by the logarithms of
    the two edges' σ. All lengths are in σ of the edge that they are counted from."""
    value, by_a, by_o, by_wider, by_wider_o = 0.0, 0.0, 0.0, 0.0, 0.0
    for side in (1.0, -1.0):
        side_o = sign * side
        for depth, share in ((0.0, -2.0), (1.0, 1.0)):  # the marker is black, its inside half white
            x, y = side * a - margin - depth * border, side_o * o - margin_o - depth * border_o
            P, bell = normal_step(x)
            P_o, bell_o = normal_step(y)
            inside, inside_o = 0.5 + 0.5 * P, 0.5 + 0.5 * P_o
            value += share * inside * inside_o
            by_a += share * side * bell * inside_o
            by_o += share * side_o * bell_o * inside
            by_wider -= share * x * bell * inside_o
            by_wider_o -= share * y * bell_o * inside
    return value, by_a, by_o, by_wider, by_wider_o
