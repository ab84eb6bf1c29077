"""The robot's kinematics as JSON: what was identified, its validation, and plans of poses."""

from app.api.schemas.analyses.dh.compensation import Compensation, CompensationCreate
from app.api.schemas.analyses.dh.error_model import DhMethod, DhModel
from app.api.schemas.analyses.dh.identification import DhAnalysis
from app.api.schemas.analyses.dh.joint_noise import JointNoiseAnalysis
from app.api.schemas.analyses.dh.kinematic_error import KinematicErrorAnalysis
from app.api.schemas.analyses.dh.next_view import NextViewAnalysis, NextViewCreate
from app.api.schemas.analyses.dh.observability import DhUncertaintyMethod
from app.api.schemas.analyses.dh.plan import DhPlan, DhPlanCreate
from app.api.schemas.analyses.dh.validation import PoseErrors

__all__ = [
    "Compensation",
    "CompensationCreate",
    "DhAnalysis",
    "DhMethod",
    "DhModel",
    "DhPlan",
    "DhPlanCreate",
    "DhUncertaintyMethod",
    "JointNoiseAnalysis",
    "KinematicErrorAnalysis",
    "NextViewAnalysis",
    "NextViewCreate",
    "PoseErrors",
]
