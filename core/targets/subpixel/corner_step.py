"""One Gauss-Newton step of each corner on its pixels, and what the residuals show of it."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float, Int

from core.jit import jit
from core.targets.subpixel.corner_arms import count_strays, drop_strays, sum_arm
from core.targets.subpixel.corner_model import (
    CONTRAST,
    COV_UU,
    COV_UV,
    COV_VV,
    EXPLAINED,
    LEVEL,
    N1_U,
    N1_V,
    N2_U,
    N2_V,
    SAMPLES,
    SPREAD,
    SQUARES,
    STEP_U,
    STEP_V,
    UNEVEN,
    UNEVEN_VARIANCE,
    WEAKEST_ARM,
    WEAKEST_ARM_SIGMA,
    WIDER_1,
    WIDER_2,
)
from core.targets.subpixel.edge_pixels import collect_pixels, max_pixels

STRAY, MIN_STRAY = 5.0, 0.1
"""Pixels are rejected whose residual is so many times the root mean square, and this share of half the contrast."""
_MAX_ROUNDS, _MIN_LEFT = 4, 0.9


@jit("f8[:, ::1], i8")
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


@jit("f8[:, ::1], i8, f8[::1]")
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


@jit(
    "u1[:, ::1], f8[:, ::1], i8[::1], i8, b1, f8[:, ::1]",
    "u2[:, ::1], f8[:, ::1], i8[::1], i8, b1, f8[:, ::1]",
)
def step_corners(
    image: np.ndarray,
    states: Float[np.ndarray, "n state"],
    chosen: Int[np.ndarray, " k"],
    stride: int,
    knows_blur: bool,
    steps: Float[np.ndarray, "n step"],
) -> None:
    """Do one Gauss-Newton step for the chosen corners, on every stride-th line of pixels; see the columns' names.

    A template much wider than the image's blur serves to come near, and then the columns of blur and spread are
    dropped: they could all but cancel its contrast.

    Where the samples do not determine the corner its step is NaN. Covariances are those for noise of unit variance;
    figures of the residuals are set by a step on all lines only.
    """
    height, width = image.shape
    flat = image.reshape(-1)
    parts, A, L, b, y = np.zeros((5, 8, 8)), np.zeros((8, 8)), np.zeros((7, 7)), np.zeros(7), np.zeros(7)
    size = 7 if knows_blur else 4
    most = max_pixels(states, chosen)
    pixels, X, counts = np.empty((4, 4, most)), np.empty((most, 8)), np.zeros(5, np.int64)
    arm_of = np.empty(most, np.int64)
    for k in range(chosen.shape[0]):
        s, out = states[chosen[k]], steps[chosen[k]]
        out[:] = np.nan
        counts[:] = 0
        collect_pixels(flat, height, width, s, True, stride, pixels, X, arm_of, counts)
        collect_pixels(flat, height, width, s, False, stride, pixels, X, arm_of, counts)
        samples = counts.sum()
        samples_left = samples
        solved = False
        for _ in range(_MAX_ROUNDS):
            _add_up(s, pixels, X, arm_of, counts, parts)
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
            if dropped == 0 or samples_left < _MIN_LEFT * samples:
                break
        c = b[3]
        if not solved or not abs(c) > 1e-9 or samples_left < _MIN_LEFT * samples:
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


@jit("f8[::1], f8[:, :, ::1], f8[:, ::1], i8[::1], i8[::1], f8[:, :, ::1]")
def _add_up(
    s: Float[np.ndarray, " state"],
    pixels: Float[np.ndarray, "4 4 m"],
    X: Float[np.ndarray, "n 8"],
    arm_of: Int[np.ndarray, " n"],
    counts: Int[np.ndarray, "5"],
    parts: Float[np.ndarray, "5 8 8"],
) -> None:
    """Set the lower triangles of Xᵀ X over each of the four arms, and over the pixels near the crossing."""
    for arm in range(4):
        sum_arm(pixels[arm], counts[arm], s, arm, parts[arm])
    rows = X[: counts[4]]
    parts[4] = np.dot(rows.T, rows)
    for k in range(counts[4]):
        if arm_of[k] < 4:
            of_arm, row = parts[arm_of[k]], X[k]
            for i in range(8):
                for j in range(i + 1):
                    of_arm[i, j] += row[i] * row[j]
                    parts[4, i, j] -= row[i] * row[j]


@jit("f8[::1], f8[:, :, ::1], f8[:, ::1], i8[::1], f8[::1], f8[:, ::1]")
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
    limit = max(STRAY**2 * squares / max(A[2, 2], 1.0), (MIN_STRAY * b[3]) ** 2)
    dropped = 0
    for arm in range(4):
        found = count_strays(pixels[arm], counts[arm], s, arm, b, limit)
        if found > 0:
            drop_strays(pixels[arm], counts[arm], s, arm, b, limit)
        dropped += found
    for k in range(counts[4]):
        x = X[k]
        r = x[7] - x[0] * b[0] - x[1] * b[1] - x[2] * b[2] - x[3] * b[3]
        r -= x[4] * b[4] + x[5] * b[5] + x[6] * b[6]
        if r * r > limit:
            X[k] = 0.0
            dropped += 1
    return dropped


@jit("f8[:, :, ::1], f8[:, ::1], f8[::1], f8[::1]")
def _look_back(
    parts: Float[np.ndarray, "5 8 8"],
    A: Float[np.ndarray, "8 8"],
    b: Float[np.ndarray, " 7"],
    out: Float[np.ndarray, " step"],
) -> None:
    """Sum up the squares of the residuals, and of what the model explains beyond one level, and by how much the arms
    disagree, in place and in contrast.

    An arm's own shift is Σ D r / (c Σ D²), of variance 1 / (c² Σ D²) in unit noise. Position moves both arms of an
    edge equally, spread ink moves them apart and does so for both edges: left is the difference of the differences.
    """
    squares = A[7, 7]
    for i in range(7):
        squares -= b[i] * A[7, i]
    out[SQUARES], out[SAMPLES] = max(squares, 0.0), A[2, 2]
    out[EXPLAINED] = A[7, 7] - A[7, 2] ** 2 / A[2, 2] - squares
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


@jit("f8[:, :, ::1], f8[::1], f8[::1]")
def _compare_arms(
    parts: Float[np.ndarray, "5 8 8"], b: Float[np.ndarray, " 7"], out: Float[np.ndarray, " step"]
) -> None:
    """Set the contrast across the arm that shows least, in the corner's own, and its standard deviation in unit noise.

    A line through the grey over T along one arm has the contrast as its slope. Where the image has a bend of an
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
            out[WEAKEST_ARM_SIGMA] = 1.0 / (abs(b[3]) * math.sqrt(spread))
