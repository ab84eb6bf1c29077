"""Analyses of a session as JSON."""

from app.api.schemas.analyses.camera_poses import CameraPosesAnalysis
from app.api.schemas.analyses.common import Estimator, Source
from app.api.schemas.analyses.comparison import ComparisonAnalysis
from app.api.schemas.analyses.dh import DhAnalysis
from app.api.schemas.analyses.dh_model import DhMethod, DhModel
from app.api.schemas.analyses.dh_plan import DhPlan, DhPlanCreate
from app.api.schemas.analyses.hand_eye import HandEyeAnalysis
from app.api.schemas.analyses.intrinsics import IntrinsicsAnalysis
from app.api.schemas.analyses.qualification import QualificationAnalysis, QualificationCreate
from app.api.schemas.analyses.repeatability import RepeatabilityAnalysis
from app.api.schemas.camera import LensModel

__all__ = [
    "CameraPosesAnalysis",
    "ComparisonAnalysis",
    "DhAnalysis",
    "DhMethod",
    "DhModel",
    "DhPlan",
    "DhPlanCreate",
    "Estimator",
    "HandEyeAnalysis",
    "IntrinsicsAnalysis",
    "LensModel",
    "QualificationAnalysis",
    "QualificationCreate",
    "RepeatabilityAnalysis",
    "Source",
]
