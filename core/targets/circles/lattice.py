"""From dots to the lattice they stand on.

A dot is a circle, so its own ellipse determines how the target plane is foreshortened there, up to a turn: lengths
divided by it, in radii of a dot, are as on the print. There a dot's neighbours in a square lattice stand at one
distance, in four directions a right angle apart. From the most regular dot a lattice grows step by step, each next
place predicted by the last step.

What lies across a board cuts its lattice in two. Dots beyond the gap are found from the
whole lattice (`merge_lattices`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from core.geometry import find_homography, map_in_front
from core.jit import jit
from core.targets.circles.blobs import Dots

_CANDIDATES = 12  # nearest dots looked at
_MAX_NEIGHBOUR_RADII = 8.0  # radii from dot to dot
_UNEVEN = 0.3  # by how much opposite or neighbouring steps may differ, of a step
_LARGER = 1.9  # of two neighbours' areas, seen or on the print
_MARKED = 6.0  # of an area, where one dot is larger to mark the origin
_OFF = 0.25  # of a step: how far from its predicted place a dot may be
_MIN_DOTS = 6  # dots
_MAX_LINES = 510  # to either side of a seed
_FAR_PX = -1e9
_ACROSS = 3  # lines, from a lattice's dots to those beyond a gap
_JOINS = 0.75  # of a lattice's dots, on places of another: they are one


@dataclass(frozen=True, slots=True)
class DotLattice:
    """Dots of one lattice: which ones (indices into `Dots`), and their places (p, q); steps p then q turn toward +v of
    the image, as x and y do seen from the front."""

    dots: Int[np.ndarray, " n"]
    places: Int[np.ndarray, "n 2"]


def dot_lattices(dots: Dots) -> list[DotLattice]:
    """Return the lattices that an image's dots make, the largest first."""
    if len(dots) < _MIN_DOTS:
        return []
    near = _neighbours(dots)
    steps, irregular = crosses(dots.centres, dots.moments, near)
    seeds = np.lexsort((np.arange(len(dots)), irregular))
    seeds = seeds[np.isfinite(irregular[seeds])]
    root = np.sqrt(np.linalg.det(dots.moments))
    order, places, lengths = grown(seeds, steps, dots.centres, root, near)
    ends = np.cumsum(lengths)
    lattices = [
        DotLattice(order[end - length : end], places[end - length : end])
        for length, end in zip(lengths.tolist(), ends.tolist(), strict=True)
        if length >= _MIN_DOTS
    ]
    return sorted(lattices, key=lambda lattice: -len(lattice.dots))


def merge_lattices(
    lattice: DotLattice, others: Sequence[DotLattice], dots: Dots, most_dots: int
) -> DotLattice:
    """Return a lattice with those of the others that stand on its places beyond gaps of a few lines; one of `most_dots`
    or more grows no further.

    Single dots are not taken: about a board there are always some that look like one more of its own. A place is
    predicted by the homography of all dots, corrected by what that is off at the lattice's nearest one: over a few
    lines a lens bends little more. A dot that is much larger, as at the origin, comes with the others of its lattice.
    """
    which, places = lattice.dots, lattice.places
    theirs = np.concatenate([which[:0], *(other.dots for other in others)])
    of_other = np.repeat(np.arange(len(others)), [len(other.dots) for other in others])
    free = theirs
    root = np.sqrt(np.linalg.det(dots.moments))
    larger = np.full(len(dots), _LARGER)
    for other in others:
        larger[other.dots] = _LARGER if len(other.dots) == 1 else _MARKED
    while len(free) and len(which) < most_dots:
        centres = dots.centres[which]
        H = find_homography(places.astype(np.float64), centres)
        if H is None:
            break
        wanted = _empty_places_around(places)
        _, nearest = cKDTree(places).query(wanted)
        drawn, right, below = (
            map_in_front(H, wanted + shift) for shift in np.array([[0, 0], [1, 0], [0, 1]])
        )
        at = drawn + centres[nearest] - map_in_front(H, places[nearest])
        step = np.minimum(np.hypot(*(right - drawn).T), np.hypot(*(below - drawn).T))
        off, candidate = cKDTree(dots.centres[free]).query(np.nan_to_num(at, nan=_FAR_PX))
        ratio, most = root[free[candidate]] / root[which[nearest]], larger[free[candidate]]
        fits = (off <= _OFF * step) & (ratio < most) & (ratio > 1.0 / most)
        best = np.flatnonzero(fits)[np.argsort(off[fits], kind="stable")]
        _, first = np.unique(candidate[best], return_index=True)  # a dot stands on one place
        best = best[first]
        if len(best) == 0:
            break
        which = np.concatenate([which, free[candidate[best]]])
        places = np.concatenate([places, wanted[best]])
        free = np.delete(free, candidate[best])
    taken = np.isin(theirs, which)
    size_of, taken_of = (np.bincount(of_other[mark], minlength=len(others)) for mark in (slice(None), taken))
    joined = theirs[(taken_of >= _JOINS * size_of)[of_other]]
    kept = np.isin(which, lattice.dots) | np.isin(which, joined)
    return DotLattice(which[kept], places[kept])


def _empty_places_around(places: Int[np.ndarray, "n 2"]) -> Int[np.ndarray, "k 2"]:
    """Return the places without a dot that a few lines part from one with a dot, in order."""
    first = places.min(axis=0) - _ACROSS
    is_taken = np.zeros(np.ptp(places, axis=0) + 1 + 2 * _ACROSS, dtype=np.uint8)
    is_taken[tuple((places - first).T)] = 1
    side = 2 * _ACROSS + 1
    around = cv2.dilate(is_taken, np.ones((side, side), dtype=np.uint8))
    return np.argwhere(around > is_taken) + first


def with_single_dots(lattice: DotLattice, dots: Dots, most_dots: int) -> DotLattice:
    """Return a lattice with all dots that stand on its places beyond gaps, as `merge_lattices` has them: a line or two
    of dots beyond a gap make no lattice of their own. Some of them may be none of the board's."""
    others = np.setdiff1d(np.arange(len(dots)), lattice.dots)
    return merge_lattices(
        lattice,
        [DotLattice(others[n : n + 1], np.zeros((1, 2), dtype=np.intp)) for n in range(len(others))],
        dots,
        most_dots,
    )


def _neighbours(dots: Dots) -> Int[np.ndarray, "n k"]:
    """Return the dots nearest to each, nearest first."""
    count = min(2 * _CANDIDATES + 1, len(dots))
    _, found = cKDTree(dots.centres).query(dots.centres, k=count)
    return np.ascontiguousarray(found[:, 1:], dtype=np.intp)


@jit("f8[:, ::1], f8[:, :, ::1], i8[:, ::1]")
def crosses(
    centres: Float[np.ndarray, "n 2"], moments: Float[np.ndarray, "n 2 2"], near: Int[np.ndarray, "n k"]
) -> tuple[Float[np.ndarray, "n 2 2"], Float[np.ndarray, " n"]]:
    """Return the steps along p and q (px, as rows) around each dot, and how irregular its four neighbours stand, in
    steps; infinite where it has none such."""
    count, most = near.shape
    steps, irregular = np.zeros((count, 2, 2)), np.full(count, np.inf)
    root = np.empty(count)
    for n in range(count):
        root[n] = 4.0 * math.sqrt(moments[n, 0, 0] * moments[n, 1, 1] - moments[n, 0, 1] ** 2)
    flat, step, length = np.empty((most, 2)), np.empty((most, 2)), np.empty(most)
    for n in range(count):
        # W = C^(-1/2) of C = 4 moments: |W d| in radii of the dot; √C = (C + √det) / √(trace + 2 √det)
        a, b, c = 4.0 * moments[n, 0, 0], 4.0 * moments[n, 0, 1], 4.0 * moments[n, 1, 1]
        norm = math.sqrt(a + c + 2.0 * root[n])
        a, b, c = (a + root[n]) / norm, b / norm, (c + root[n]) / norm
        determinant = a * c - b * b
        held = 0
        for k in range(most):
            other = near[n, k]
            ratio = root[other] / root[n]
            if ratio > _LARGER or ratio < 1.0 / _LARGER:
                continue
            u, v = centres[other, 0] - centres[n, 0], centres[other, 1] - centres[n, 1]
            x, y = (c * u - b * v) / determinant, (a * v - b * u) / determinant
            away = math.hypot(x, y)
            if away > _MAX_NEIGHBOUR_RADII:
                continue
            at = held  # sorted by distance, the first of equals first
            while at > 0 and length[at - 1] > away:
                length[at], flat[at], step[at] = length[at - 1], flat[at - 1], step[at - 1]
                at -= 1
            length[at] = away
            flat[at, 0], flat[at, 1], step[at, 0], step[at, 1] = x, y, u, v
            held += 1
        held = min(held, _CANDIDATES)
        if held == 0:
            continue
        x, y = flat[0, 0], flat[0, 1]
        uneven = 0.0
        for turn in range(4):
            best, least = 0, math.inf
            for k in range(held):
                off = math.hypot(flat[k, 0] - x, flat[k, 1] - y)
                if off < least:
                    best, least = k, off
            least /= length[0]
            uneven += least if least <= _UNEVEN else math.inf
            sense = 0.5 if turn < 2 else -0.5
            steps[n, turn % 2, 0] += sense * step[best, 0]
            steps[n, turn % 2, 1] += sense * step[best, 1]
            x, y = -y, x
        irregular[n] = uneven
    return steps, irregular


@jit("i8[::1], f8[:, :, ::1], f8[:, ::1], f8[::1], i8[:, ::1]")
def grown(
    seeds: Int[np.ndarray, " m"],
    steps: Float[np.ndarray, "n 2 2"],
    centres: Float[np.ndarray, "n 2"],
    root: Float[np.ndarray, " n"],
    near: Int[np.ndarray, "n k"],
) -> tuple[Int[np.ndarray, " l"], Int[np.ndarray, "l 2"], Int[np.ndarray, " k"]]:
    """Grow a lattice from each seed in turn that is in none yet.

    Returns the dots, lattice after lattice, their places, and how many each lattice has.
    """
    count = len(centres)
    order, places = np.empty(count, dtype=np.int64), np.empty((count, 2), dtype=np.int64)
    local = np.empty((count, 2, 2))
    lengths = np.empty(count, dtype=np.int64)
    free = np.ones(count, dtype=np.bool_)
    half = min(count, _MAX_LINES)
    at = np.zeros((2 * half + 1, 2 * half + 1), dtype=np.bool_)
    done, lattices = 0, 0
    for seed in seeds:
        if not free[seed]:
            continue
        first, end = done, done + 1
        order[first], local[first], free[seed] = seed, steps[seed], False
        places[first, 0], places[first, 1] = 0, 0
        at[half, half] = True
        while done < end:
            dot, p, q = order[done], places[done, 0], places[done, 1]
            for way in range(4):
                axis, sense = way % 2, 1 if way < 2 else -1
                p_next, q_next = p + (sense if axis == 0 else 0), q + (sense if axis == 1 else 0)
                if max(abs(p_next), abs(q_next)) > half or at[q_next + half, p_next + half]:
                    continue
                u, v = sense * local[done, axis, 0], sense * local[done, axis, 1]
                best, least = -1, _OFF * math.hypot(u, v)
                for other in near[dot]:
                    ratio = root[other] / root[dot]
                    if not free[other] or not 1.0 / _MARKED < ratio < _MARKED:
                        continue
                    du, dv = centres[other, 0] - centres[dot, 0], centres[other, 1] - centres[dot, 1]
                    off = math.hypot(du - u, dv - v)
                    if off <= least:
                        best, least = other, off
                if best < 0:
                    continue
                order[end], places[end, 0], places[end, 1], free[best] = best, p_next, q_next, False
                local[end] = local[done]
                local[end, axis, 0] = sense * (centres[best, 0] - centres[dot, 0])
                local[end, axis, 1] = sense * (centres[best, 1] - centres[dot, 1])
                at[q_next + half, p_next + half] = True
                end += 1
            done += 1
        for k in range(first, end):
            at[places[k, 1] + half, places[k, 0] + half] = False
        lengths[lattices] = end - first
        lattices += 1
    return order[:done], places[:done], lengths[:lattices]
