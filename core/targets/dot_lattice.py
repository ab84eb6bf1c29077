"""From dots to the lattice they stand on.

A dot is a circle, so its own ellipse tells how the target plane is foreshortened there, but for a turn: lengths divided
by it, in radii of a dot, are as on the print. There a dot's neighbours in a square lattice stand at one distance, in
four directions a right angle apart. From the most regular dot a lattice grows step by step, each next place predicted
by the last step.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from core.targets.dots import Dots

_CANDIDATES = 12  # nearest dots looked at
_FURTHEST = 8.0  # radii from dot to dot
_UNEVEN = 0.3  # by how much opposite or neighbouring steps may differ, of a step
_LARGER = 1.9  # of two neighbours' areas, seen or on the print
_MARKED = 6.0  # of an area, where one dot is larger to mark the origin
_OFF = 0.25  # of a step: how far from its predicted place a dot may be
_LEAST = 6  # dots


@dataclass(frozen=True, slots=True)
class DotLattice:
    """Dots of one lattice: which ones (indices into `Dots`), and their places (p, q); steps p then q turn toward +v of
    the picture, as x and y do seen from the front."""

    dots: Int[np.ndarray, " n"]
    places: Int[np.ndarray, "n 2"]


def dot_lattices(dots: Dots) -> list[DotLattice]:
    """Return the lattices that a picture's dots make, the largest first."""
    if len(dots) < _LEAST:
        return []
    near = _neighbours(dots)
    steps, irregular = _crosses(dots, near)
    free = np.ones(len(dots), dtype=np.bool_)
    lattices = []
    for seed in np.lexsort((np.arange(len(dots)), irregular)).tolist():
        if not np.isfinite(irregular[seed]):
            break
        if free[seed]:
            lattice = _grow(seed, steps[seed], dots, near, free)
            if len(lattice.dots) >= _LEAST:
                lattices.append(lattice)
    return sorted(lattices, key=lambda lattice: -len(lattice.dots))


def _neighbours(dots: Dots) -> Int[np.ndarray, "n k"]:
    """Return the dots nearest to each, nearest first."""
    count = min(2 * _CANDIDATES + 1, len(dots))
    _, found = cKDTree(dots.centres).query(dots.centres, k=count)
    return np.asarray(found[:, 1:], dtype=np.intp)


def _crosses(
    dots: Dots, near: Int[np.ndarray, "n k"]
) -> tuple[Float[np.ndarray, "n 2 2"], Float[np.ndarray, " n"]]:
    """Return the steps along p and q (px, as rows) around each dot, and how irregular its four neighbours stand, in
    steps; infinite where it has none such."""
    values, vectors = np.linalg.eigh(4.0 * dots.moments)
    W = np.einsum("nij,nj,nkj->nik", vectors, 1.0 / np.sqrt(values), vectors)  # |W d| in radii of the dot
    root = np.sqrt(np.prod(values, axis=1))
    steps = dots.centres[near] - dots.centres[:, None, :]
    flat = np.einsum("nij,nkj->nki", W, steps)
    length = np.hypot(flat[..., 0], flat[..., 1])
    ratio = root[near] / root[:, None]
    length[(ratio > _LARGER) | (ratio < 1.0 / _LARGER) | (length > _FURTHEST)] = np.inf
    order = np.argsort(length, axis=1, kind="stable")[:, :_CANDIDATES]
    length = np.take_along_axis(length, order, axis=1)
    flat, steps = (np.take_along_axis(a, order[..., None], axis=1) for a in (flat, steps))
    irregular = np.where(np.isfinite(length[:, 0]), 0.0, np.inf)
    unit = np.where(np.isfinite(length[:, 0]), length[:, 0], 1.0)
    chosen = []
    wanted = flat[:, 0]
    for _ in range(4):
        off = np.hypot(*np.moveaxis(flat - wanted[:, None, :], 2, 0))
        off[~np.isfinite(length)] = np.inf
        best = np.argmin(off, axis=1)
        least = np.take_along_axis(off, best[:, None], axis=1)[:, 0] / unit
        irregular += np.where(least <= _UNEVEN, least, np.inf)
        chosen.append(np.take_along_axis(steps, best[:, None, None], axis=1)[:, 0])
        wanted = np.stack([-wanted[:, 1], wanted[:, 0]], axis=1)
    right, down, left, up = chosen
    return np.stack([(right - left) / 2.0, (down - up) / 2.0], axis=1), irregular


def _grow(
    seed: int,
    steps: Float[np.ndarray, "2 2"],
    dots: Dots,
    near: Int[np.ndarray, "n k"],
    free: Bool[np.ndarray, " n"],
) -> DotLattice:
    """Grow a lattice from a dot with known steps; its dots are no longer free afterwards."""
    root = np.sqrt(np.linalg.det(dots.moments))
    at: dict[tuple[int, int], int] = {(0, 0): seed}
    local: dict[tuple[int, int], Float[np.ndarray, "2 2"]] = {(0, 0): steps}
    queue = deque([(0, 0)])
    free[seed] = False
    while queue:
        place = queue.popleft()
        dot, basis = at[place], local[place]
        around = near[dot]
        ratio = root[around] / root[dot]
        around = around[free[around] & (ratio < _MARKED) & (ratio > 1.0 / _MARKED)]
        taken = dots.centres[around] - dots.centres[dot]
        for axis, sense in ((0, 1), (1, 1), (0, -1), (1, -1)):
            nxt = (place[0] + sense, place[1]) if axis == 0 else (place[0], place[1] + sense)
            if nxt in at or len(around) == 0:
                continue
            step = sense * basis[axis]
            off = np.hypot(*(taken - step).T)
            best = int(np.argmin(off))
            n = int(around[best])
            if off[best] > _OFF * np.hypot(*step) or not free[n]:
                continue
            free[n] = False
            at[nxt] = n
            local[nxt] = basis.copy()
            local[nxt][axis] = sense * taken[best]
            queue.append(nxt)
    return DotLattice(np.array(list(at.values()), dtype=np.intp), np.array(list(at), dtype=np.intp))
