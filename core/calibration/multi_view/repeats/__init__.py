"""Noise of grid points from the repeats of a pose: its correlation over the image, the scatter of poses it makes."""

from core.calibration.multi_view.repeats.contrasts import pose_contrasts
from core.calibration.multi_view.repeats.image_evidence import image_p_values
from core.calibration.multi_view.repeats.noise_model import OwnFit, RepeatScatter, correlated_scatter

__all__ = [
    "OwnFit",
    "RepeatScatter",
    "correlated_scatter",
    "image_p_values",
    "pose_contrasts",
]
