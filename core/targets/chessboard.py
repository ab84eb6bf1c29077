"""Finding a chessboard: OpenCV's detectors on reduced images, then our own judgement of what they return.

Coarse detection never runs on more than a fixed number of pixels, so that a picture without a board costs a
bounded time. What is found is refined at full resolution and believed only if it is a smooth grid, coloured
like a chessboard, and goes on beyond no side.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from core.errors import TargetMismatch, TargetNotFound
from core.targets.lattice import is_smooth, smooth_residuals
from core.targets.orientation import orient, right_handed
from core.targets.refinement import refine, standard_uncertainties
from core.targets.specification import GridPoints, TargetSpec
from core.targets.squares import (
    Colours,
    LineBeyond,
    grow,
    lines_beyond,
    measure_colours,
    outer_lines_are_corners,
)

_SIZES_PX = (1000, 640, 1600)  # longest sides of the reduced images, in the order they are tried
_CLASSIC = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK
_DETECTORS = (
    (cv2.findChessboardCorners, _CLASSIC, 1000),
    (cv2.findChessboardCornersSB, cv2.CALIB_CB_NORMALIZE_IMAGE, 1600),
)
"""Function, flags, and the longest side on which it is used: the first is quick on a board, and its time explodes
on clutter."""
_ASTRAY = 6.0  # times the median residual of the smooth grid
_LEAST_ASTRAY_PX = 0.3
_ANY_GRID = cv2.CALIB_CB_LARGER | cv2.CALIB_CB_EXHAUSTIVE
_ANY_SIZE = (5, 4)  # the least of the grids taken for a board that was not asked for


@dataclass(frozen=True, slots=True)
class _Reduced:
    """A smaller picture, and how its pixels lie in the full one: full = (small + ½) scale - ½."""

    image: UInt8[np.ndarray, "h w"]
    scale: Float[np.ndarray, "2"]

    def to_full(self, points: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
        """Return the same places in the full picture's pixels."""
        return (points + 0.5) * self.scale - 0.5


@dataclass(frozen=True, slots=True)
class _Found:
    """A right-handed grid at full resolution, its squares, and what lies beyond its four sides."""

    grid: Float[np.ndarray, "rows columns 2"]
    colours: Colours
    beyond: tuple[LineBeyond, ...]


def detect_chessboard(image: np.ndarray, target: TargetSpec) -> GridPoints:
    """Find the inner corners of a chessboard; see `core.targets.detect.detect`."""
    full = image.astype(np.float32)
    shown = _to_8_bit(image)
    lattice = None
    for candidate in _candidates(shown, target):
        found = _judge(full, candidate)
        if found is None:
            continue
        if not any(line.is_lattice for line in found.beyond):
            return _grid_points(full, found, target)
        if lattice is None:  # this is a part of a larger board; the one asked for may still be beside it
            lattice = _judge(full, grow(full, found.grid))
    lattice = lattice or _any_lattice(shown, full)
    if lattice is None:
        raise TargetNotFound(f"No chessboard of {target.columns} x {target.rows} inner corners was found.")
    if not any(line.is_lattice for line in lattice.beyond):
        for grid in (lattice.grid, np.rot90(lattice.grid)):
            if grid.shape[:2] == (target.rows, target.columns):
                colours = measure_colours(full, grid)
                return _grid_points(full, _Found(grid, colours, lattice.beyond), target)
    raise _other_grid(lattice, target)


def _judge(full: np.ndarray, candidate: Float[np.ndarray, "rows columns 2"]) -> _Found | None:
    """Return the candidate refined at full resolution, or None where it is no chessboard."""
    grid = right_handed(candidate)
    if not is_smooth(grid):
        return None
    grid = refine(full, grid)
    if not is_smooth(grid) or np.any(grid < 0.0) or np.any(grid > np.array(full.shape[::-1]) - 1.0):
        return None
    colours = measure_colours(full, grid)
    if not colours.are_a_chessboard or not outer_lines_are_corners(full, grid, colours):
        return None
    return _Found(grid, colours, lines_beyond(full, grid, colours))


def _grid_points(full: np.ndarray, found: _Found, target: TargetSpec) -> GridPoints:
    grid, warnings = orient(found.grid, found.colours.origin_is_black)
    uncertainties = standard_uncertainties(full, grid)
    rest = np.linalg.norm(smooth_residuals(grid)[1], axis=2)
    astray = rest > max(_ASTRAY * float(np.median(rest)), _LEAST_ASTRAY_PX)  # by a highlight or a blot
    uncertainties[astray] = np.maximum(uncertainties[astray], rest[astray])
    row, column = (a.ravel() for a in np.mgrid[0 : target.rows, 0 : target.columns])
    return GridPoints(
        target=target,
        image_width_px=full.shape[1],
        image_height_px=full.shape[0],
        column=column,
        row=row,
        points_px=np.ascontiguousarray(grid.reshape(-1, 2)),
        standard_uncertainty_px=uncertainties.ravel(),
        warnings=warnings,
    )


def _candidates(
    shown: UInt8[np.ndarray, "h w"], target: TargetSpec
) -> Iterator[Float[np.ndarray, "rows columns 2"]]:
    """Yield grids of the target's size that OpenCV sees, in full-resolution pixels, cheapest first."""
    long, short = max(target.columns, target.rows), min(target.columns, target.rows)
    for reduced in _reduced_images(shown):
        for find, flags, longest_px in _DETECTORS:
            if max(reduced.image.shape) > longest_px:
                continue
            found, corners = find(reduced.image, (long, short), flags=flags)
            if found and corners is not None and corners.size == 2 * long * short:
                grid = reduced.to_full(np.asarray(corners, dtype=np.float64).reshape(short, long, 2))
                yield grid if target.columns >= target.rows else np.swapaxes(grid, 0, 1)


def _reduced_images(shown: UInt8[np.ndarray, "h w"]) -> Iterator[_Reduced]:
    """Yield the picture at the sizes at which boards are looked for; once only where it is small itself."""
    height, width = shown.shape
    longest = max(height, width)
    previous: set[tuple[int, int]] = set()
    for size in _SIZES_PX:
        factor = min(1.0, size / longest)
        shape = (max(1, round(width * factor)), max(1, round(height * factor)))
        if shape in previous:
            continue
        previous.add(shape)
        image = shown if shape == (width, height) else cv2.resize(shown, shape, interpolation=cv2.INTER_AREA)
        yield _Reduced(image, np.array([width / shape[0], height / shape[1]]))


def _to_8_bit(image: np.ndarray) -> UInt8[np.ndarray, "h w"]:
    """Return the picture for the coarse detectors, its range stretched where it has 16 bit.

    A 12-bit camera fills a sixteenth of the range.
    """
    if image.dtype == np.uint8:
        return image
    low, high = np.percentile(image[::4, ::4], (0.5, 99.5))
    span = max(float(high - low), 1.0)
    return np.asarray(cv2.convertScaleAbs(np.clip(image, low, high) - low, alpha=255.0 / span))


def _any_lattice(shown: UInt8[np.ndarray, "h w"], full: np.ndarray) -> _Found | None:
    """Return the lattice of whatever chessboard is in view, grown as far as it goes; None where there is none."""
    reduced = next(_reduced_images(shown))
    found, corners, meta = cv2.findChessboardCornersSBWithMeta(reduced.image, _ANY_SIZE, _ANY_GRID)
    if not found or corners is None or meta is None:
        return None
    points = np.asarray(corners, dtype=np.float64).reshape(*meta.shape[:2], 2)
    part = _judge(full, reduced.to_full(points))
    return None if part is None else _judge(full, grow(full, part.grid))


def _other_grid(lattice: _Found, target: TargetSpec) -> TargetNotFound | TargetMismatch:
    """Return what to say of a lattice that is not the one asked for."""
    asked = f"{target.columns} x {target.rows}"
    long, short = sorted(lattice.grid.shape[:2], reverse=True)
    if any(line.is_lattice or not line.is_visible for line in lattice.beyond):
        if long > max(target.columns, target.rows) or short > min(target.columns, target.rows):
            return TargetMismatch(f"A grid of at least {long} x {short} is in view, {asked} was asked for.")
        return TargetNotFound(
            f"Only {long} x {short} points of a grid are wholly in view, {asked} were asked for."
        )
    return TargetMismatch(f"A {long} x {short} grid is in view, {asked} was asked for.")
