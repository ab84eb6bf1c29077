"""A session's poses against what the robot was commanded: accuracy, and the camera on the flange."""

from core.session.commanded_poses.accuracy import SCALE_MISMATCHES, Accuracy, assess_accuracy
from core.session.commanded_poses.equal_commands import command_key, distinct_commands
from core.session.commanded_poses.hand_eye import (
    HandEyeStation,
    HeldOut,
    SessionHandEye,
    calibrate_session_hand_eye,
)
from core.session.commanded_poses.other_mount import MOUNT_UNLIKELY
from core.session.commanded_poses.units import UnitContradiction, contradicted_unit

__all__ = [
    "MOUNT_UNLIKELY",
    "SCALE_MISMATCHES",
    "Accuracy",
    "HandEyeStation",
    "HeldOut",
    "SessionHandEye",
    "UnitContradiction",
    "assess_accuracy",
    "calibrate_session_hand_eye",
    "command_key",
    "contradicted_unit",
    "distinct_commands",
]
