"""Repeatability and accuracy of a session's poses: its rows, steadiness, absolute figures, acceptance and warnings."""

from core.session.repeatability.acceptance import SessionAcceptance, assess_acceptance
from core.session.repeatability.assessment import SessionRepeatability, assess_repeatability
from core.session.repeatability.budget import FigureBudget, SessionBudgets, session_budgets
from core.session.repeatability.performance import Approaches, PoseDistance
from core.session.repeatability.pose_rows import (
    DRIFT_BLOCK,
    PoseRow,
    accuracy_drift_of,
    drift_of,
    image_rows,
    measured_rows,
)
from core.session.repeatability.steadiness import SessionSteadiness
from core.session.repeatability.stops import (
    BurstFloor,
    BurstNoise,
    burst_noise,
    burst_warnings,
    with_burst_noise,
)
from core.session.repeatability.witness import Witness, WitnessMotion

__all__ = [
    "DRIFT_BLOCK",
    "Approaches",
    "BurstFloor",
    "BurstNoise",
    "FigureBudget",
    "PoseDistance",
    "PoseRow",
    "SessionAcceptance",
    "SessionBudgets",
    "SessionRepeatability",
    "SessionSteadiness",
    "Witness",
    "WitnessMotion",
    "accuracy_drift_of",
    "assess_acceptance",
    "assess_repeatability",
    "burst_noise",
    "burst_warnings",
    "drift_of",
    "image_rows",
    "measured_rows",
    "session_budgets",
    "with_burst_noise",
]
