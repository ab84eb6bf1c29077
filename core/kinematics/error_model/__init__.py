"""What a robot has beyond its Denavit-Hartenberg chain: joint curves, compliance and wobble, as terms with priors."""

from core.kinematics.error_model.curves import (
    JointRegion,
    joint_approach,
    joint_compliance,
    joint_curves,
    joint_regions,
    visited_angles,
)
from core.kinematics.error_model.fit import Level
from core.kinematics.error_model.held_out import growth, hold_out, variances
from core.kinematics.error_model.linear_problem import design
from core.kinematics.error_model.model import (
    STRONG_EVIDENCE,
    ErrorModel,
    choose_model,
    chosen_level,
    of_poses,
)
from core.kinematics.error_model.priors import FEW_POSES

__all__ = [
    "FEW_POSES",
    "STRONG_EVIDENCE",
    "ErrorModel",
    "JointRegion",
    "Level",
    "choose_model",
    "chosen_level",
    "design",
    "growth",
    "hold_out",
    "joint_approach",
    "joint_compliance",
    "joint_curves",
    "joint_regions",
    "of_poses",
    "variances",
    "visited_angles",
]
