"""Results of a whole session: cameras and poses, repeatability, accuracy, the robot's kinematics.

A session is a value, `SessionData`. Its `SessionEstimate` is computed once and passed on to what needs it.

Modules are loaded when a name of theirs is first used: a process that only reads the values of a session does without
the statistics and kinematics.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from core.session.absolute_poses import with_print_uncertainty
    from core.session.calibration import CalibratedSession, TaggedImage, calibrate_session
    from core.session.commanded_poses import (
        HandEyeStation,
        HeldOut,
        SessionHandEye,
        calibrate_session_hand_eye,
    )
    from core.session.estimate import ExcludedMeasurement, FocusGroup, SessionEstimate
    from core.session.estimation import (
        ImagePose,
        RefinedTarget,
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
        PredictedScatter,
        RepeatabilityMap,
        SessionJointNoise,
        assess_joint_noise,
    )
    from core.session.model import (
        NO_TARGET,
        CameraMount,
        CameraViews,
        CommandedPose,
        Datasheet,
        ImageObservation,
        MeasuredPose,
        SessionData,
        group_views,
        natural,
    )
    from core.session.next_view import (
        NextRobotViews,
        common_fit,
        suggest_dh_views,
        suggest_hand_eye_views,
        suggest_views,
        views_of_candidates,
    )
    from core.session.qualification import qualify_session
    from core.session.repeatability import (
        DRIFT_BLOCK,
        Approaches,
        BurstFloor,
        BurstNoise,
        FigureBudget,
        PoseDistance,
        PoseRow,
        SessionAcceptance,
        SessionBudgets,
        SessionRepeatability,
        SessionSteadiness,
        Witness,
        WitnessMotion,
        accuracy_drift_of,
        assess_acceptance,
        assess_repeatability,
        drift_of,
        image_rows,
        measured_rows,
        session_budgets,
    )
    from core.session.robot import (
        MethodDifference,
        NamedSweep,
        RobotIdentification,
        SessionCorrection,
        SessionErrorMap,
        identify_robot,
        semidefinite,
        session_correction,
        session_error_map,
        with_nominal_orientations,
    )
    from core.session.visits import images_of

__all__ = [
    "DRIFT_BLOCK",
    "NORMAL_FACTOR",
    "NO_TARGET",
    "Approaches",
    "BurstFloor",
    "BurstNoise",
    "CalibratedSession",
    "CameraMount",
    "CameraViews",
    "CommandedPose",
    "Datasheet",
    "ExcludedMeasurement",
    "FigureBudget",
    "FocusGroup",
    "HandEyeStation",
    "HeldOut",
    "ImageObservation",
    "ImagePose",
    "MeasuredPose",
    "MethodDifference",
    "NamedSweep",
    "NextRobotViews",
    "PoseDistance",
    "PoseRow",
    "PredictedScatter",
    "RefinedTarget",
    "RepeatabilityMap",
    "RobotIdentification",
    "SessionAcceptance",
    "SessionBudgets",
    "SessionCorrection",
    "SessionData",
    "SessionErrorMap",
    "SessionEstimate",
    "SessionHandEye",
    "SessionJointNoise",
    "SessionRepeatability",
    "SessionSteadiness",
    "TaggedImage",
    "Witness",
    "WitnessMotion",
    "accuracy_drift_of",
    "assess_acceptance",
    "assess_joint_noise",
    "assess_repeatability",
    "calibrate_session",
    "calibrate_session_hand_eye",
    "common_fit",
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
    "session_error_map",
    "suggest_dh_views",
    "suggest_hand_eye_views",
    "suggest_views",
    "target_transforms",
    "views_of_candidates",
    "with_nominal_orientations",
    "with_print_uncertainty",
    "worst_poses",
]
_MODULES = (
    *("model", "estimate", "estimation", "absolute_poses", "robot", "calibration", "joint_noise"),
    *("commanded_poses", "visits", "repeatability", "qualification", "next_view"),
)
"""Those that load least come first: from `robot` on, each loads the statistics and kinematics."""


def __getattr__(name: str) -> Any:
    """Load the modules in turn until one has the public name."""
    if name in __all__:
        for module in _MODULES:
            found = import_module(f"{__name__}.{module}")
            if hasattr(found, name):
                return getattr(found, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
