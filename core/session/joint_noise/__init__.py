"""Joint noise of a session's robot: what it predicts anywhere, how well at held-out poses, and where it is worst."""

from core.session.joint_noise.assessment import SessionJointNoise, assess_joint_noise
from core.session.joint_noise.held_out import validate_joint_noise
from core.session.joint_noise.prediction import NORMAL_FACTOR, PredictedScatter, predict_scatter
from core.session.joint_noise.workspace import RepeatabilityMap, map_repeatability

__all__ = [
    "NORMAL_FACTOR",
    "PredictedScatter",
    "RepeatabilityMap",
    "SessionJointNoise",
    "assess_joint_noise",
    "map_repeatability",
    "predict_scatter",
    "validate_joint_noise",
]
