"""Points of a picture that look like the corner of four squares, and how its edges run.

1. Where two edges cross the grey values f form a saddle: f_xy² - f_xx f_yy, which no turn of the axes changes, is
   positive and largest there; it is zero along straight edges and negative on blobs (P. R. Beaudet,
   "Rotationally invariant image operators", ICPR 1978). Its local maxima well above the noise are looked at.
2. On a ring around such a point a corner of four squares shows four changes between dark and bright, opposite
   ones in one line. They are the edges' directions, right at any tilt, where the Hessian's own are not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, Shaped

from core.compiled import compiled
from core.targets.pyramid import Level
from core.targets.quantiles import quantiles

_BINOMIAL = np.array([1.0, 2.0, 1.0], dtype=np.float32)
_SCALE = 16.0  # times the grey values: smoothing is kept in whole numbers, unrounded
_LEAST_NOISE = 3.0  # of the mixed derivative, from the rounding to whole levels alone
_NOISE_QUANTILE, _NOISE_DEVIATES = 0.4, 0.5244  # |z| of a normal deviate z is below the latter in that share
_STRONG_QUANTILE, _MOST_OF_STRONG = 0.99, 0.08
"""Where squares fill the picture no part of it is calm: noise is taken as no more than this part of what is strong."""
_NOISE_SAMPLES = 2_000
_LEAST_SADDLE = 4.0  # standard deviations of the noise
_LEAST_SECTOR = 2.0  # standard deviations of the smoothed picture's noise
_MOST_SADDLES = 1 << 17
_RINGS_PX = (2.0, 3.5, 5.0)
_LARGEST_TURN = 0.45  # rad, of an edge from one ring to the next
_RING_SAMPLES = 32
_CIRCLE = np.stack(
    [
        np.cos(2.0 * np.pi * np.arange(_RING_SAMPLES) / _RING_SAMPLES),
        np.sin(2.0 * np.pi * np.arange(_RING_SAMPLES) / _RING_SAMPLES),
    ],
    axis=1,
).astype(np.float32)
_LEAST_ROUND = 0.3
"""Least f_xy² - f_xx f_yy, of (f_xx + f_yy)²: ¼ tan² of the angle between the saddle's lines of equal grey. Blurred as
they are, edges that cross at 28° still have .8."""
_LARGEST_SHIFT = 1.3  # px, from the maximum to the saddle itself
_LEAST_BALANCE = 0.2  # of the strongest of the four sectors
_LARGEST_BEND = 0.7  # rad, between the two halves of an edge through a corner
_BORDER = 5
_BLOCK = 32


@dataclass(frozen=True, slots=True)
class Saddles:
    """Candidates for corners on one level.

    `points` (n, 2) in the level's pixels; `rays` (n, 4, 2) unit vectors along the four edges by growing angle (from u
    to v); after rays 0 and 2 a bright square follows, after 1 and 3 a dark one; `contrast` (n,) between bright and
    dark on the ring, in the units of `smooth`, the smoothed picture it was measured in.
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
    noise = mixed_derivative_noise(smooth)
    least = (_LEAST_SADDLE * noise) ** 2
    places = np.empty((_MOST_SADDLES, 3), dtype=np.float32)
    count = saddle_points(smooth, np.float32(least), places)
    while (
        count > _MOST_SADDLES
    ):  # a picture all of texture: the stronger ones, or the first where all are alike
        fewer = saddle_points(smooth, np.float32(4.0 * least), places)
        if fewer < _MOST_SADDLES // 8:
            saddle_points(smooth, np.float32(least), places)
            break
        least, count = 4.0 * least, fewer
    count = min(count, _MOST_SADDLES)
    # the mixed derivative is a sum of four values hardly related, so twice as noisy as one
    points, rays, contrast = rings(smooth, places[:count], _CIRCLE, 0.5 * noise * _LEAST_SECTOR)
    return Saddles(points, rays, contrast, smooth)


def mixed_derivative_noise(smooth: Shaped[np.ndarray, "h w"]) -> float:
    """Return the standard deviation of noise in the mixed derivative as `saddle_points` takes it, from the calmer
    part of the picture."""
    height, width = smooth.shape
    if min(height, width) < 3:
        return _LEAST_NOISE
    step = max(1, math.isqrt(height * width // _NOISE_SAMPLES))
    calm, strong = quantiles(mixed_derivatives(smooth, step), (_NOISE_QUANTILE, _STRONG_QUANTILE))
    return max(min(calm / _NOISE_DEVIATES, _MOST_OF_STRONG * strong), _LEAST_NOISE)


@compiled
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


@compiled
def saddle_points(smooth: np.ndarray, floor: np.float32, places: np.ndarray) -> int:
    """Write the local maxima, within 5 x 5 pixels, of f_xy² - f_xx f_yy above `floor` to `places` (n, 3).

    It counts as 0 where it is less than _LEAST_ROUND (f_xx + f_yy)². Derivatives are 4 f_xy = sum over (±1, ±1) with
    signs and 4 f_xx = f(+2) - 2 f + f(-2). A place is u, v of the saddle of the quadratic there, and its value. Returns
    how many there are, those without a place included.
    """
    height, width = smooth.shape
    if height < 2 * _BORDER + 1 or width < 2 * _BORDER + 1:
        return 0
    saddle = np.zeros((5, width), dtype=np.float32)  # of the last five rows
    count = 0
    inner = width - 4
    round_enough, none = np.float32(_LEAST_ROUND), np.float32(0.0)
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
                largest = np.float32(_LARGEST_SHIFT) * -determinant
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


@compiled
def rings(
    smooth: np.ndarray, places: np.ndarray, circle: np.ndarray, least_sector: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return those of the places (n, 3) around which dark and bright alternate as around a corner of four squares.

    The larger the ring the truer the directions, as long as it meets no further corners: rings are looked at from the
    smallest on until one tells of something else.

    `circle` (samples, 2) unit vectors by growing angle. Returns points (n, 2), rays (n, 4, 2), contrast (n,), all
    float32, as in `Saddles`.
    """
    height, width = smooth.shape
    points = np.empty((places.shape[0], 2), dtype=np.float32)
    rays = np.empty((places.shape[0], 4, 2), dtype=np.float32)
    contrast = np.empty(places.shape[0], dtype=np.float32)
    ring = np.empty(circle.shape[0], dtype=np.float32)
    angles, best = np.empty(4, dtype=np.float32), np.empty(4, dtype=np.float32)
    reach = np.float32(_RINGS_PX[-1] + 1.0)
    count = 0
    for k in range(places.shape[0]):
        x, y, level = places[k, 0], places[k, 1], places[k, 2]
        if not (reach <= x < width - reach - 1 and reach <= y < height - reach - 1):
            continue
        kept = np.float32(0.0)
        for radius in _RINGS_PX:
            changes = look_around(smooth, x, y, np.float32(radius), level, circle, ring)
            apart = alternates(ring, np.float32(least_sector), angles) if changes == 4 else np.float32(0.0)
            if kept > 0.0 and (apart == 0.0 or turned(angles, best) > _LARGEST_TURN):
                break
            if apart > 0.0:
                kept = apart
                best[:] = angles
        if kept > 0.0:
            points[count, 0], points[count, 1] = x, y
            for i in range(4):
                rays[count, i, 0], rays[count, i, 1] = np.cos(best[i]), np.sin(best[i])
            contrast[count] = kept
            count += 1
    return points[:count], rays[:count], contrast[:count]


@compiled
def turned(angles: np.ndarray, others: np.ndarray) -> float:
    """Return the largest angle (rad) between the edges of two rings, whichever of its two ends an edge begins with."""
    largest = 0.0
    for i in range(2):
        difference = abs(angles[i] - others[i]) % np.pi
        largest = max(largest, min(difference, np.pi - difference))
    return largest


@compiled
def look_around(
    smooth: np.ndarray,
    x: np.float32,
    y: np.float32,
    radius: np.float32,
    level: np.float32,
    circle: np.ndarray,
    ring: np.ndarray,
) -> int:
    """Write the grey values on a circle, less `level`, to `ring`; all of it must be in the picture.

    Returns how often they change between dark and bright.
    """
    flat, to_below = smooth.reshape(-1), np.uint32(smooth.shape[1])
    changes, was_bright = 0, False
    for i in range(circle.shape[0]):
        a, b = x + radius * circle[i, 0], y + radius * circle[i, 1]
        i0, j0 = np.uint32(a), np.uint32(b)
        fa, fb = a - np.float32(i0), b - np.float32(j0)
        here = np.uint32(j0 * to_below + i0)  # unsigned: no index counts from the end
        below = np.uint32(here + to_below)
        above_left, above_right = np.float32(flat[here]), np.float32(flat[here + np.uint32(1)])
        below_left, below_right = np.float32(flat[below]), np.float32(flat[below + np.uint32(1)])
        upper = above_left + fa * (above_right - above_left)
        lower = below_left + fa * (below_right - below_left)
        value = upper + fb * (lower - upper) - level
        is_bright = value >= 0.0
        changes += is_bright != was_bright
        was_bright = is_bright
        ring[i] = value
    begins_bright = ring[0] >= 0.0  # which was compared with dark instead of with the last
    return changes - begins_bright + (begins_bright != was_bright)


@compiled
def alternates(ring: np.ndarray, least_sector: np.float32, angles: np.ndarray) -> np.float32:
    """Return how far bright and dark are apart on a ring of four changes, 0 where it shows no corner of four squares.

    Writes where the grey values change, by growing angle, to `angles` (4,); bright follows on the first.
    """
    samples = ring.shape[0]
    first = samples - 1
    while ring[first] < 0.0 or ring[first - 1 if first > 0 else samples - 1] >= 0.0:
        first -= 1
    step_angle = np.float32(2.0 * np.pi / samples)
    weakest, total = np.float32(np.inf), np.float32(0.0)
    strongest, peak = np.float32(0.0), np.float32(0.0)
    n = 0
    for step in range(samples + 1):
        i = (first + step) % samples
        here, before = ring[i], ring[i - 1 if i > 0 else samples - 1]
        if (here >= 0.0) != (before >= 0.0):
            if n > 0:
                weakest, strongest = min(weakest, peak), max(strongest, peak)
                total += peak
                peak = np.float32(0.0)
            if n < 4:
                angles[n] = step_angle * (np.float32(first + step) - here / (here - before))
                n += 1
        peak = max(peak, abs(here))
    if weakest < least_sector or weakest < _LEAST_BALANCE * strongest:
        return np.float32(0.0)
    straight = np.float32(np.pi)
    if abs(angles[2] - angles[0] - straight) > _LARGEST_BEND:
        return np.float32(0.0)
    if abs(angles[3] - angles[1] - straight) > _LARGEST_BEND:
        return np.float32(0.0)
    return np.float32(0.5) * total
