"""From corners that stand alone to patches of a lattice.

Two corners are neighbours if an edge of each points at the other, if dark and bright lie on the same sides of it all
the way, and if neither has a nearer such neighbour on that edge. Seen from its two ends an edge has bright on
opposite hands, so every link joins an even ray (bright follows) to an odd one, and the colours of a patch alternate
by construction. Patches grow along the links from the corners with most of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Int

from core.jit import jit
from core.targets.lattice.saddle_points import Saddles

MIN_COSINE = 0.92  # of the angle between a ray and the way to the neighbour: 23°
_MAX_RATIO = 4.0  # of two neighbours' contrasts
_MIN_EDGE = 0.25  # of the lesser contrast: what is left of it along the edge
EDGE_SIDE_OFFSET = 0.15  # of an edge's length: where its two sides are sampled
_LOOKS = 5  # places along an edge
_MAX_VISITED = 80  # corners no fainter, nearer than the neighbour, that do not belong to the board
_PER_CELL = 0.5


@dataclass(frozen=True, slots=True)
class Patches:
    """Links between corners, and the patches of lattice that they make.

    `links` (n, 4): the corner at the other end of each ray, -1 without; `patch` (n,) which patch a corner belongs to,
    largest first, -1 for none; `place` (n, 2) its column and row there, in a right-handed order in which the square
    between (0, 0) and (1, 1) is bright.
    """

    links: Int[np.ndarray, "n 4"]
    patch: Int[np.ndarray, " n"]
    place: Int[np.ndarray, "n 2"]
    sizes: Int[np.ndarray, " patches"]


def link(
    saddles: Saddles, side_offset: float = EDGE_SIDE_OFFSET, least_cosine: float = MIN_COSINE
) -> Patches:
    """Return the patches of lattice among a level's corners.

    `side_offset` is how far from an edge its two sides are sampled, in edge lengths: less where squares hold print.
    `least_cosine` is that of the angle between an edge and the way to the neighbour: more where print has corners, too.
    """
    count = len(saddles)
    height, width = saddles.smooth.shape
    cell = max(4.0, math.sqrt(_PER_CELL * height * width / max(count, 1)))
    across, down = int(width / cell) + 1, int(height / cell) + 1
    cells, order, starts = into_cells(saddles.points, np.float32(cell), across, down)
    links = neighbours(
        saddles.points,
        saddles.rays,
        saddles.contrast,
        saddles.smooth,
        cells,
        order,
        starts,
        across,
        down,
        cell,
        side_offset,
        np.float32(least_cosine),
    )
    return Patches(links, *spread(links))


@jit("f4[:, ::1], f4, i8, i8")
def into_cells(
    points: np.ndarray, cell: np.float32, across: int, down: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return each point's cell (n, 2) column and row, the points in the order of their cells (row by row), and where in
    that order each cell begins; the last entry is its end.
    """
    count = points.shape[0]
    cells = np.empty((count, 2), dtype=np.int64)
    starts = np.zeros(across * down + 1, dtype=np.int64)
    for p in range(count):
        cells[p, 0], cells[p, 1] = int(points[p, 0] / cell), int(points[p, 1] / cell)
        starts[cells[p, 1] * across + cells[p, 0] + 1] += 1
    for k in range(across * down):
        starts[k + 1] += starts[k]
    order, ends = np.empty(count, dtype=np.int64), starts[:-1].copy()
    for p in range(count):
        k = cells[p, 1] * across + cells[p, 0]
        order[ends[k]] = p
        ends[k] += 1
    return cells, order, starts


@jit(
    "f4[:, ::1], f4[:, :, ::1], f4[::1], f4[:, ::1], i8[:, ::1], i8[::1], i8[::1], i8, i8, f8, f8, f4",
    "f4[:, ::1], f4[:, :, ::1], f4[::1], i2[:, ::1], i8[:, ::1], i8[::1], i8[::1], i8, i8, f8, f8, f4",
)
def neighbours(
    points: np.ndarray,
    rays: np.ndarray,
    contrast: np.ndarray,
    smooth: np.ndarray,
    cells: np.ndarray,
    order: np.ndarray,
    starts: np.ndarray,
    across: int,
    down: int,
    cell: float,
    side_offset: float,
    least_cosine: np.float32,
) -> np.ndarray:
    """Return links (n, 4): for each ray the index of the corner that it and a ray of that corner agree on, or -1.

    Only links that are a side of a closed cell of four count: one that skips an undetected corner is rejected.
    `side_offset` and `least_cosine` as in `link`.

    `order` lists the corners by cell (a square of `cell` pixels, row by row), `starts` where each cell's begin.
    """
    count = points.shape[0]
    height, width = smooth.shape
    best = np.full((count, 4), -1, dtype=np.int64)
    arrives = np.zeros((count, 4), dtype=np.int64)
    cost = np.empty(4, dtype=np.float32)
    for p in range(count):
        cost[:] = np.float32(np.inf)
        farthest = np.float32(np.inf)
        x, y = points[p, 0], points[p, 1]
        own = rays[p]
        column, row = cells[p, 0], cells[p, 1]
        visited = 0
        reach = 0
        while reach <= max(across, down) and visited < _MAX_VISITED:
            if farthest < (reach - 1) * cell:
                break
            for r in range(max(row - reach, 0), min(row + reach, down - 1) + 1):
                edge_row = r == row - reach or r == row + reach
                stride = 1 if edge_row or reach == 0 else 2 * reach
                for c in range(column - reach, column + reach + 1, stride):
                    if c < 0 or c >= across:
                        continue
                    for index in range(starts[r * across + c], starts[r * across + c + 1]):
                        q = order[index]
                        # fainter ones are not counted: noise and texture have hundreds of them to a square
                        if q == p or contrast[q] * _MAX_RATIO < contrast[p]:
                            continue
                        visited += 1
                        dx, dy = points[q, 0] - x, points[q, 1] - y
                        length = np.sqrt(dx * dx + dy * dy)
                        if length < 2.0 or length >= farthest:
                            continue
                        least = least_cosine * length
                        out, straight = -1, least
                        for k in range(4):
                            along = own[k, 0] * dx + own[k, 1] * dy
                            if along > straight:
                                out, straight = k, along
                        if out < 0 or length >= cost[out]:
                            continue
                        back, straight = -1, least
                        for m in range((out + 1) % 2, 4, 2):
                            along = -rays[q, m, 0] * dx - rays[q, m, 1] * dy
                            if along > straight:
                                back, straight = m, along
                        if back < 0:
                            continue
                        if contrast[p] * _MAX_RATIO < contrast[q]:
                            continue
                        weaker = min(contrast[p], contrast[q])
                        # along the edge bright must stay on its side, for even rays that of growing angles
                        # looked at along the other edge, so as to stay in the two squares at any tilt
                        nx, ny = rays[p, (out + 1) % 4, 0], rays[p, (out + 1) % 4, 1]
                        ox, oy = rays[p, (out + 3) % 4, 0], rays[p, (out + 3) % 4, 1]
                        sine = max(abs(dx * ny - dy * nx) / length, np.float32(0.3))
                        offset = max(np.float32(side_offset) * length, np.float32(1.0) / sine)
                        if out % 2 == 1:
                            nx, ny, ox, oy = ox, oy, nx, ny
                        nx, ny, ox, oy = nx * offset, ny * offset, ox * offset, oy * offset
                        sides = np.float32(0.0)
                        for step in range(_LOOKS):
                            part = np.float32(0.2 + 0.6 * step / (_LOOKS - 1))
                            mx, my = x + dx * part, y + dy * part
                            bu = min(max(int(mx + nx + 0.5), 0), width - 1)
                            bv = min(max(int(my + ny + 0.5), 0), height - 1)
                            du = min(max(int(mx + ox + 0.5), 0), width - 1)
                            dv = min(max(int(my + oy + 0.5), 0), height - 1)
                            difference = np.float32(smooth[bv, bu]) - np.float32(smooth[dv, du])
                            if difference <= 0.0:
                                sides = np.float32(-np.inf)
                                break
                            sides += difference
                        if sides < _LOOKS * _MIN_EDGE * weaker:
                            continue
                        cost[out] = length
                        best[p, out] = q
                        arrives[p, out] = back
                        farthest = max(max(cost[0], cost[1]), max(cost[2], cost[3]))
            reach += 1
    for p in range(count):
        for k in range(4):
            q = best[p, k]
            agreed = q >= 0 and best[q, arrives[p, k]] == p and arrives[q, arrives[p, k]] == k
            cost[k] = np.float32(1.0) if agreed else np.float32(0.0)
        for k in range(4):  # in place: the other end's look back at this one fails as well then
            if cost[k] == 0.0:
                best[p, k] = -1
    links = np.full((count, 4), -1, dtype=np.int64)
    for p in range(count):
        for k in range(4):
            q = best[p, k]
            if q < 0 or best[q, arrives[p, k]] != p:
                continue
            for way in (1, 3):  # the cell on either side of the edge
                r, s = best[q, (arrives[p, k] + 4 - way) % 4], best[p, (k + way) % 4]
                if r < 0 or s < 0:
                    continue
                if best[s, 0] == r or best[s, 1] == r or best[s, 2] == r or best[s, 3] == r:
                    links[p, k] = q
    return links


def spread(links: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return patch (n,), place (n, 2) and the patches' sizes, largest first, by following the links from the corners
    with most of them on.

    A corner that is reached on a second way at another place keeps the first one: the one nearer to the seed.
    """
    patch, place, sizes = follow_links(links)
    by_size = np.argsort(-sizes, kind="stable")  # of equal ones the first stays first
    number = np.full(len(sizes) + 1, -1)  # the last is of corners without a patch
    number[by_size] = np.arange(len(sizes))
    return number[patch], place, sizes[by_size]


@jit("i8[:, ::1]")
def follow_links(links: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the same as `spread`, the patches in the order in which they are found."""
    count = links.shape[0]
    patch = np.full(count, -1, dtype=np.int64)
    place = np.zeros((count, 2), dtype=np.int64)
    sizes = np.zeros(count, dtype=np.int64)
    turned = np.zeros(count, dtype=np.int64)  # direction (0 +x, 1 +y, 2 -x, 3 -y) of a corner's ray 0
    queue = np.empty(count, dtype=np.int64)
    patches = 0
    for degree in range(4, 0, -1):
        for seed in range(count):
            linked = 0
            for k in range(4):
                linked += links[seed, k] >= 0
            if patch[seed] >= 0 or linked != degree:
                continue
            patch[seed] = patches
            queue[0] = seed
            first, last = 0, 1
            while first < last:
                p = queue[first]
                first += 1
                for k in range(4):
                    q = links[p, k]
                    if q < 0 or patch[q] >= 0:
                        continue
                    back = 0
                    while back < 3 and links[q, back] != p:
                        back += 1
                    direction = (k + turned[p]) % 4
                    patch[q] = patches
                    turned[q] = (direction + 2 - back) % 4
                    place[q, 0] = place[p, 0] + (1 if direction == 0 else -1 if direction == 2 else 0)
                    place[q, 1] = place[p, 1] + (1 if direction == 1 else -1 if direction == 3 else 0)
                    queue[last] = q
                    last += 1
            sizes[patches] = last
            patches += 1
    return patch, place, sizes[:patches]
