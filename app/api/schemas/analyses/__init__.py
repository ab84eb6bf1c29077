"""Analyses of a session as JSON."""

from app.api.schemas.analyses.budget import BudgetMethod
from app.api.schemas.analyses.camera_poses import CameraPosesAnalysis
from app.api.schemas.analyses.common import AcceptanceDecision
from app.api.schemas.analyses.comparison import ComparisonAnalysis
from app.api.schemas.analyses.dh.compensation import Compensation, CompensationCreate
from app.api.schemas.analyses.dh.error_model import DhMethod, DhModel
from app.api.schemas.analyses.dh.identification import DhAnalysis
from app.api.schemas.analyses.dh.joint_noise import JointNoiseAnalysis
from app.api.schemas.analyses.dh.kinematic_error import KinematicErrorAnalysis
from app.api.schemas.analyses.dh.next_view import NextViewAnalysis, NextViewCreate
from app.api.schemas.analyses.dh.observability import DhUncertaintyMethod
from app.api.schemas.analyses.dh.plan import DhPlan, DhPlanCreate
from app.api.schemas.analyses.hand_eye import HandEyeAnalysis
from app.api.schemas.analyses.intrinsics import CameraFileFormat, IntrinsicsAnalysis
from app.api.schemas.analyses.qualification import QualificationAnalysis, QualificationCreate
from app.api.schemas.analyses.repeatability import RepeatabilityAnalysis
from app.api.schemas.camera import LensModel

__all__ = [
    "AcceptanceDecision",
    "BudgetMethod",
    "CameraFileFormat",
    "CameraPosesAnalysis",
    "ComparisonAnalysis",
    "Compensation",
    "CompensationCreate",
    "DhAnalysis",
    "DhMethod",
    "DhModel",
    "DhPlan",
    "DhPlanCreate",
    "DhUncertaintyMethod",
    "Estimator",
    "HandEyeAnalysis",
    "IntrinsicsAnalysis",
    "JointNoiseAnalysis",
    "KinematicErrorAnalysis",
    "LensModel",
    "NextViewAnalysis",
    "NextViewCreate",
    "QualificationAnalysis",
    "QualificationCreate",
    "RepeatabilityAnalysis",
    "Source",
]
