"""What a robot has beyond its Denavit-Hartenberg chain: joint curves, compliance and wobble, as terms with priors."""

from core.kinematics.error_model.curves import (
    JointCompliance,
    JointCurve,
    JointRegion,
    joint_compliance,
    joint_curves,
    joint_regions,
)
from core.kinematics.error_model.fit import ErrorFit, Level, fit_levels
from core.kinematics.error_model.linear_problem import Design, design
from core.kinematics.error_model.model import ErrorModel, Prediction, choose_model

__all__ = [
    "Design",
    "ErrorFit",
    "ErrorModel",
    "JointCompliance",
    "JointCurve",
    "JointRegion",
    "Level",
    "Prediction",
    "choose_model",
    "design",
    "fit_levels",
    "joint_compliance",
    "joint_curves",
    "joint_regions",
]
