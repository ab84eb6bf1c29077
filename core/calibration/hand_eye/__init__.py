"""Hand-eye calibration: the transforms between robot and camera, as needed for pose accuracy.

`calibrate_hand_eye` uses complete commanded poses (given, or from joint angles through forward kinematics).
`calibrate_from_positions` uses commanded positions alone. `attained_poses` transforms measured poses to the base frame,
for comparison with the commanded ones.
"""

from core.calibration.hand_eye.calibration import MIN_POSES_TO_REJECT, calibrate_hand_eye
from core.calibration.hand_eye.further_stations import information_so_far, station_information
from core.calibration.hand_eye.initialisation import frame_rotations
from core.calibration.hand_eye.position_only import PositionOnlyCalibration, calibrate_from_positions
from core.calibration.hand_eye.result import (
    FRAMES_STATE,
    AttainedPoses,
    CameraMountPrior,
    HandEyeCalibration,
    HandEyeObservation,
    PoseResidual,
    PositionObservation,
    attained_poses,
    average_station,
)

__all__ = [
    "FRAMES_STATE",
    "MIN_POSES_TO_REJECT",
    "AttainedPoses",
    "CameraMountPrior",
    "HandEyeCalibration",
    "HandEyeObservation",
    "PoseResidual",
    "PositionObservation",
    "PositionOnlyCalibration",
    "attained_poses",
    "average_station",
    "calibrate_from_positions",
    "calibrate_hand_eye",
    "frame_rotations",
    "information_so_far",
    "station_information",
]
