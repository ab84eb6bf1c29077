"""Rings around a saddle point: whether it is a corner of four squares, and the directions of its edges.

On a ring around it such a corner shows four changes between dark and bright, opposite ones in one line. They are the
edges' directions, right at any tilt, where the Hessian's own are not.
"""

from __future__ import annotations

import numpy as np

from core.jit import jit

_RINGS_PX = (2.0, 3.5, 5.0)
_MAX_TURN = 0.45  # rad, of an edge from one ring to the next
_RING_SAMPLES = 32
CIRCLE = np.stack(
    [
        np.cos(2.0 * np.pi * np.arange(_RING_SAMPLES) / _RING_SAMPLES),
        np.sin(2.0 * np.pi * np.arange(_RING_SAMPLES) / _RING_SAMPLES),
    ],
    axis=1,
).astype(np.float32)
_MIN_BALANCE = 0.2  # of the strongest of the four sectors
_MAX_BEND = 0.7  # rad, between the two halves of an edge through a corner


@jit("f4[:, ::1], f4[:, ::1], f4[:, ::1], f8", "i2[:, ::1], f4[:, ::1], f4[:, ::1], f8")
def rings(
    smooth: np.ndarray, places: np.ndarray, circle: np.ndarray, least_sector: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return those of the places (n, 3) around which dark and bright alternate as around a corner of four squares.

    The larger the ring the truer the directions, as long as it meets no further corners: rings are looked at from the
    smallest on until one meets something else. Dark and bright are what is below and above the saddle's own
    grey; where no ring alternates about that, the middle of the ring's own (`centre_grey_values`).

    `circle` (samples, 2) unit vectors by growing angle. Returns points (n, 2), rays (n, 4, 2), contrast (n,), all
    float32, as in `Saddles`.
    """
    height, width = smooth.shape
    points = np.empty((places.shape[0], 2), dtype=np.float32)
    rays = np.empty((places.shape[0], 4, 2), dtype=np.float32)
    contrast = np.empty(places.shape[0], dtype=np.float32)
    samples = np.empty((len(_RINGS_PX), circle.shape[0]), dtype=np.float32)
    angles, best = np.empty(4, dtype=np.float32), np.empty(4, dtype=np.float32)
    reach = np.float32(_RINGS_PX[-1] + 1.0)
    count = 0
    for k in range(places.shape[0]):
        x, y, level = places[k, 0], places[k, 1], places[k, 2]
        if not (reach <= x < width - reach - 1 and reach <= y < height - reach - 1):
            continue
        kept = np.float32(0.0)
        for centred in (False, True):
            for n, radius in enumerate(_RINGS_PX):
                ring = samples[n]
                if centred:  # all three were sampled, and none alternates
                    changes = centre_grey_values(ring)
                else:
                    changes = sample_circle(smooth, x, y, np.float32(radius), level, circle, ring)
                apart = (
                    alternates_in_sign(ring, np.float32(least_sector), angles)
                    if changes == 4
                    else np.float32(0.0)
                )
                if kept > 0.0 and (apart == 0.0 or edge_turn(angles, best) > _MAX_TURN):
                    break
                if apart > 0.0:
                    kept = apart
                    for i in range(4):
                        best[i] = angles[i]
            if kept > 0.0:
                break
        if kept > 0.0:
            points[count, 0], points[count, 1] = x, y
            for i in range(4):
                rays[count, i, 0], rays[count, i, 1] = np.cos(best[i]), np.sin(best[i])
            contrast[count] = kept
            count += 1
    return points[:count], rays[:count], contrast[:count]


@jit("f4[::1], f4[::1]")
def edge_turn(angles: np.ndarray, others: np.ndarray) -> float:
    """Return the largest angle (rad) between the edges of two rings, whichever of its two ends an edge begins with."""
    largest = 0.0
    for i in range(2):
        difference = abs(angles[i] - others[i]) % np.pi
        largest = max(largest, min(difference, np.pi - difference))
    return largest


@jit("f4[:, ::1], f4, f4, f4, f4, f4[:, ::1], f4[::1]", "i2[:, ::1], f4, f4, f4, f4, f4[:, ::1], f4[::1]")
def sample_circle(
    smooth: np.ndarray,
    x: np.float32,
    y: np.float32,
    radius: np.float32,
    level: np.float32,
    circle: np.ndarray,
    ring: np.ndarray,
) -> int:
    """Write the grey values on a circle, less `level`, to `ring`; all of it must be in the image.

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


@jit("f4[::1]")
def centre_grey_values(ring: np.ndarray) -> int:
    """Take from a ring's grey values the mean of the brightest and the darkest.

    Squares of one colour that run together in spread ink, or in white that is cut off, leave their own grey where
    the corner is, and the rest of the ring lies on one side of it. Returns as `sample_circle` does.
    """
    low, high = ring[0], ring[0]
    for value in ring:
        low, high = min(low, value), max(high, value)
    middle = np.float32(0.5) * (low + high)
    changes, was_bright = 0, ring[-1] >= middle
    for i in range(ring.shape[0]):
        ring[i] -= middle
        is_bright = ring[i] >= 0.0
        changes += is_bright != was_bright
        was_bright = is_bright
    return changes


@jit("f4[::1], f4, f4[::1]")
def alternates_in_sign(ring: np.ndarray, least_sector: np.float32, angles: np.ndarray) -> np.float32:
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
    if weakest < least_sector or weakest < _MIN_BALANCE * strongest:
        return np.float32(0.0)
    straight = np.float32(np.pi)
    if abs(angles[2] - angles[0] - straight) > _MAX_BEND:
        return np.float32(0.0)
    if abs(angles[3] - angles[1] - straight) > _MAX_BEND:
        return np.float32(0.0)
    return np.float32(0.5) * total
