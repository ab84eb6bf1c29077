"""The robot's kinematics from poses of known joint angles: methods, choice of the error model, and the result."""

from core.kinematics.identification.extension import ModelChoice
from core.kinematics.identification.from_poses import MIN_JOINT_RANGE, identify
from core.kinematics.identification.result import Identification
from core.kinematics.identification.sampling import ParameterSampling

__all__ = [
    "MIN_JOINT_RANGE",
    "Identification",
    "ModelChoice",
    "ParameterSampling",
    "identify",
]
