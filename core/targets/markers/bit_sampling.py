"""Decode the markers in the bright squares of a lattice.

A square's four corners map it to the image (`square_places`). A cell of a marker is the mean of some places in its
middle. The level of white is taken from the square's own margin around the marker, that of black from the marker's
border, each on all four sides: light may change across a square. A square without a black frame has no marker.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, Shaped, UInt64

from core.geometry import unit_square_homography
from core.jit import jit
from core.targets.lattice import Lattice
from core.targets.markers.square_places import surrounded

_MAX_OF_FRAME = 0.2  # of its cells may be brighter than half-way
MIN_CONTRAST = 0.25  # of that at the square's corners: between its margin and the marker's border
MIN_LEVELS = 3.0  # the same, grey levels of 256
_ACROSS_CELL = (-0.25, 0.0, 0.25)  # of a cell's size, where it is looked at
_SHARPEN = 0.3  # of the difference between a cell and those around it: enough for a blur of half a cell
_MARGIN_LOOKS = 6  # places on each side of the margin
_MAX_SIDE = 10  # cells of a marker, its border included
_MIN_CELL_PX = 1.2


@dataclass(frozen=True, slots=True)
class DecodedMarkers:
    """The framed squares of a lattice.

    `place` (n, 2) column and row of the square between the lattice's corners (i, j) and (i + 1, j + 1), from -1 on;
    `codes` their bits as `core.targets.markers.dictionary` counts them, with the lattice's columns to the
    right and its rows downward; `mirrored` the same with columns and rows exchanged. `places_px` (rows + 2,
    columns + 2, 2) are the lattice's corners with those foreseen, from -1 on, NaN where nothing is known.
    """

    place: Int[np.ndarray, "n 2"]
    codes: UInt64[np.ndarray, " n"]
    mirrored: UInt64[np.ndarray, " n"]
    places_px: Float[np.ndarray, "rows columns 2"]


def decode_markers(
    image: Shaped[np.ndarray, "h w"], lattice: Lattice, side: int, marker_size: float
) -> DecodedMarkers:
    """Read the bright squares of a lattice.

    Parameters
    ----------
    side
        Bits along a side of a marker, the border (of one cell) not counted.
    marker_size
        Of a marker, border included, as a share of the square.
    """
    places = surrounded(np.ascontiguousarray(lattice.grid))
    gap = np.pad(lattice.gap, 1, constant_values=np.nan)
    least = MIN_LEVELS * (257.0 if image.dtype == np.uint16 else 1.0)
    place, codes = candidate_markers(
        image, places, gap, bool(lattice.origin_is_bright), side + 2, marker_size, least
    )
    return DecodedMarkers(place, codes[:, 0], codes[:, 1], places)


@jit(
    "u1[:, ::1], f8[:, :, ::1], f8[:, ::1], b1, i8, f8, f8",
    "u2[:, ::1], f8[:, :, ::1], f8[:, ::1], b1, i8, f8, f8",
)
def candidate_markers(
    image: Shaped[np.ndarray, "h w"],
    places: Float[np.ndarray, "rows columns 2"],
    gap: Float[np.ndarray, "rows columns"],
    origin_is_bright: bool,
    cells: int,
    marker_size: float,
    least: float,
) -> tuple[Int[np.ndarray, "n 2"], UInt64[np.ndarray, "n 2"]]:
    """Return place and the two codes, as in `DecodedMarkers`, of the bright squares with a black frame.

    `places` and `gap` begin at (-1, -1); `gap` is NaN at corners that are only foreseen. `cells` along a marker's side,
    its border included; `least` contrast in the image's levels.
    """
    rows, columns = gap.shape
    height, width = image.shape
    place = np.empty((rows * columns, 2), dtype=np.int64)
    codes = np.zeros((rows * columns, 2), dtype=np.uint64)
    H = np.empty(8)
    value = np.empty((_MAX_SIDE, _MAX_SIDE))
    blurred = np.empty((_MAX_SIDE + 2, _MAX_SIDE + 2))
    white, black = np.empty(4), np.empty(4)
    margin, cell = 0.5 * (1.0 - marker_size), marker_size / cells
    count = 0
    for j in range(rows - 1):
        for i in range(columns - 1):
            if ((i + j) % 2 == 0) != origin_is_bright:
                continue
            contrast, known = 0.0, 0
            is_visible = True
            for m in range(j, j + 2):
                for n in range(i, i + 2):
                    u, v = places[m, n]
                    is_visible = is_visible and 1.0 <= u <= width - 2.0 and 1.0 <= v <= height - 2.0
                    if math.isfinite(gap[m, n]):
                        contrast += gap[m, n]
                        known += 1
            if not is_visible or known == 0:
                continue
            if not unit_square_homography(
                places[j, i], places[j, i + 1], places[j + 1, i + 1], places[j + 1, i], H
            ):
                continue
            if (
                cell * smallest_side(places[j, i], places[j, i + 1], places[j + 1, i + 1], places[j + 1, i])
                < _MIN_CELL_PX
            ):
                continue
            for side in range(4):  # above, below, left, right
                white[side] = 0.0
                for k in range(_MARGIN_LOOKS):
                    along = (k + 0.5) / _MARGIN_LOOKS
                    across = 0.5 * margin if side % 2 == 0 else 1.0 - 0.5 * margin
                    x, y = (along, across) if side < 2 else (across, along)
                    white[side] += sample_bit(image, H, x, y) / _MARGIN_LOOKS
            black[:] = 0.0
            for b in range(cells):
                for a in range(cells):
                    mean = 0.0
                    for down in _ACROSS_CELL:
                        for right in _ACROSS_CELL:
                            x, y = margin + (a + 0.5 + right) * cell, margin + (b + 0.5 + down) * cell
                            mean += sample_bit(image, H, x, y) / 9.0
                    blurred[b + 1, a + 1] = mean
            # what blur has carried from cell to cell is taken back; beyond the marker's sides there is the margin
            for k in range(1, cells + 1):
                along = ((k - 0.5) / cells - 0.5) * marker_size / (1.0 - margin)
                across, down = along * (white[3] - white[2]), along * (white[1] - white[0])
                blurred[0, k], blurred[cells + 1, k] = white[0] + across, white[1] + across
                blurred[k, 0], blurred[k, cells + 1] = white[2] + down, white[3] + down
            for b in range(cells):
                for a in range(cells):
                    own = blurred[b + 1, a + 1]
                    around = (
                        blurred[b, a + 1] + blurred[b + 2, a + 1] + blurred[b + 1, a] + blurred[b + 1, a + 2]
                    )
                    value[b, a] = own + _SHARPEN * (4.0 * own - around)
            for k in range(cells):
                black[0] += value[0, k] / cells
                black[1] += value[cells - 1, k] / cells
                black[2] += value[k, 0] / cells
                black[3] += value[k, cells - 1] / cells
            apart = 0.25 * (np.sum(white) - np.sum(black))
            if not apart > max(least, MIN_CONTRAST * contrast / known):
                continue
            bright_frame = 0
            code, mirrored = np.uint64(0), np.uint64(0)
            for b in range(cells):
                for a in range(cells):
                    # half-way between white and black, both planes through their four sides
                    x, y = (a + 0.5) / cells - 0.5, (b + 0.5) / cells - 0.5
                    limit = 0.125 * (np.sum(white) + np.sum(black))
                    limit += 0.5 * marker_size * x * (white[3] - white[2]) / (1.0 - margin)
                    limit += 0.5 * marker_size * y * (white[1] - white[0]) / (1.0 - margin)
                    limit += 0.5 * x * (black[3] - black[2]) * cells / (cells - 1.0)
                    limit += 0.5 * y * (black[1] - black[0]) * cells / (cells - 1.0)
                    is_white = value[b, a] > limit
                    if min(a, b) == 0 or max(a, b) == cells - 1:
                        bright_frame += is_white
                    else:
                        if is_white:
                            bit = (b - 1) * (cells - 2) + a - 1
                            turned = (a - 1) * (cells - 2) + b - 1
                            last = (cells - 2) * (cells - 2) - 1
                            code |= np.uint64(1) << np.uint64(last - bit)
                            mirrored |= np.uint64(1) << np.uint64(last - turned)
            if bright_frame > _MAX_OF_FRAME * 4 * (cells - 1):
                continue
            place[count, 0], place[count, 1] = i - 1, j - 1
            codes[count, 0], codes[count, 1] = code, mirrored
            count += 1
    return place[:count], codes[:count]


@jit("f8[::1], f8[::1], f8[::1], f8[::1]")
def smallest_side(
    a: Float[np.ndarray, "2"], b: Float[np.ndarray, "2"], c: Float[np.ndarray, "2"], d: Float[np.ndarray, "2"]
) -> float:
    """Return how high the quadrangle is above its longest side, about: its area over that side, px."""
    area = 0.5 * abs((c[0] - a[0]) * (d[1] - b[1]) - (c[1] - a[1]) * (d[0] - b[0]))
    longest = max(
        max(math.hypot(b[0] - a[0], b[1] - a[1]), math.hypot(c[0] - b[0], c[1] - b[1])),
        max(math.hypot(d[0] - c[0], d[1] - c[1]), math.hypot(a[0] - d[0], a[1] - d[1])),
    )
    return area / max(longest, 1e-9)


@jit("u1[:, ::1], f8[::1], f8, f8", "u2[:, ::1], f8[::1], f8, f8")
def sample_bit(
    image: Shaped[np.ndarray, "h w"],
    H: Float[np.ndarray, "8"],
    x: float,
    y: float,
) -> float:
    """Return the grey value where H takes (x, y), interpolated from the four pixels around."""
    height, width = image.shape
    scale = 1.0 / (H[6] * x + H[7] * y + 1.0)
    u, v = (H[0] * x + H[1] * y + H[2]) * scale, (H[3] * x + H[4] * y + H[5]) * scale
    u, v = min(max(u, 0.0), width - 1.001), min(max(v, 0.0), height - 1.001)
    u0, v0 = int(u), int(v)
    fu, fv = u - u0, v - v0
    upper = image[v0, u0] + fu * (float(image[v0, u0 + 1]) - float(image[v0, u0]))
    lower = image[v0 + 1, u0] + fu * (float(image[v0 + 1, u0 + 1]) - float(image[v0 + 1, u0]))
    return upper + fv * (lower - upper)
