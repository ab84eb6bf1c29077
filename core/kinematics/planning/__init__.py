"""Planning of poses: predicted uncertainties before the robot is moved, and the poses that would reduce them most."""

from core.kinematics.planning.camera_setup import CameraSetup, count_visible_points, default_setup
from core.kinematics.planning.pose_information import pose_information
from core.kinematics.planning.prediction import Prediction, predict
from core.kinematics.planning.selection import choose_informative, suggest_poses

__all__ = [
    "CameraSetup",
    "Prediction",
    "choose_informative",
    "count_visible_points",
    "default_setup",
    "pose_information",
    "predict",
    "suggest_poses",
]
