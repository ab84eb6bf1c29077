"""Where a board of dots ends: whether with the dots that were found, or they are cut out of a larger grid, or some of
them are no dots, or cut by the image border.

As many columns and rows as were asked for may be what a grille, or a larger board, shows next to something that covers
it. Then there are dots on the next line to one side at least, where a board has its margin: spots as dark or bright as
the dots, with lighter or darker places half-way between them. Where something covers that line, they are on the one
or two after it, and lighter places are between these lines as well.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from core.geometry import find_homography, map_in_front
from core.targets.circles.centres import FittedDots, plane_map
from core.targets.circles.lattice import DotLattice
from core.targets.circles.partial_view import along_grid_lines, in_image
from core.targets.grid_index import is_staggered
from core.targets.specification import TargetSpec
from core.targets.subpixel import largest_level, nearest_levels

_MIN_SITES = 3  # in view
_MAJORITY = 0.6  # of those in view
_SIDES = 4
_FURTHER = 3  # lines beyond each side
_MIN_SITES_FURTHER, _MAJORITY_FURTHER = 4, 0.8  # on lines after the next: nearly all of them look like dots
_LIKE_DOTS = 0.4  # of the dots' usual contrast
_MAX_STRAY = 2  # patches that stand where a line's dots would
_NEAR_BORDER = 4.0  # radii
_TOP = 0.995  # of the largest level
_WHOLE = 0.75  # quantile of radii: of three rows the border may cut two
_MIN_LINE_SHARE = 0.5  # of a line's sites in the image


def cut_by_border(
    ideal: Float[np.ndarray, "n 2"], fitted: FittedDots, shape: tuple[int, ...]
) -> Bool[np.ndarray, " n"]:
    """Return which dots the image border cuts, by the others' places and size: an ellipse is drawn as well to the part
    of a dot that is in view, off its centre and all in the image.

    Parameters
    ----------
    ideal
        The dots' places on the print, pitches.
    shape
        Height and width of the image.
    """
    far = np.array([shape[1] - 1.0, shape[0] - 1.0])
    centres, none = fitted.shapes[:, :2], np.zeros(len(ideal), dtype=np.bool_)
    if np.minimum(centres, far - centres).min() > _NEAR_BORDER * fitted.radius_px.max():
        return none
    J, drawn = plane_map(ideal, centres, fitted.trusted.astype(np.float64))
    radius = fitted.radius_px / np.sqrt(np.abs(np.linalg.det(J)))
    radius = np.maximum(radius, np.quantile(radius[fitted.trusted], _WHOLE))
    blur_px = np.median(fitted.shapes[fitted.trusted, 5])
    half = radius[:, None] * np.linalg.norm(J, axis=2) + blur_px
    return np.asarray(np.any(np.minimum(drawn, far - drawn) < half, axis=1))


def without_stray_lines(
    lattice: DotLattice,
    points_px: Float[np.ndarray, "n 2"],
    shape: tuple[int, int],
    target: TargetSpec,
) -> DotLattice:
    """Return a lattice without the outermost lines that have only one or two patches, on fewer than half of their sites
    in the image: an edge of light across the board makes such patches, and no line of dots looks like that.

    Parameters
    ----------
    points_px
        The dots' centres in the full image.
    shape
        Height and width of the image.
    """
    places = along_grid_lines(lattice, target)
    extent = places.max(axis=0) + 1
    ends = (np.bincount(places[:, axis])[[0, -1]] for axis in range(2))
    has_few = any(count.min() <= _MAX_STRAY for count in ends)
    H = find_homography(places.astype(np.float64), points_px) if has_few and extent.min() > 1 else None
    if H is None:
        return lattice
    y, x = np.mgrid[0 : extent[1], 0 : extent[0]]
    sites = in_image(H, x, y, shape, target)
    if is_staggered(target):
        sites &= (x + y - places[0].sum()) % 2 == 0
    kept = np.ones(len(places), dtype=np.bool_)
    for axis in range(2):
        line = places[:, axis]
        in_view = sites.sum(axis=axis)
        for lines in (range(extent[axis]), reversed(range(extent[axis]))):
            for n in lines:
                count = np.count_nonzero(kept & (line == n))
                if count > _MAX_STRAY or count >= _MIN_LINE_SHARE * in_view[n]:
                    break
                kept &= line != n
    return DotLattice(lattice.dots[kept], lattice.places[kept]) if kept.any() else lattice


def extends_beyond(
    image: Shaped[np.ndarray, "h w"],
    target: TargetSpec,
    column: Int[np.ndarray, " n"],
    row: Int[np.ndarray, " n"],
    centres_px: Float[np.ndarray, "n 2"],
    contrast: float,
) -> bool:
    """Return whether the lattice of a board's dots continues beyond it on any side, also after a hidden line or two.

    `contrast` is the grey of what is around the dots, less theirs.
    """
    H = find_homography(_places(target, column, row), centres_px)
    if H is None:
        return False
    white = _TOP * largest_level(image)
    across, down = np.arange(target.columns), np.arange(target.rows)
    lines = []
    for further in range(_FURTHER):
        lines += [
            (across, np.full(target.columns, -1 - further)),
            (across, np.full(target.columns, target.rows + further)),
            (np.full(target.rows, -1 - further), down),
            (np.full(target.rows, target.columns + further), down),
        ]
    i, j = (np.concatenate(indices) for indices in zip(*lines, strict=True))
    starts = np.cumsum([len(line[0]) for line in lines])[:-1]
    sites = np.split(_places(target, i, j), starts)
    ends = np.split(_places(target, np.clip(i, 0, across[-1]), np.clip(j, 0, down[-1])), starts)
    looked_at = [
        _looked_at(*line, is_next=n < _SIDES) for n, line in enumerate(zip(sites, ends, strict=True))
    ]
    levels = nearest_levels(image, map_in_front(H, np.concatenate(looked_at)), 1)
    of_line = np.split(levels, np.cumsum([len(places) for places in looked_at])[:-1])
    return any(
        _has_dots(of_line[n], len(sites[n]), contrast, white, is_next=n < _SIDES) for n in range(len(lines))
    )


def _places(
    target: TargetSpec, column: Int[np.ndarray, " n"], row: Int[np.ndarray, " n"]
) -> Float[np.ndarray, "n 2"]:
    """Return where grid points are, in pitches, of those beyond the board as well; a certificate has none of these."""
    plain = replace(target, certificate=None)
    return np.ascontiguousarray(plain.points_target(column, row)[:, :2] / target.pitch_mm)


def _looked_at(
    sites: Float[np.ndarray, "n 2"], ends: Float[np.ndarray, "n 2"], *, is_next: bool
) -> Float[np.ndarray, "m 2"]:
    """Return the places that show whether a line has dots: its sites, half-way between them, and the board's dots at
    the end next to it."""
    places = [sites, 0.5 * (sites[1:] + sites[:-1]), ends]
    if not is_next:
        # half-way to the line on one side at least: bars of a grille have none
        along = sites[-1] - sites[0]
        to_side = (
            0.5 * np.array([-along[1], along[0]]) * np.hypot(*(sites[1] - sites[0])) / (along @ along) ** 0.5
        )
        places += [sites + to_side, sites - to_side]
    return np.concatenate(places)


def _has_dots(
    levels: Float[np.ndarray, " m"], n: int, contrast: float, white: float, *, is_next: bool
) -> bool:
    """Return whether most of a line's n sites that are in view look like dots, by the levels at `_looked_at` places.

    Saturated white at a site and at that of the board's dot at the end next to it says nothing: a reflection hides
    both.
    """
    at, between, at_ends = levels[:n], levels[n : 2 * n - 1], levels[2 * n - 1 : 3 * n - 1]
    around = np.full((2 if is_next else 3, n), np.nan)
    around[0, 1:], around[1, :-1] = between, between
    if not is_next:
        around[2] = np.sign(contrast) * np.fmax(*(np.sign(contrast) * levels[3 * n - 1 :].reshape(2, n)))
    with np.errstate(invalid="ignore"):
        # the nearer to the dot's own grey of the two: a shadow's or a sheet's edge next to it makes no dot
        surround = np.nanmin(np.sign(contrast) * around, axis=0, initial=np.inf)
        darker = surround - np.sign(contrast) * at
    seen = np.isfinite(darker)
    if contrast > 0.0:
        seen &= (at < white) | (at_ends < white)
    likely = darker[seen] > _LIKE_DOTS * abs(contrast)
    if is_next:
        return bool(seen.sum() >= _MIN_SITES and likely.mean() >= _MAJORITY)
    return bool(seen.sum() >= _MIN_SITES_FURTHER and likely.mean() >= _MAJORITY_FURTHER)
