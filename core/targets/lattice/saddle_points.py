"""Detect points of an image that look like the corner of four squares, and the directions of their edges.

1. Where two edges cross the grey values f form a saddle: f_xy² - f_xx f_yy, which no turn of the axes changes, is
   positive and largest there; it is zero along straight edges and negative on blobs (P. R. Beaudet,
   "Rotationally invariant image operators", ICPR 1978). Its local maxima well above the noise are looked at.
2. Rings around such a point show whether it is a corner of four squares, and its edges' directions (`rings`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, Shaped

from core.jit import jit
from core.numerics import quantiles
from core.targets.lattice.pyramid import Level
from core.targets.lattice.rings import CIRCLE, rings

_BINOMIAL = np.array([1.0, 2.0, 1.0], dtype=np.float32)
_MIN_NOISE = 3.0  # of the mixed derivative, from the rounding to whole levels alone
_NOISE_QUANTILE, _NOISE_DEVIATES = 0.4, 0.5244  # |z| of a normal deviate z is below the latter in that share
_STRONG_QUANTILE, _MAX_OF_STRONG = 0.99, 0.08
"""Where squares fill the image no part of it is calm: noise is bounded by this fraction of the strong responses."""
_NOISE_SAMPLES = 2_000
_NOISE_OF_DOUBLED = 4.0
"""Neighbouring pixels of a doubled image have noise in common: there is more of it in f_xx and f_yy than in f_xy."""
_MIN_SADDLE = 4.0  # standard deviations of the noise
_MIN_SECTOR = 2.0  # standard deviations of the smoothed image's noise
_MAX_SADDLES = 1 << 17
_MIN_ROUND = 0.3
"""Least f_xy² - f_xx f_yy, of (f_xx + f_yy)²: ¼ tan² of the angle between the saddle's lines of equal grey. Blurred as
they are, edges that cross at 28° still have .8."""
_MAX_SHIFT = 1.3  # px, from the maximum to the saddle itself
_BORDER = 5
_BLOCK = 32


@dataclass(frozen=True, slots=True)
class Saddles:
    """Candidates for corners on one level.

    `points` (n, 2) in the level's pixels; `rays` (n, 4, 2) unit vectors along the four edges by growing angle (from u
    to v); after rays 0 and 2 a bright square follows, after 1 and 3 a dark one; `contrast` (n,) between bright and
    dark on the ring, in the units of `smooth`, the smoothed image it was measured in.
    """

    points: Float32[np.ndarray, "n 2"]
    rays: Float32[np.ndarray, "n 4 2"]
    contrast: Float32[np.ndarray, " n"]
    smooth: Shaped[np.ndarray, "h w"]

    def __len__(self) -> int:
        return len(self.points)


def find_saddles(level: Level) -> Saddles:
    """Return the points of a level that look like corners of four squares."""
    depth = cv2.CV_16S if level.image.dtype == np.uint8 else cv2.CV_32F
    smooth = cv2.sepFilter2D(level.image, depth, _BINOMIAL, _BINOMIAL)
    noise = mixed_derivative_noise(smooth) * (_NOISE_OF_DOUBLED if level.halvings < 0 else 1.0)
    least = (_MIN_SADDLE * noise) ** 2
    places = np.empty((_MAX_SADDLES, 3), dtype=np.float32)
    count = saddle_points(smooth, np.float32(least), places)
    while (
        count > _MAX_SADDLES
    ):  # an image full of texture: the stronger ones, or the first where all are equal
        fewer = saddle_points(smooth, np.float32(4.0 * least), places)
        if fewer < _MAX_SADDLES // 8:
            saddle_points(smooth, np.float32(least), places)
            break
        least, count = 4.0 * least, fewer
    count = min(count, _MAX_SADDLES)
    # the mixed derivative is a sum of four values hardly related, so twice as noisy as one
    points, rays, contrast = rings(smooth, places[:count], CIRCLE, 0.5 * noise * _MIN_SECTOR)
    return Saddles(points, rays, contrast, smooth)


def mixed_derivative_noise(smooth: Shaped[np.ndarray, "h w"]) -> float:
    """Return the standard deviation of noise in the mixed derivative as `saddle_points` takes it, from the calmer
    part of the image."""
    height, width = smooth.shape
    if min(height, width) < 3:
        return _MIN_NOISE
    step = max(1, math.isqrt(height * width // _NOISE_SAMPLES))
    calm, strong = quantiles(mixed_derivatives(smooth, step), (_NOISE_QUANTILE, _STRONG_QUANTILE))
    return max(min(calm / _NOISE_DEVIATES, _MAX_OF_STRONG * strong), _MIN_NOISE)


@jit("i2[:, ::1], i8", "f4[:, ::1], i8")
def mixed_derivatives(smooth: np.ndarray, step: int) -> np.ndarray:
    """Return 4 |f_xy| at every `step`-th pixel of every `step`-th row, float32, row by row."""
    height, width = smooth.shape
    found = np.empty(((height - 3) // step + 1) * ((width - 3) // step + 1), dtype=np.float32)
    count = 0
    for v in range(1, height - 1, step):
        upper, lower = smooth[v - 1], smooth[v + 1]
        for u in range(1, width - 1, step):
            falling = np.float32(lower[u + 1]) - np.float32(lower[u - 1])
            found[count] = abs(falling - np.float32(upper[u + 1]) + np.float32(upper[u - 1]))
            count += 1
    return found


@jit("f4[:, ::1], f4, f4[:, ::1]", "i2[:, ::1], f4, f4[:, ::1]")
def saddle_points(smooth: np.ndarray, floor: np.float32, places: np.ndarray) -> int:
    """Write the local maxima, within 5 x 5 pixels, of f_xy² - f_xx f_yy above `floor` to `places` (n, 3).

    It counts as 0 where it is less than _MIN_ROUND (f_xx + f_yy)². Derivatives are 4 f_xy = sum over (±1, ±1) with
    signs and 4 f_xx = f(+2) - 2 f + f(-2). A place is u, v of the saddle of the quadratic there, and its value. Returns
    how many there are, those without a place included.
    """
    height, width = smooth.shape
    if height < 2 * _BORDER + 1 or width < 2 * _BORDER + 1:
        return 0
    saddle = np.zeros((5, width), dtype=np.float32)  # of the last five rows
    count = 0
    inner = width - 4
    round_enough, none = np.float32(_MIN_ROUND), np.float32(0.0)
    for v in range(2, height - 2):
        # whole rows and a count from zero: so the loop is compiled to vector instructions
        row, here = saddle[v % 5], smooth[v]
        above, up, down, below = smooth[v - 2], smooth[v - 1], smooth[v + 1], smooth[v + 2]
        for i in range(inner):
            twice = np.float32(here[i + 2]) + np.float32(here[i + 2])
            xx = np.float32(here[i]) - twice + np.float32(here[i + 4])
            yy = np.float32(above[i + 2]) - twice + np.float32(below[i + 2])
            xy = (
                np.float32(down[i + 3])
                - np.float32(down[i + 1])
                - np.float32(up[i + 3])
                + np.float32(up[i + 1])
            )
            value = xy * xy - xx * yy
            # along an edge noise alone makes saddles, long and narrow ones
            row[i + 2] = value if value > round_enough * (xx + yy) * (xx + yy) else none
        w = v - 2  # the row whose neighbours are all known now
        if w < _BORDER or w >= height - _BORDER:
            continue
        middle, upper, lower = saddle[w % 5], saddle[(w - 1) % 5], saddle[(w + 1) % 5]
        for begin in range(_BORDER, width - _BORDER, _BLOCK):
            end = min(begin + _BLOCK, width - _BORDER)
            maxima = np.int32(0)
            block, before, after = middle[begin:end], middle[begin - 1 : end - 1], middle[begin + 1 : end + 1]
            over, under = upper[begin:end], lower[begin:end]
            for i in range(end - begin):
                value = block[i]
                maxima += np.int32(
                    (value > floor)
                    & (value > before[i])
                    & (value >= after[i])
                    & (value > over[i])
                    & (value >= under[i])
                )
            if maxima == 0:
                continue
            for u in range(begin, end):
                value = middle[u]
                if value <= floor or value <= middle[u - 1] or value < middle[u + 1]:
                    continue
                # the saddle of the quadratic through the 3 x 3 values around; on an edge it lies far away
                above, here, below = smooth[w - 1], smooth[w], smooth[w + 1]
                centre = np.float32(here[u])
                right, left = np.float32(here[u + 1]), np.float32(here[u - 1])
                down, up = np.float32(below[u]), np.float32(above[u])
                gx, gy = (right - left) * np.float32(0.5), (down - up) * np.float32(0.5)
                xx, yy = right - centre - centre + left, down - centre - centre + up
                xy = np.float32(0.25) * (
                    np.float32(below[u + 1])
                    - np.float32(below[u - 1])
                    - np.float32(above[u + 1])
                    + np.float32(above[u - 1])
                )
                determinant = xx * yy - xy * xy
                du, dv = xy * gy - yy * gx, xy * gx - xx * gy
                largest = np.float32(_MAX_SHIFT) * -determinant
                if determinant >= 0.0 or abs(du) > largest or abs(dv) > largest:
                    continue
                is_largest = True
                for k in range(-2, 3):
                    other = saddle[(w + k) % 5]
                    for i in range(u - 2, u + 3):
                        # of equal ones the first in reading order is taken
                        if other[i] > value or (other[i] == value and (k < 0 or (k == 0 and i < u))):
                            is_largest = False
                            break
                    if not is_largest:
                        break
                if is_largest:
                    if count < places.shape[0]:
                        du, dv = du / determinant, dv / determinant
                        places[count, 0] = np.float32(u) + du
                        places[count, 1] = np.float32(w) + dv
                        places[count, 2] = centre + np.float32(0.5) * (gx * du + gy * dv)
                    count += 1
    return count
