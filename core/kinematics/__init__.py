"""A robot's geometry: Denavit-Hartenberg chains, joint axes from sweeps, and their identification with uncertainty."""

from core.kinematics.arm_model import ParameterLayout
from core.kinematics.circle_point_analysis import AxesIdentification, identify_from_axes, reparametrise
from core.kinematics.dh import (
    JOINT_PARAMETERS,
    Chain,
    JointParameters,
    forward,
    frames,
    link_transform,
    pose_with_jacobian,
)
from core.kinematics.error_model import (
    ErrorModel,
    JointCompliance,
    JointCurve,
    JointRegion,
    Level,
    joint_compliance,
    joint_curves,
    joint_regions,
)
from core.kinematics.extension import ModelChoice
from core.kinematics.global_fit import (
    FOLDS,
    BlockErrors,
    Blocking,
    Conditioning,
    HoldOutError,
    Unidentifiable,
    Validation,
    conditioning_of_chain,
    rms,
)
from core.kinematics.identification import identify
from core.kinematics.identification_from_images import ImageIdentification, identify_from_images
from core.kinematics.identification_result import Identification
from core.kinematics.joint_angle_checks import check_angles
from core.kinematics.planning import CameraSetup, Prediction, default_setup, predict, suggest_poses
from core.kinematics.pose_observations import PoseData, stack_joint_angles
from core.kinematics.results import JointEstimate
from core.kinematics.sweeps import Sweep, find_sweeps, named_sweeps
from core.kinematics.target_transforms import TargetTransform

__all__ = [
    "FOLDS",
    "JOINT_PARAMETERS",
    "AxesIdentification",
    "BlockErrors",
    "Blocking",
    "CameraSetup",
    "Chain",
    "Conditioning",
    "ErrorModel",
    "HoldOutError",
    "Identification",
    "ImageIdentification",
    "JointCompliance",
    "JointCurve",
    "JointEstimate",
    "JointParameters",
    "JointRegion",
    "Level",
    "ModelChoice",
    "ParameterLayout",
    "PoseData",
    "Prediction",
    "Sweep",
    "TargetTransform",
    "Unidentifiable",
    "Validation",
    "check_angles",
    "conditioning_of_chain",
    "default_setup",
    "find_sweeps",
    "forward",
    "frames",
    "identify",
    "identify_from_axes",
    "identify_from_images",
    "joint_compliance",
    "joint_curves",
    "joint_regions",
    "link_transform",
    "named_sweeps",
    "pose_with_jacobian",
    "predict",
    "reparametrise",
    "rms",
    "stack_joint_angles",
    "suggest_poses",
]
