"""The robot's kinematics from poses of known joint angles: methods, choice of the error model, and the result."""

from core.kinematics.identification.extension import ModelChoice
from core.kinematics.identification.from_images import ImageIdentification, identify_from_images
from core.kinematics.identification.from_poses import MIN_JOINT_RANGE, identify
from core.kinematics.identification.result import Identification
from core.kinematics.identification.sampling import ParameterSampling

__all__ = [
    "MIN_JOINT_RANGE",
    "Identification",
    "ImageIdentification",
    "ModelChoice",
    "ParameterSampling",
    "identify",
    "identify_from_images",
]
