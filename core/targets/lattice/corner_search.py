"""Look for the corners of a lattice in the image, at known places and at those that their neighbours predict.

Each corner is looked at in the frame of its own lattice steps a and b: 6 x 6 samples p + x a + y b, |x|, |y| within
a part of a step. With s(t) = sign t a corner at (x₀, y₀) is f = c s(x - x₀) s(y - y₀), so over a square of half side
1 Σ f x = -2 y₀ (1 - x₀²) c, Σ f y = -2 x₀ (1 - y₀²) c and Σ f x y = (1 - x₀²)(1 - y₀²) c, up to one factor: the
ratios give the way to the corner. How much brighter the darker bright quadrant is than the brighter dark one (the
gap) distinguishes a corner of four squares from everything else, the end of the board included.
"""

from __future__ import annotations

import numpy as np

from core.jit import jit

_MAX_REACH_PX = 8.0  # beyond it uneven light does more harm than pixels do good
_SAMPLES = 6  # along either step
_LOOKS = 3
_GAIN = 0.42  # between ½ of sharp edges and ⅓ of blurred ones
_MAX_MOVE = 0.3  # steps, from where a corner was foreseen
_MAX_LAST_MOVE = 0.05
_MIN_GAP = 0.3  # of the gaps of its neighbours
_EVIDENCE = (8, 4, 1)  # three in a line count 4, two 2, a parallelogram 2, two neighbours on opposite sides 2
_BLOCK = 32  # columns that are looked at again together


@jit(
    "u1[:, ::1], f8, f8, f8, f8, f8, f8, f8, f8, f8[::1]",
    "u2[:, ::1], f8, f8, f8, f8, f8, f8, f8, f8, f8[::1]",
)
def _locate(
    image: np.ndarray,
    u: float,
    v: float,
    ax: float,
    ay: float,
    bx: float,
    by: float,
    sign: float,
    reach: float,
    found: np.ndarray,
) -> bool:
    """Write u, v, gap of the corner near (u, v) with steps a and b to `found`; return whether it is one.

    `sign` is 1 where the quadrant between a and b is bright, else -1; `reach` in steps.
    """
    height, width = image.shape
    a_length, b_length = np.hypot(ax, ay), np.hypot(bx, by)
    if not (a_length > 1.5 and b_length > 1.5 and np.isfinite(u) and np.isfinite(v)):
        return False
    a_reach, b_reach = min(reach, _MAX_REACH_PX / a_length), min(reach, _MAX_REACH_PX / b_length)
    moved_a, moved_b = 0.0, 0.0  # in steps
    quadrant = np.empty(4)
    move = 0.0
    for iteration in range(_LOOKS):
        part = 1.0 - iteration / (_LOOKS - 1)  # from the whole reach to the final one
        fa, fb = reach**part * a_reach ** (1.0 - part), reach**part * b_reach ** (1.0 - part)
        total_x, total_y, total_xy = 0.0, 0.0, 0.0
        quadrant[:] = 0.0
        for j in range(_SAMPLES):
            y = (2 * j + 1) / _SAMPLES - 1.0
            for i in range(_SAMPLES):
                x = (2 * i + 1) / _SAMPLES - 1.0
                p = u + x * fa * ax + y * fb * bx
                q = v + x * fa * ay + y * fb * by
                p = min(max(p, 0.0), width - 1.001)
                q = min(max(q, 0.0), height - 1.001)
                p0, q0 = int(p), int(q)
                fp, fq = p - p0, q - q0
                top = image[q0, p0] + fp * (float(image[q0, p0 + 1]) - float(image[q0, p0]))
                low = image[q0 + 1, p0] + fp * (float(image[q0 + 1, p0 + 1]) - float(image[q0 + 1, p0]))
                f = top + fq * (low - top)
                total_x += f * x
                total_y += f * y
                total_xy += f * x * y
                quadrant[(1 if x > 0.0 else 0) + (2 if y > 0.0 else 0)] += f
        if total_xy * sign <= 0.0:
            return False
        shift_x = min(max(-_GAIN * total_y / total_xy, -0.6), 0.6)
        shift_y = min(max(-_GAIN * total_x / total_xy, -0.6), 0.6)
        u += shift_x * fa * ax + shift_y * fb * bx
        v += shift_x * fa * ay + shift_y * fb * by
        moved_a += shift_x * fa
        moved_b += shift_y * fb
        move = max(abs(shift_x) * fa, abs(shift_y) * fb)
    if sign > 0.0:
        gap = min(quadrant[0], quadrant[3]) - max(quadrant[1], quadrant[2])
    else:
        gap = min(quadrant[1], quadrant[2]) - max(quadrant[0], quadrant[3])
    found[0], found[1], found[2] = u, v, gap * 4.0 / _SAMPLES**2
    inside = u >= 1.0 and v >= 1.0 and u <= width - 2.0 and v <= height - 2.0
    moved = max(abs(moved_a), abs(moved_b))
    return inside and gap > 0.0 and move < _MAX_LAST_MOVE and moved < _MAX_MOVE


@jit("f8[:, :, ::1], b1[:, ::1], i8, i8, i8, i8, f8[::1]")
def _step(grid: np.ndarray, known: np.ndarray, j: int, i: int, dj: int, di: int, step: np.ndarray) -> bool:
    """Write the step of the lattice at (j, i) toward (j + dj, i + di) to `step`; false where none is known."""
    rows, columns = known.shape
    count = 0
    step[0], step[1] = 0.0, 0.0
    if 0 <= j < rows and 0 <= i < columns and known[j, i]:
        for way in (1, -1):
            m, n = j + way * dj, i + way * di
            if 0 <= m < rows and 0 <= n < columns and known[m, n]:
                step[0] += way * (grid[m, n, 0] - grid[j, i, 0])
                step[1] += way * (grid[m, n, 1] - grid[j, i, 1])
                count += 1
    if count == 0:
        return False
    step[0] /= count
    step[1] /= count
    return True


@jit("f8[:, :, ::1], b1[:, ::1], i8, i8, i8, i8, f8[::1]")
def _step_around(
    grid: np.ndarray, known: np.ndarray, j: int, i: int, dj: int, di: int, step: np.ndarray
) -> bool:
    """As `_step`, from the lines on both sides where (j, i) itself has no neighbour."""
    if _step(grid, known, j, i, dj, di, step):
        return True
    count = 0
    u, v = 0.0, 0.0
    for way in (1, -1):
        if _step(grid, known, j + way * di, i + way * dj, dj, di, step):
            u += step[0]
            v += step[1]
            count += 1
    if count == 0:
        return False
    step[0], step[1] = u / count, v / count
    return True


@jit("u1[:, ::1], f8[:, :, ::1], f8[:, ::1], b1, f8", "u2[:, ::1], f8[:, :, ::1], f8[:, ::1], b1, f8")
def update_corners(
    image: np.ndarray, grid: np.ndarray, gap: np.ndarray, origin_is_bright: bool, reach: float
) -> None:
    """Move the corners of `grid` (rows, columns, 2) to where the image has them and write their gaps; those that the
    image does not show become NaN. In place."""
    rows, columns = gap.shape
    old = grid.copy()
    known = np.isfinite(old[:, :, 0])
    a, b, found = np.empty(2), np.empty(2), np.empty(3)
    for j in range(rows):
        for i in range(columns):
            if not known[j, i]:
                continue
            sign = 1.0 if ((i + j) % 2 == 0) == origin_is_bright else -1.0
            if (
                _step_around(old, known, j, i, 0, 1, a)
                and _step_around(old, known, j, i, 1, 0, b)
                and _locate(image, old[j, i, 0], old[j, i, 1], a[0], a[1], b[0], b[1], sign, reach, found)
            ):
                grid[j, i, 0], grid[j, i, 1], gap[j, i] = found[0], found[1], found[2]
            else:
                grid[j, i, 0], grid[j, i, 1], gap[j, i] = np.nan, np.nan, np.nan


@jit(
    "u1[:, ::1], f8[:, :, ::1], f8[:, ::1], b1, b1[:, ::1], b1[:, ::1], f8",
    "u2[:, ::1], f8[:, :, ::1], f8[:, ::1], b1, b1[:, ::1], b1[:, ::1], f8",
)
def grow(
    image: np.ndarray,
    grid: np.ndarray,
    gap: np.ndarray,
    origin_is_bright: bool,
    outside: np.ndarray,
    fresh: np.ndarray,
    reach: float,
) -> None:
    """Find further corners next to those of `grid` until there are no more within the arrays, in place.

    `outside` (rows, columns) receives which places next to known corners lie outside the image. `fresh` (rows, columns)
    says near which places to begin: elsewhere nothing has changed since the last call.
    """
    rows, columns = gap.shape
    height, width = image.shape
    known = np.isfinite(gap)
    tried = np.zeros((rows, columns), dtype=np.int64)
    a, b, found = np.empty(2), np.empty(2), np.empty(3)
    # where nothing changed nearby since the last look there is nothing new to find; times are counts of looks
    blocks = columns // _BLOCK + 1
    changed = np.full((rows, blocks), -1, dtype=np.int64)
    for j in range(rows):
        for i in range(columns):
            if fresh[j, i]:
                first, last = max(i - 3, 0) // _BLOCK, min(i + 3, columns - 1) // _BLOCK
                changed[max(j - 3, 0) : j + 4, first : last + 1] = 1
    for j in range(rows):
        for block in range(blocks):
            if changed[j, block] == 1:
                outside[j, block * _BLOCK : (block + 1) * _BLOCK] = False
    looked = np.zeros((len(_EVIDENCE), rows, blocks), dtype=np.int64)
    time = 1
    least = 0  # the best supported places first: a mistake would be the start of more
    while least < len(_EVIDENCE):
        more = False
        for part in range(rows * blocks):
            j, block = part // blocks, part % blocks
            if looked[least, j, block] > changed[j, block]:
                continue
            time += 1
            looked[: least + 1, j, block] = time
            for i in range(block * _BLOCK, min((block + 1) * _BLOCK, columns)):
                if known[j, i]:
                    continue
                u, v, weight, reference, neighbours = 0.0, 0.0, 0.0, 0.0, 0
                evidence = 0
                for direction in range(4):
                    dj = 1 if direction == 0 else -1 if direction == 1 else 0
                    di = 1 if direction == 2 else -1 if direction == 3 else 0
                    j1, i1 = j + dj, i + di
                    if not (0 <= j1 < rows and 0 <= i1 < columns and known[j1, i1]):
                        continue
                    neighbours += 1
                    reference += gap[j1, i1]
                    j2, i2, j3, i3 = j + 2 * dj, i + 2 * di, j + 3 * dj, i + 3 * di
                    if 0 <= j2 < rows and 0 <= i2 < columns and known[j2, i2]:
                        if 0 <= j3 < rows and 0 <= i3 < columns and known[j3, i3]:
                            u += 2.0 * (3.0 * grid[j1, i1, 0] - 3.0 * grid[j2, i2, 0] + grid[j3, i3, 0])
                            v += 2.0 * (3.0 * grid[j1, i1, 1] - 3.0 * grid[j2, i2, 1] + grid[j3, i3, 1])
                            weight += 2.0
                            evidence += 4
                        else:
                            u += 2.0 * grid[j1, i1, 0] - grid[j2, i2, 0]
                            v += 2.0 * grid[j1, i1, 1] - grid[j2, i2, 1]
                            weight += 1.0
                            evidence += 2
                    j4, i4 = j - dj, i - di
                    if 0 <= j4 < rows and 0 <= i4 < columns and known[j4, i4]:  # counted from both sides
                        u += 0.5 * (grid[j1, i1, 0] + grid[j4, i4, 0])
                        v += 0.5 * (grid[j1, i1, 1] + grid[j4, i4, 1])
                        weight += 1.0
                        evidence += 1
                    for way in (1, -1):
                        j5, i5 = j + way * di, i + way * dj
                        j6, i6 = j5 + dj, i5 + di
                        if not (
                            0 <= j5 < rows and 0 <= i5 < columns and 0 <= j6 < rows and 0 <= i6 < columns
                        ):
                            continue
                        if known[j5, i5] and known[j6, i6]:
                            u += 0.5 * (grid[j1, i1, 0] + grid[j5, i5, 0] - grid[j6, i6, 0])
                            v += 0.5 * (grid[j1, i1, 1] + grid[j5, i5, 1] - grid[j6, i6, 1])
                            weight += 0.5
                            evidence += 1
                if evidence < _EVIDENCE[least] or evidence == tried[j, i]:
                    continue
                tried[j, i] = evidence
                u /= weight
                v /= weight
                outside[j, i] = not (1.0 <= u <= width - 2.0 and 1.0 <= v <= height - 2.0)
                if outside[j, i]:
                    continue
                grid[j, i, 0], grid[j, i, 1] = u, v
                known[j, i] = True  # for the steps at the place foreseen
                has_steps = _step_around(grid, known, j, i, 0, 1, a) and _step_around(
                    grid, known, j, i, 1, 0, b
                )
                sign = 1.0 if ((i + j) % 2 == 0) == origin_is_bright else -1.0
                if (
                    has_steps
                    and _locate(image, u, v, a[0], a[1], b[0], b[1], sign, reach, found)
                    and found[2] > _MIN_GAP * reference / neighbours
                ):
                    grid[j, i, 0], grid[j, i, 1], gap[j, i] = found[0], found[1], found[2]
                    more = True
                    first, last = max(i - 3, 0) // _BLOCK, min(i + 3, columns - 1) // _BLOCK
                    changed[max(j - 3, 0) : j + 4, first : last + 1] = time
                else:
                    known[j, i] = False
                    grid[j, i, 0], grid[j, i, 1] = np.nan, np.nan
        least = 0 if more else least + 1
