"""Results of a whole session: cameras and poses, repeatability, accuracy, the robot's kinematics.

A session is a value, `SessionData`. Its `SessionEstimate` is computed once and passed on to what needs it.

Modules are loaded when a name of theirs is first used: a process that only reads the values of a session does without
the statistics and kinematics.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from core.session.calibration import CalibratedSession, TaggedImage, calibrate_session
    from core.session.commanded_poses import (
        HandEyeStation,
        HeldOut,
        SessionHandEye,
        calibrate_session_hand_eye,
    )
    from core.session.estimate import ExcludedMeasurement, ExcludedPose, FocusGroup, SessionEstimate
    from core.session.estimation import (
        ImagePose,
        RefinedTarget,
        SelectedImages,
        estimate_session,
        image_poses,
        observed_radius,
        refine_target,
        select_images,
        target_transforms,
        worst_poses,
    )
    from core.session.joint_noise import (
        NORMAL_FACTOR,
        HeldOutScatter,
        MapCell,
        PredictedScatter,
        RepeatabilityMap,
        SessionJointNoise,
        assess_joint_noise,
    )
    from core.session.model import (
        NO_TARGET,
        CameraViews,
        CommandedPose,
        Datasheet,
        ImageObservation,
        MeasuredPose,
        SessionData,
        group_views,
        natural,
    )
    from core.session.next_view import NextViews, suggest_views
    from core.session.qualification import qualify_session
    from core.session.repeatability import (
        DRIFT_BLOCK,
        Approaches,
        BurstFloor,
        BurstNoise,
        Figure,
        FigureBudget,
        LimitAcceptance,
        PoseDistance,
        PoseRow,
        SessionAcceptance,
        SessionBudgets,
        SessionRepeatability,
        SessionSteadiness,
        Witness,
        WitnessMotion,
        assess_acceptance,
        assess_repeatability,
        drift_of,
        image_rows,
        images_of,
        measured_rows,
        session_budgets,
    )
    from core.session.robot import (
        MethodDifference,
        NamedSweep,
        RobotIdentification,
        SessionCorrection,
        identify_robot,
        semidefinite,
        session_correction,
        with_nominal_orientations,
    )

_NAMES = {
    "calibration": (
        "CalibratedSession",
        "TaggedImage",
        "calibrate_session",
    ),
    "commanded_poses": (
        "HandEyeStation",
        "HeldOut",
        "SessionHandEye",
        "calibrate_session_hand_eye",
    ),
    "estimation": (
        "ImagePose",
        "RefinedTarget",
        "SelectedImages",
        "estimate_session",
        "image_poses",
        "observed_radius",
        "refine_target",
        "select_images",
        "target_transforms",
        "worst_poses",
    ),
    "estimate": (
        "ExcludedMeasurement",
        "ExcludedPose",
        "FocusGroup",
        "SessionEstimate",
    ),
    "joint_noise": (
        "NORMAL_FACTOR",
        "HeldOutScatter",
        "MapCell",
        "PredictedScatter",
        "RepeatabilityMap",
        "SessionJointNoise",
        "assess_joint_noise",
    ),
    "model": (
        "NO_TARGET",
        "CameraViews",
        "CommandedPose",
        "Datasheet",
        "ImageObservation",
        "MeasuredPose",
        "SessionData",
        "group_views",
        "natural",
    ),
    "next_view": ("NextViews", "suggest_views"),
    "qualification": ("qualify_session",),
    "repeatability": (
        "DRIFT_BLOCK",
        "Approaches",
        "BurstFloor",
        "BurstNoise",
        "Figure",
        "FigureBudget",
        "LimitAcceptance",
        "PoseDistance",
        "PoseRow",
        "SessionAcceptance",
        "SessionBudgets",
        "SessionRepeatability",
        "SessionSteadiness",
        "Witness",
        "WitnessMotion",
        "assess_acceptance",
        "assess_repeatability",
        "drift_of",
        "image_rows",
        "images_of",
        "measured_rows",
        "session_budgets",
    ),
    "robot": (
        "MethodDifference",
        "NamedSweep",
        "RobotIdentification",
        "SessionCorrection",
        "identify_robot",
        "semidefinite",
        "session_correction",
        "with_nominal_orientations",
    ),
}
_MODULE_OF = {name: module for module, names in _NAMES.items() for name in names}

__all__ = [
    "DRIFT_BLOCK",
    "NORMAL_FACTOR",
    "NO_TARGET",
    "Approaches",
    "BurstFloor",
    "BurstNoise",
    "CalibratedSession",
    "CameraViews",
    "CommandedPose",
    "Datasheet",
    "ExcludedMeasurement",
    "ExcludedPose",
    "Figure",
    "FigureBudget",
    "FocusGroup",
    "HandEyeStation",
    "HeldOut",
    "HeldOutScatter",
    "ImageObservation",
    "ImagePose",
    "LimitAcceptance",
    "MapCell",
    "MeasuredPose",
    "MethodDifference",
    "NamedSweep",
    "NextViews",
    "PoseDistance",
    "PoseRow",
    "PredictedScatter",
    "RefinedTarget",
    "RepeatabilityMap",
    "RobotIdentification",
    "SelectedImages",
    "SessionAcceptance",
    "SessionBudgets",
    "SessionCorrection",
    "SessionData",
    "SessionEstimate",
    "SessionHandEye",
    "SessionJointNoise",
    "SessionRepeatability",
    "SessionSteadiness",
    "TaggedImage",
    "Witness",
    "WitnessMotion",
    "assess_acceptance",
    "assess_joint_noise",
    "assess_repeatability",
    "calibrate_session",
    "calibrate_session_hand_eye",
    "drift_of",
    "estimate_session",
    "group_views",
    "identify_robot",
    "image_poses",
    "image_rows",
    "images_of",
    "measured_rows",
    "natural",
    "observed_radius",
    "qualify_session",
    "refine_target",
    "select_images",
    "semidefinite",
    "session_budgets",
    "session_correction",
    "suggest_views",
    "target_transforms",
    "with_nominal_orientations",
    "worst_poses",
]


def __getattr__(name: str) -> Any:
    """Load the module that defines a public name."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
