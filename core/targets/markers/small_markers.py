"""Decode markers whose cells are about a pixel wide, by least squares on the image's own pixels.

A pixel sees several cells there: its grey is Σ w_k x_k over the areas k of a square (cells, border, margin, and what
lies next to the square), w_k the share of the pixel's blur that falls on area k, a Gaussian of standard deviation σ.
Interpolated grey values do not separate the cells; least squares with all of the square's pixels does, as far as the
blur leaves them distinct. A cell is expected half-way between black and white, give or take half the contrast, so that
the result is noisy rather than wild where pixels do not determine it (N. Wiener, "Extrapolation, Interpolation, and
Smoothing of Stationary Time Series", 1949). σ is that with which black and white cells explain the pixels best.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from core.geometry import unit_square_homography
from core.jit import jit
from core.numerics import median
from core.targets.lattice import Lattice
from core.targets.markers.bit_sampling import MIN_CONTRAST, MIN_LEVELS, DecodedMarkers
from core.targets.markers.dictionary import code_of
from core.targets.markers.square_places import places_in_squares, surrounded

_SIGMAS_PX = (0.45, 0.6, 0.8, 1.05, 1.4)
"""The pixel's own area included."""
_TRIED = 12  # squares by which σ is determined
_MIN_NEARNESS = 0.2  # of that of the square's first corner
_MAX_SQUARES = 150  # read of one lattice, evenly over it
_CELL_RANGE_PX = (0.4, 3.5)  # cells that are read
_MIN_PRINTED = 0.4  # of the bright squares: fewer have something printed in them on a floor of tiles
_AROUND = 0.2  # squares, of what lies next to a square
_STEP = 0.75  # σ, between the places that make up an area
_MAX_RADIUS_SIGMAS = 3.0
_NOISE = 0.04  # of the contrast, and one level
_MAX_MISFIT = 0.16  # of the contrast, root mean square
_MIN_FRAMED = 0.4  # of the squares by which σ is determined: with fewer it is no board of markers
_IN_SQUARE = np.stack(np.meshgrid(*2 * [np.linspace(0.2, 0.8, 7)]), axis=2).reshape(-1, 2)
_MIN_DARK = 0.15  # of the places in a square: a marker's border alone makes a fifth
_WHITE, _CORNERS, _STRIPS, _BLACK, _CELLS = 0, 1, 2, 6, 7  # areas; four strips


def decode_small_markers(
    image: Shaped[np.ndarray, "h w"], lattice: Lattice, side: int, marker_size: float
) -> tuple[DecodedMarkers, int]:
    """Read the bright squares of a lattice as `decode_markers` does; a square is framed if a marker explains it.

    Returns as well how many squares have something printed in them, 0 where most have nothing.
    """
    places = surrounded(np.ascontiguousarray(lattice.grid))
    squares, contrast, is_closed = _printed_squares(image, lattice, places, marker_size / (side + 2))
    areas = _Areas(side, marker_size)
    sure = np.flatnonzero(is_closed) if is_closed.any() else np.arange(len(squares))
    tried = sure[np.linspace(0, len(sure) - 1, min(_TRIED, len(sure))).astype(np.intp)]
    best, sigma = np.inf, _SIGMAS_PX[0]
    for wider in _SIGMAS_PX:
        _, misfits = areas.fit(image, places, squares[tried], contrast[tried], wider)
        is_framed = misfits < _MAX_MISFIT
        if np.count_nonzero(is_framed) >= max(_MIN_FRAMED * len(tried), 1):
            misfit = median(np.minimum(misfits, _MAX_MISFIT))
            if misfit < best:
                best, sigma = misfit, wider
    read = slice(None) if np.isfinite(best) else slice(0)
    bits, misfits = areas.fit(image, places, squares[read], contrast[read], sigma)
    is_framed = misfits < _MAX_MISFIT
    bits = bits[is_framed]
    decoded = DecodedMarkers(
        squares[read][is_framed], code_of(bits), code_of(bits.transpose(0, 2, 1)), places
    )
    return decoded, len(squares)


def _printed_squares(
    image: np.ndarray, lattice: Lattice, places: Float[np.ndarray, "rows columns 2"], cell: float
) -> tuple[Int[np.ndarray, "n 2"], Float[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Return the bright squares with something dark in them, by column and row, the contrast at their corners, and
    whether all four of these are known; without those whose cells (`cell` squares wide) are too small or too large."""
    gap = np.pad(lattice.gap, 1, constant_values=np.nan)
    around = np.stack([gap[:-1, :-1], gap[:-1, 1:], gap[1:, :-1], gap[1:, 1:]])
    corners = np.stack([places[:-1, :-1], places[:-1, 1:], places[1:, :-1], places[1:, 1:]])
    rows, columns = np.indices(around.shape[1:])
    height, width = image.shape
    with np.errstate(invalid="ignore"):
        inside = (corners >= 1.0).all(axis=(0, 3)) & (corners <= [width - 2.0, height - 2.0]).all(axis=(0, 3))
    one, other = corners[3] - corners[0], corners[2] - corners[1]
    side_px = np.sqrt(0.5 * np.abs(one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0]))
    extent_px = np.max(np.ptp(corners, axis=0), axis=2)
    inside &= (cell * side_px > _CELL_RANGE_PX[0]) & (cell * extent_px < 2.0 * _CELL_RANGE_PX[1])
    is_bright = ((rows + columns) % 2 == 0) == lattice.origin_is_bright
    row, column = np.nonzero(inside & is_bright & np.isfinite(around).any(axis=0))
    contrast = np.nanmean(around[:, row, column], axis=0) if len(row) else np.zeros(0)
    squares = np.stack([column - 1, row - 1], axis=1)
    looks = places_in_squares(places, squares, _IN_SQUARE)
    u, v = np.moveaxis(np.rint(np.where(np.isfinite(looks), looks, 0.0)).astype(np.intp), 2, 0)
    greys = image[np.clip(v, 0, height - 1), np.clip(u, 0, width - 1)].astype(np.float64)
    brightest = greys.max(axis=1, initial=0.0)
    is_printed = np.mean(greys < (brightest - 0.4 * contrast)[:, None], axis=1) > _MIN_DARK
    chosen = np.flatnonzero(is_printed & np.isfinite(looks).all(axis=(1, 2)))
    if len(chosen) < _MIN_PRINTED * len(squares):
        chosen = chosen[:0]
    if len(chosen) > _MAX_SQUARES:
        chosen = chosen[np.linspace(0, len(chosen) - 1, _MAX_SQUARES).astype(np.intp)]
    is_closed = np.isfinite(around[:, row, column]).all(axis=0)
    return squares[chosen], contrast[chosen], is_closed[chosen]


class _Areas:
    """The areas of a square with a marker of some number of bits, and their prior."""

    def __init__(self, side: int, marker_size: float) -> None:
        self.side = side
        cells = side + 2
        margin = 0.5 * (1.0 - marker_size)
        self.edges = np.concatenate(
            [[-_AROUND, 0.0], margin + np.arange(cells + 1) * marker_size / cells, [1.0, 1.0 + _AROUND]]
        )
        count = cells + 4
        areas = np.full((count, count), _WHITE)
        areas[0], areas[-1], areas[:, 0], areas[:, -1] = _STRIPS, _STRIPS + 1, _STRIPS + 2, _STRIPS + 3
        areas[[0, 0, -1, -1], [0, -1, 0, -1]] = _CORNERS
        areas[2:-2, 2:-2] = _BLACK
        areas[3:-3, 3:-3] = _CELLS + np.arange(side * side).reshape(side, side)
        self.areas = areas
        size = _CELLS + side * side
        # in half contrasts: cells from half-way between black and white, what is around from what is next to it
        prior = np.zeros((size, size))
        for area in range(size):
            row = np.zeros(size)
            row[area] = 1.0
            if area >= _CELLS:
                row[_WHITE] = row[_BLACK] = -0.5
            elif area not in (_WHITE, _BLACK):
                row[_WHITE if area == _CORNERS else _BLACK] = -1.0
            else:
                continue
            prior += np.outer(row, row)
        self.prior = prior

    def fit(
        self,
        image: np.ndarray,
        places: Float[np.ndarray, "rows columns 2"],
        squares: Int[np.ndarray, "n 2"],
        contrast: Float[np.ndarray, " n"],
        sigma: float,
    ) -> tuple[Bool[np.ndarray, "n side side"], Float[np.ndarray, " n"]]:
        """Return the squares' bits, and how badly black and white explain their pixels, in contrasts."""
        levels = 257.0 if image.dtype == np.uint16 else 1.0
        bits = np.zeros((len(squares), self.side, self.side), np.bool_)
        misfits = np.full(len(squares), np.inf)
        for n, (i, j) in enumerate(squares + 1):
            H = np.empty(8)
            quad = (places[j, i], places[j, i + 1], places[j + 1, i + 1], places[j + 1, i])
            if not unit_square_homography(*quad, H):
                continue
            first = np.maximum(np.floor(np.min(quad, axis=0)).astype(np.intp), 0)
            last = np.minimum(np.ceil(np.max(quad, axis=0)).astype(np.intp), np.array(image.shape[::-1]) - 1)
            width, height = last - first + 1
            scale_u = max(math.dist(quad[0], quad[1]), math.dist(quad[2], quad[3]))
            scale_v = max(math.dist(quad[1], quad[2]), math.dist(quad[3], quad[0]))
            W = area_weights(
                H,
                scale_u,
                scale_v,
                self.edges,
                self.areas,
                _CELLS + self.side**2,
                sigma,
                first[0],
                first[1],
                width,
                height,
            )
            own = 1.0 - W[_CORNERS : _STRIPS + 4].sum(axis=0)
            used = (own > 0.5) & (np.abs(W.sum(axis=0) - 1.0) < 0.1)
            grey = image[first[1] : last[1] + 1, first[0] : last[0] + 1].reshape(-1)[used].astype(np.float64)
            W = W[:, used].T
            half = 0.5 * contrast[n]
            noise = _NOISE * contrast[n] + levels
            A = W.T @ W / noise**2 + self.prior / half**2
            A[np.diag_indices_from(A)] += 1e-9 * np.trace(A)
            x = np.linalg.solve(A, W.T @ grey / noise**2)
            apart = x[_WHITE] - x[_BLACK]
            if not apart > max(MIN_LEVELS * levels, MIN_CONTRAST * contrast[n]):
                continue
            is_white = x[_CELLS:] > 0.5 * (x[_WHITE] + x[_BLACK])
            x[_CELLS:] = np.where(is_white, x[_WHITE], x[_BLACK])
            misfits[n] = math.sqrt(float(np.mean((grey - W @ x) ** 2))) / apart
            bits[n] = is_white.reshape(self.side, self.side)
        return bits, misfits


@jit("f8[::1], f8, f8, f8[::1], i8[:, ::1], i8, f8, i8, i8, i8, i8")
def area_weights(
    H: Float[np.ndarray, "8"],
    scale_u: float,
    scale_v: float,
    edges: Float[np.ndarray, " k"],
    areas: Int[np.ndarray, "m m"],
    count: int,
    sigma: float,
    left: int,
    top: int,
    width: int,
    height: int,
) -> Float[np.ndarray, "areas pixels"]:
    """Return the shares of the pixels' blur that fall on the areas of a square, row by row from (left, top) on.

    `scale_u` and `scale_v` are the lengths of the square's sides, px, about; `edges` are those of the areas' columns,
    and of their rows, in squares; `areas` names the area of each piece.
    """
    W = np.zeros((count, width * height))
    step = _STEP * sigma
    radius = _MAX_RADIUS_SIGMAS * sigma
    factor = 1.0 / (2.0 * math.pi * sigma * sigma)
    across = np.empty(2 * int(radius + 1.0) + 3)
    for b in range(len(edges) - 1):
        rows = max(1, math.ceil((edges[b + 1] - edges[b]) * scale_v / step))
        for a in range(len(edges) - 1):
            columns = max(1, math.ceil((edges[a + 1] - edges[a]) * scale_u / step))
            area = areas[b, a]
            piece = (edges[b + 1] - edges[b]) / rows * (edges[a + 1] - edges[a]) / columns
            for j in range(rows):
                y = edges[b] + (j + 0.5) / rows * (edges[b + 1] - edges[b])
                for i in range(columns):
                    x = edges[a] + (i + 0.5) / columns * (edges[a + 1] - edges[a])
                    nearness = H[6] * x + H[7] * y + 1.0
                    if nearness < _MIN_NEARNESS:  # what is next to a square reaches behind the camera
                        continue
                    scale = 1.0 / nearness
                    u, v = (H[0] * x + H[1] * y + H[2]) * scale, (H[3] * x + H[4] * y + H[5]) * scale
                    # the area of the piece in pixels: that of the square times Jacobi's determinant
                    du_x, du_y = (H[0] - H[6] * u) * scale, (H[1] - H[7] * u) * scale
                    dv_x, dv_y = (H[3] - H[6] * v) * scale, (H[4] - H[7] * v) * scale
                    weight = factor * piece * abs(du_x * dv_y - du_y * dv_x)
                    begin, end = (
                        max(left, math.ceil(u - radius)),
                        min(left + width - 1, math.floor(u + radius)),
                    )
                    for p in range(begin, end + 1):
                        across[p - begin] = math.exp(-0.5 * ((p - u) / sigma) ** 2)
                    for q in range(
                        max(top, math.ceil(v - radius)), min(top + height - 1, math.floor(v + radius)) + 1
                    ):
                        down = weight * math.exp(-0.5 * ((q - v) / sigma) ** 2)
                        at = (q - top) * width + begin - left
                        for k in range(end - begin + 1):
                            W[area, at + k] += down * across[k]
    return W
