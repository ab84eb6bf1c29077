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
from core.targets import lattice
from core.targets.orientation import orient, right_handed
from core.targets.refinement import refine, standard_uncertainties
from core.targets.specification import GridPoints, TargetSpec

_SIZES_PX = (1000, 640, 1600)  # longest side of the reduced images, in the order they are tried
_CLASSIC = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
_SECTOR_BASED = cv2.CALIB_CB_NORMALIZE_IMAGE
_ANY_GRID = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_LARGER
_LEAST_OTHER_GRID = 12  # points of another board that is worth naming


@dataclass(frozen=True, slots=True)
class _Reduced:
    """A smaller picture, and how its pixels lie in the full one: full = (small + ½) scale - ½."""

    image: UInt8[np.ndarray, "h w"]
    scale: Float[np.ndarray, "2"]

    def to_full(self, points: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
        """Return the same places in the full picture's pixels."""
        return (points + 0.5) * self.scale - 0.5


def detect_chessboard(image: np.ndarray, target: TargetSpec) -> GridPoints:
    """Find the inner corners of a chessboard; see `core.targets.detect.detect`."""
    full = image.astype(np.float32)
    shown = _to_8_bit(image)
    goes_on = False
    for candidate in _candidates(shown, target):
        grid = right_handed(candidate)
        if not lattice.is_smooth(grid):
            continue
        grid = refine(full, grid)
        if not lattice.is_smooth(grid):
            continue
        squares = lattice.Squares(full, grid)
        if not squares.are_a_chessboard():
            continue
        if squares.continue_beyond().any():
            goes_on = True
            continue
        return _grid_points(full, grid, squares.origin_is_black, target)
    raise _failure(shown, full, target, goes_on)


def _grid_points(
    full: np.ndarray, grid: Float[np.ndarray, "rows columns 2"], origin_is_black: bool, target: TargetSpec
) -> GridPoints:
    oriented, warnings = orient(grid, origin_is_black)
    row, column = (a.ravel() for a in np.mgrid[0 : target.rows, 0 : target.columns])
    return GridPoints(
        target=target,
        image_width_px=full.shape[1],
        image_height_px=full.shape[0],
        column=column,
        row=row,
        points_px=np.ascontiguousarray(oriented.reshape(-1, 2)),
        standard_uncertainty_px=standard_uncertainties(full, oriented).ravel(),
        warnings=warnings,
    )


def _candidates(
    shown: UInt8[np.ndarray, "h w"], target: TargetSpec
) -> Iterator[Float[np.ndarray, "rows columns 2"]]:
    """Yield grids of the target's size that OpenCV sees, in full-resolution pixels, cheapest first."""
    long, short = max(target.columns, target.rows), min(target.columns, target.rows)
    for reduced in _reduced_images(shown):
        for find, flags in (
            (cv2.findChessboardCorners, _CLASSIC),
            (cv2.findChessboardCornersSB, _SECTOR_BASED),
        ):
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


def _failure(
    shown: UInt8[np.ndarray, "h w"], full: np.ndarray, target: TargetSpec, goes_on: bool
) -> TargetNotFound | TargetMismatch:
    """Return why the target was not found: another board is in view, or none."""
    asked = f"{target.columns} x {target.rows}"
    other = _other_grid(shown, full, target)
    if other is not None:
        return TargetMismatch(f"A {other[0]} x {other[1]} grid is in view, {asked} was asked for.")
    if goes_on:
        return TargetMismatch(f"A grid larger than {asked} is in view.")
    return TargetNotFound(f"No chessboard of {asked} inner corners was found.")


def _other_grid(
    shown: UInt8[np.ndarray, "h w"], full: np.ndarray, target: TargetSpec
) -> tuple[int, int] | None:
    """Return columns and rows of another whole board in view, the larger number first, or None."""
    reduced = next(_reduced_images(shown))
    found, corners, meta = cv2.findChessboardCornersSBWithMeta(reduced.image, (3, 3), _ANY_GRID)
    if not found or corners is None or meta is None or meta.size < _LEAST_OTHER_GRID:
        return None
    grid = right_handed(reduced.to_full(np.asarray(corners, dtype=np.float64).reshape(*meta.shape[:2], 2)))
    if not lattice.is_smooth(grid):
        return None
    squares = lattice.Squares(full, grid)
    if not squares.are_a_chessboard() or squares.continue_beyond().any() or squares.leave_the_image().any():
        return None
    size = (max(meta.shape[:2]), min(meta.shape[:2]))
    return None if size == (max(target.columns, target.rows), min(target.columns, target.rows)) else size
