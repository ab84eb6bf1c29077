"""Fits of a focus group's images before a camera that they share, or one that is known."""

from core.calibration.multi_view.fitting.initialisation import Fitted, first_failure, fit_with_known_camera
from core.calibration.multi_view.fitting.pooled import (
    CONTRADICTION,
    calibrate_views,
    fit_pooled,
    lens_warning,
)

__all__ = [
    "CONTRADICTION",
    "Fitted",
    "calibrate_views",
    "first_failure",
    "fit_pooled",
    "fit_with_known_camera",
    "lens_warning",
]
