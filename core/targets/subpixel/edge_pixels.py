"""The pixels along the two edges of a corner: those of the four arms, and those near the crossing."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float, Int

from core.jit import jit
from core.targets.subpixel.corner_model import (
    BEND_1,
    BEND_2,
    BORDER,
    CLEAR_OF_BITS,
    CONTRAST_U,
    CONTRAST_V,
    LEVEL_U,
    LEVEL_V,
    MARGIN,
    MIN_PRINT_BAND,
    N1_U,
    N1_V,
    N2_U,
    N2_V,
    NEAR,
    PER_CONTRAST,
    Q_U,
    Q_V,
    REACH_1,
    REACH_2,
    SIGMA_1,
    SIGMA_2,
    SIGN,
    SPACING_1,
    SPACING_2,
    edge_profile,
    flat_top,
    half_band,
    marker_profile,
    normal_step,
)


@jit(
    "u1[::1], i8, i8, f8[::1], b1, i8, f8[:, :, ::1], f8[:, ::1], i8[::1], i8[::1]",
    "u2[::1], i8, i8, f8[::1], b1, i8, f8[:, :, ::1], f8[:, ::1], i8[::1], i8[::1]",
)
def collect_pixels(
    flat: np.ndarray,
    height: int,
    width: int,
    s: Float[np.ndarray, " state"],
    first: bool,
    stride: int,
    pixels: Float[np.ndarray, "4 4 m"],
    X: Float[np.ndarray, "n 8"],
    arm_of: Int[np.ndarray, " n"],
    counts: Int[np.ndarray, "5"],
) -> None:
    """Collect the pixels along one edge, and count them.

    Those of its arms go to `pixels[arm]`: distance from the edge in σ, weight, slope of the contrast, and the grey less
    the level's slope. To those near the other edge too, the model is rows of X: the factors of the unknowns (c d₁,
    c d₂, b₀, c₀, c Δln σ₁, c Δln σ₂, c spread) and the grey, all times the root of the pixel's weight. Where markers
    are near, all pixels are such rows; `arm_of` names the arm of those that are on one, and is 4 of others.
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
    band, band_m = half_band(sigma) / sigma, half_band(sigma_m) / sigma_m
    clear = max(NEAR, band_m)
    margin, border, margin_m, border_m = (
        s[MARGIN] * gap,
        s[BORDER] * gap,
        s[MARGIN] * gap_m,
        s[BORDER] * gap_m,
    )
    is_printed = s[MARGIN] > 0.0 and min(margin - band, margin_m - band_m) < NEAR
    if is_printed:
        band = min(band, max(margin + border - CLEAR_OF_BITS, MIN_PRINT_BAND))
        band_m = min(band_m, max(margin_m + border_m - CLEAR_OF_BITS, MIN_PRINT_BAND))
    top, top_m = flat_top(nu, nv, sigma), flat_top(mu, mv, sigma_m)
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
    half = band * sigma / abs(n_across)
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
        at_arm = arm + 1 if o_middle > 0.0 else arm
        if is_arm and not is_printed:
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
                value, h, bell = edge_profile(a, top, gap)
                value_m, h_m, bell_m = edge_profile(o, top_m, gap_m)
                P_given, _ = normal_step((o - rho * a) * rest)
                P_given_m, _ = normal_step((a - rho * o) * rest)
                if gap_m < 2.0 * NEAR:
                    P_given += value_m - normal_step(o)[0]
                if gap < 2.0 * NEAR:
                    P_given_m += value - normal_step(a)[0]
                aa, oo, ao = a * a, o * o, a * o
                excess = rho * rho * ao * (aa - 3.0) * (oo - 3.0) / 24.0 + rho * (aa - 1.0) * (oo - 1.0) / 6.0
                excess = rho * (1.0 + rho * (0.5 * ao + rho * excess))
                T = sign * (value * value_m + 4.0 * bell * bell_m * excess)
                strong = root * (1.0 + slope * per_contrast)
                bump = sign * strong * 2.0 * h * P_given
                bump_m = sign * strong * 2.0 * h_m * P_given_m
                wider, wider_m, spread = -a * bump, -o * bump_m, strong * (1.0 - T * T)
                if is_printed:
                    M, by_a, by_o, by_wider, by_wider_m = marker_profile(
                        a, o, sign, margin, border, margin_m, border_m
                    )
                    T += M
                    bump += strong * by_a
                    bump_m += strong * by_o
                    wider += strong * by_wider
                    wider_m += strong * by_wider_m
                row = X[samples]
                row[own], row[other], row[2], row[3] = (
                    -bump * per_sigma,
                    -bump_m * per_sigma_m,
                    root,
                    root * T,
                )
                row[4 + own], row[4 + other], row[6] = wider, wider_m, spread
                arm_of[samples] = at_arm if is_arm else 4
                row[7] = root * (flat[at] - level - T * slope)
                samples += 1
            at += to_next
            a += da
            o += do
            level += level_across
            slope += contrast_across
        counts[4] = samples


@jit("f8[:, ::1], i8[::1]")
def max_pixels(states: Float[np.ndarray, "n state"], chosen: Int[np.ndarray, " k"]) -> int:
    """Return how many pixels the bands of one corner can have."""
    most = 1.0
    for k in chosen:
        s = states[k]
        room = 0.0
        for reach, sigma in ((s[REACH_1], s[SIGMA_1]), (s[REACH_2], s[SIGMA_2])):
            room += (2.0 * reach + 3.0) * (2.0 * half_band(sigma) * math.sqrt(2.0) + 2.0)
        if room > most:
            most = room
    return int(min(most, 1e6))
