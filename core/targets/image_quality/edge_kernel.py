"""Profiles across the edges of a printed target, laid one upon the other: what one pixel's width of blur looks like.

Each profile is aligned by where it crosses the middle between its own two ends, so that the average over many edges,
which lie at all places between the pixels, is sampled finer than the pixels are (as ISO 12233 does with a slanted
edge) and free of most noise.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float, Int, Shaped

from core.jit import jit

BINS_PER_PX = 4
REACH_PX = 16
"""Longest half of a profile, and of the average."""
STEP_PX = 0.5


@jit(
    "u1[:, ::1], f8[:, ::1], f8[:, ::1], f8[::1], i8[::1], i8, f8, f8",
    "u2[:, ::1], f8[:, ::1], f8[:, ::1], f8[::1], i8[::1], i8, f8, f8",
)
def average_profiles(
    image: Shaped[np.ndarray, "h w"],
    middle: Float[np.ndarray, "n 2"],
    across: Float[np.ndarray, "n 2"],
    half_px: Float[np.ndarray, " n"],
    family: Int[np.ndarray, " n"],
    families: int,
    least_contrast: float,
    top: float,
) -> tuple[
    Float[np.ndarray, "families bins"],
    Float[np.ndarray, "families bins"],
    Float[np.ndarray, "n 2"],
    float,
    float,
]:
    """Return the average edge of each family, how many samples are in each bin, every profile's dark and bright end,
    and which parts of the samples at the ends are at `top`, and at 0.

    Parameters
    ----------
    middle, across
        A place near the edge, px, and the unit vector across it.
    half_px
        How far the profile goes to either side: at most `REACH_PX`; one that leaves the image is skipped.
    family
        Which average an edge belongs to.
    least_contrast
        Grey levels: an edge with less is skipped. The ends of a skipped edge are NaN.

    The average runs from 0 (dark) to 1 (bright) over bins of 1 / `BINS_PER_PX`, the crossing between the middle two.
    """
    bins = 2 * REACH_PX * BINS_PER_PX
    sums = np.zeros((families, bins))
    counts = np.zeros((families, bins))
    ends = np.full((len(middle), 2), np.nan)
    height, width = image.shape
    values = np.zeros(int(2 * REACH_PX / STEP_PX) + 1)
    at_top = at_zero = bright_samples = dark_samples = 0
    for k in range(len(middle)):
        half = min(half_px[k], float(REACH_PX))
        steps = int(half / STEP_PX)
        n = 2 * steps + 1
        reach = steps * STEP_PX
        u0, v0, du, dv = middle[k, 0], middle[k, 1], across[k, 0], across[k, 1]
        low_u, high_u = u0 - reach * abs(du), u0 + reach * abs(du)
        low_v, high_v = v0 - reach * abs(dv), v0 + reach * abs(dv)
        if n < 7 or not (low_u >= 0.0 and high_u < width - 1 and low_v >= 0.0 and high_v < height - 1):
            continue
        for i in range(n):
            s = (i - steps) * STEP_PX
            u, v = u0 + s * du, v0 + s * dv
            iu, iv = int(u), int(v)
            a, b = u - iu, v - iv
            values[i] = (1.0 - b) * ((1.0 - a) * image[iv, iu] + a * image[iv, iu + 1]) + b * (
                (1.0 - a) * image[iv + 1, iu] + a * image[iv + 1, iu + 1]
            )
        quarter = max(1, n // 8)
        first = last = 0.0
        for i in range(quarter):
            first += values[i] / quarter
            last += values[n - 1 - i] / quarter
        dark, bright = min(first, last), max(first, last)
        if bright - dark < least_contrast:
            continue
        crossing = math.nan
        nearest = math.inf
        for i in range(n - 1):
            x, y = values[i] - 0.5 * (dark + bright), values[i + 1] - 0.5 * (dark + bright)
            if (x < 0.0) != (y < 0.0):
                s = (i - steps + x / (x - y)) * STEP_PX
                if abs(s) < nearest:
                    nearest = abs(s)
                    crossing = s
        if math.isnan(crossing):
            continue
        ends[k, 0], ends[k, 1] = dark, bright
        sign = 1.0 if last > first else -1.0
        for i in range(n):
            s = sign * ((i - steps) * STEP_PX - crossing)
            place = math.floor(s * BINS_PER_PX) + bins // 2
            if 0 <= place < bins:
                sums[family[k], place] += (values[i] - dark) / (bright - dark)
                counts[family[k], place] += 1.0
        for i in range(quarter):
            for j in (i, n - 1 - i):
                is_bright = (j == i) == (first > last)
                if is_bright:
                    bright_samples += 1
                    at_top += values[j] >= top
                else:
                    dark_samples += 1
                    at_zero += values[j] <= 0.0
    for f in range(families):
        for i in range(bins):
            sums[f, i] = sums[f, i] / counts[f, i] if counts[f, i] > 0.0 else math.nan
    saturated = at_top / bright_samples if bright_samples > 0 else math.nan
    clipped = at_zero / dark_samples if dark_samples > 0 else math.nan
    return sums, counts, ends, saturated, clipped
