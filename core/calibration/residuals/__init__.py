"""Residuals of views and their derivatives by camera and pose: what every fit before a camera spends its time on."""

from core.calibration.residuals.all_views import normal_equations
from core.calibration.residuals.any_lens import (
    BROWN_SIZE,
    View,
    descend,
    products_of_view,
    residuals_with_jacobian,
)

__all__ = [
    "BROWN_SIZE",
    "View",
    "descend",
    "normal_equations",
    "products_of_view",
    "residuals_with_jacobian",
]
