"""Noise of grid points from the repeats of a pose: its correlation over the image, the scatter of poses it makes."""

from core.calibration.multi_view.repeat_noise.contrasts import PoseContrasts, pose_contrasts
from core.calibration.multi_view.repeat_noise.estimation import (
    NoiseModel,
    OwnFit,
    RepeatScatter,
    correlated_scatter,
)

__all__ = ["NoiseModel", "OwnFit", "PoseContrasts", "RepeatScatter", "correlated_scatter", "pose_contrasts"]
