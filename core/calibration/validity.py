"""Validation of the inputs of a fit: reject what would give meaningless numbers."""

from __future__ import annotations

import math

import numpy as np

from core.calibration.priors import Lens
from core.errors import DegenerateGeometry, InvalidArgument
from core.geometry import Camera
from core.targets import GridPoints

FOCAL_RANGE = (0.01, 1000.0)  # of the image's longer side: from a fish-eye's to a telescope's
MAX_COORDINATE_PX = 1e6  # px, from the image's corner
MAX_UNCERTAINTY_RATIO = 1e6  # of standard uncertainties within one image


def check_points(points: GridPoints) -> None:
    """Raise InvalidArgument or DegenerateGeometry unless the points can be fitted."""
    if points.image_width_px < 1 or points.image_height_px < 1:
        raise InvalidArgument("The image must have at least one pixel.")
    if not np.all(np.abs(points.points_px) < MAX_COORDINATE_PX):  # NaN fails too
        raise InvalidArgument("Grid points must have finite pixel coordinates within reason.")
    uncertainty = points.standard_uncertainty_px
    if len(points) and not (
        np.all(uncertainty > 0) and np.all(uncertainty < MAX_UNCERTAINTY_RATIO * uncertainty.min())
    ):
        raise InvalidArgument("Standard uncertainties of grid points must be positive and comparable.")
    target = points.target
    inside = (
        (points.column >= 0)
        & (points.column < target.grid_columns)
        & (points.row >= 0)
        & (points.row < target.grid_rows)
    )
    if not np.all(inside):
        raise InvalidArgument(
            f"A grid point lies outside the target's {target.grid_columns} × {target.grid_rows} points."
        )
    keys = points.row.astype(np.int64) * points.target.grid_columns + points.column
    if len(points) and np.bincount(keys).max() > 1:
        raise DegenerateGeometry("A grid point is named twice.")


def check_lens(lens: Lens, points: GridPoints) -> None:
    """Raise InvalidArgument where no lens has the focal length stated."""
    _check_focal(
        lens.focal_px, points, "Check focal_length_mm and pixel_pitch_um: millimetres and micrometres."
    )


def check_camera(camera: Camera, points: GridPoints) -> None:
    """Raise InvalidArgument where given intrinsics cannot be those of a camera."""
    if not np.all(np.isfinite(camera.as_array())):
        raise InvalidArgument("The given intrinsics must be finite numbers.")
    for focal in (camera.fx_px, camera.fy_px):
        _check_focal(focal, points, "Check the session's intrinsics: focal lengths are in pixels.")


def _check_focal(focal: float, points: GridPoints, advice: str) -> None:
    longer = max(points.image_width_px, points.image_height_px)
    low, high = (factor * longer for factor in FOCAL_RANGE)
    if not (math.isfinite(focal) and low < focal < high):
        raise InvalidArgument(
            f"A focal length of {focal:.3g} px is not that of a camera with {longer} px.", advice
        )
