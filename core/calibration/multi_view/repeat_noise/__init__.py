"""Noise of grid points from the repeats of a pose: its correlation over the image, the scatter of poses it makes."""

from core.calibration.multi_view.repeat_noise.contrasts import PoseContrasts, pose_contrasts
from core.calibration.multi_view.repeat_noise.estimation import (
    NoiseModel,
    OwnFit,
    RepeatScatter,
    correlated_scatter,
)
from core.calibration.multi_view.repeat_noise.image_evidence import image_p_values

__all__ = [
    "NoiseModel",
    "OwnFit",
    "PoseContrasts",
    "RepeatScatter",
    "correlated_scatter",
    "image_p_values",
    "pose_contrasts",
]
