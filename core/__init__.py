"""Gridpose's numerics: arrays and bytes in, values out; no service, file, clock or log.

The door: `calibrate_image(data, TargetSpec("chessboard", 9, 6, 25.0)) -> Calibration`.
"""

from core.calibration.calibrate import TargetOutcome, calibrate_image, calibrate_targets
from core.calibration.model import Lens
from core.calibration.result import Calibration
from core.calibration.single_image import calibrate_points
from core.camera import Camera
from core.errors import Advisory, GridposeError
from core.targets.specification import GridPoints, TargetSpec

__all__ = [
    "Advisory",
    "Calibration",
    "Camera",
    "GridPoints",
    "GridposeError",
    "Lens",
    "TargetOutcome",
    "TargetSpec",
    "calibrate_image",
    "calibrate_points",
    "calibrate_targets",
]
__version__ = "0.1.0"
