"""Hand-eye calibration: the transforms between robot and camera, as needed for pose accuracy.

`calibrate_hand_eye` uses complete commanded poses (given, or from joint angles through forward kinematics).
`calibrate_from_positions` uses commanded positions alone.
"""

from core.calibration.hand_eye.answer_checks import CORRECT_PITCH, scale_warnings
from core.calibration.hand_eye.calibration import MIN_POSES_TO_REJECT, calibrate_hand_eye
from core.calibration.hand_eye.further_stations import information_so_far, station_information
from core.calibration.hand_eye.initialisation import frame_rotations
from core.calibration.hand_eye.position_only import PositionOnlyCalibration, calibrate_from_positions
from core.calibration.hand_eye.position_start import turn_by_positions
from core.calibration.hand_eye.result import (
    HandEyeCalibration,
    HandEyeObservation,
    PoseResidual,
    PositionObservation,
    average_station,
)

__all__ = [
    "CORRECT_PITCH",
    "MIN_POSES_TO_REJECT",
    "HandEyeCalibration",
    "HandEyeObservation",
    "PoseResidual",
    "PositionObservation",
    "PositionOnlyCalibration",
    "average_station",
    "calibrate_from_positions",
    "calibrate_hand_eye",
    "frame_rotations",
    "information_so_far",
    "scale_warnings",
    "station_information",
    "turn_by_positions",
]
