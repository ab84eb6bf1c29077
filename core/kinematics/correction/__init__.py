"""Correction of commands: joint angles at which the identified arm is where the nominal one would be."""

from core.kinematics.correction.components import CorrectableComponents
from core.kinematics.correction.confirmation import MAX_CONFIRMING_RATIO, curves_ratio
from core.kinematics.correction.error_map import KinematicErrorMap, kinematic_error, map_kinematic_error
from core.kinematics.correction.inverse_kinematics import solve_inverse
from core.kinematics.correction.model import CorrectionErrors, CorrectionModel, correction_model
from core.kinematics.correction.solution import Corrected, Outcome, correct

__all__ = [
    "MAX_CONFIRMING_RATIO",
    "CorrectableComponents",
    "Corrected",
    "CorrectionErrors",
    "CorrectionModel",
    "KinematicErrorMap",
    "Outcome",
    "correct",
    "correction_model",
    "curves_ratio",
    "kinematic_error",
    "map_kinematic_error",
    "solve_inverse",
]
