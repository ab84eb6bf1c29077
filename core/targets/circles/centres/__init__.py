"""Dots at full resolution: ellipses fitted to them, and the images of their centres."""

from core.targets.circles.centres.ellipse_fit import (
    MIN_DOTS,
    ODD,
    FittedDots,
    fit_dots,
    fourth_harmonic_share,
    outlines,
    plane_map,
    step_variance,
)
from core.targets.circles.centres.lens_map import PARAMETERS as LENS_PARAMETERS
from core.targets.circles.centres.perspective import perspective_corrected_centres

__all__ = [
    "LENS_PARAMETERS",
    "MIN_DOTS",
    "ODD",
    "FittedDots",
    "fit_dots",
    "fourth_harmonic_share",
    "outlines",
    "perspective_corrected_centres",
    "plane_map",
    "step_variance",
]
