"""Tying the robot's frames to the camera's: what accuracy against commanded poses needs.

`tie_frames` where commanded poses are whole (or come from joint angles through forward kinematics), `tie_positions`
where only positions were commanded; `attained_poses` then puts measured poses beside the commanded ones in the base
frame.
"""

from core.calibration.hand_eye.positions import PositionStation, PositionTie, tie_positions
from core.calibration.hand_eye.result import (
    FRAMES_STATE,
    AttainedPoses,
    Deviation,
    FrameTie,
    Mount,
    Station,
    attained_poses,
    average_station,
)
from core.calibration.hand_eye.tie import tie_frames

__all__ = [
    "FRAMES_STATE",
    "AttainedPoses",
    "Deviation",
    "FrameTie",
    "Mount",
    "PositionStation",
    "PositionTie",
    "Station",
    "attained_poses",
    "average_station",
    "tie_frames",
    "tie_positions",
]
