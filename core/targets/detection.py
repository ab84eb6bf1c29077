"""The one way from an image to grid points."""

from __future__ import annotations

import numpy as np
from jaxtyping import UInt8, UInt16

from core.errors import InvalidArgument, InvalidTarget, TargetNotFound
from core.targets.aprilgrid import aprilgrid_layout, detect_aprilgrid
from core.targets.charuco import charuco_layout, detect_charuco
from core.targets.chessboard import detect_chessboard
from core.targets.circles import detect_circles
from core.targets.specification import GridPoints, TargetSpec
from core.targets.target_fields import check_marker_size

_DETECTORS = {
    "chessboard": detect_chessboard,
    "charuco": detect_charuco,
    "circles": detect_circles,
    "asymmetric_circles": detect_circles,
    "aprilgrid": detect_aprilgrid,
}
_MIN_PITCH_PX = 4.0


def check_detectable(target: TargetSpec) -> None:
    """Raise InvalidTarget where `detect` cannot find such a target in any image, or no such target can be printed."""
    if min(target.grid_columns, target.grid_rows) < 3:
        raise InvalidTarget(
            f"A target of {target.columns} x {target.rows} grid points cannot be distinguished from clutter.",
            "Use one with at least 3 grid points each way.",
            field="columns" if target.grid_columns < 3 else "rows",
        )
    if target.kind == "charuco":
        charuco_layout(target)
    if target.kind == "aprilgrid":
        aprilgrid_layout(target)
    check_marker_size(target)


def detect(image: UInt8[np.ndarray, "h w"] | UInt16[np.ndarray, "h w"], target: TargetSpec) -> GridPoints:
    """Find a target's grid points in an image.

    Parameters
    ----------
    image
        Grey values.
    target
        What to look for: all of it must be in view, of a chessboard a part that carries the marked squares, of a
        ChArUco board eight corners and some markers in two rows, of an AprilGrid tags of two rows; of dots half must be
        free, or a part that ends with the image and has the larger dot of the origin.

    Returns
    -------
    GridPoints
        The points found, row-major, with the origin by the convention of `core.targets.chessboard.orientation`, or as
        determined by a ChArUco board's or an AprilGrid's markers, by a chessboard's marked squares, or by a larger dot
        at the origin of a board of dots.

    Raises
    ------
    InvalidArgument
        The image is not grey with 8 or 16 bits.
    InvalidTarget
        No such target can be detected.
    TargetNotFound
        The target is not in the image, or not wholly.
    TargetMismatch
        Another grid is in view.
    TargetMirrored
        The target is in view, but mirrored.
    OriginUnknown
        Part of the target is in view, and nothing determines which part.
    """
    if image.ndim != 2 or image.dtype not in (np.uint8, np.uint16):
        raise InvalidArgument(f"The image must be grey and uint8 or uint16, got {image.dtype} {image.shape}.")
    check_detectable(target)
    long, short = max(target.grid_columns, target.grid_rows), min(target.grid_columns, target.grid_rows)
    if max(image.shape) < long * _MIN_PITCH_PX or min(image.shape) < short * _MIN_PITCH_PX:
        raise TargetNotFound(
            f"An image of {image.shape[1]} x {image.shape[0]} pixels is too small for a grid of "
            f"{target.columns} x {target.rows}."
        )
    return _DETECTORS[target.kind](image, target)
