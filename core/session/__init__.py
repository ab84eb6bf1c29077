"""Results of a whole session: cameras and poses, repeatability, accuracy, the robot's kinematics.

A session is a value, `SessionData`. Its `SessionEstimate` is computed once and passed on to what needs it.

Modules are loaded when a name of theirs is first used: a process that only reads the values of a session does without
the statistics and kinematics.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from core.session.acceptance import LimitAcceptance, SessionAcceptance, assess_acceptance
    from core.session.calibration import CalibratedSession, TaggedImage, calibrate_session
    from core.session.commanded_poses import (
        HandEyeStation,
        HeldOut,
        SessionHandEye,
        calibrate_session_hand_eye,
    )
    from core.session.estimation import estimate_session, worst_poses
    from core.session.image_selection import SelectedImages, select_images
    from core.session.lens_model import observed_radius
    from core.session.model import (
        NO_TARGET,
        CameraViews,
        CommandedPose,
        Datasheet,
        ExcludedMeasurement,
        ExcludedPose,
        FocusGroup,
        ImageObservation,
        MeasuredPose,
        SessionData,
        SessionEstimate,
        group_views,
        natural,
    )
    from core.session.performance import Approaches, PoseDistance
    from core.session.pose_rows import DRIFT_BLOCK, PoseRow, drift_of, image_rows, measured_rows
    from core.session.poses_by_image import ImagePose, image_poses
    from core.session.qualification import qualify_session
    from core.session.repeatability import SessionRepeatability, assess_repeatability
    from core.session.robot import (
        MethodDifference,
        NamedSweep,
        RobotIdentification,
        identify_robot,
        semidefinite,
        with_nominal_orientations,
    )
    from core.session.steadiness import SessionSteadiness
    from core.session.targets import RefinedTarget, refine_target, target_transforms

_NAMES = {
    "qualification": ("qualify_session",),
    "acceptance": ("LimitAcceptance", "SessionAcceptance", "assess_acceptance"),
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
        "estimate_session",
        "worst_poses",
    ),
    "poses_by_image": (
        "ImagePose",
        "image_poses",
    ),
    "image_selection": (
        "SelectedImages",
        "select_images",
    ),
    "lens_model": ("observed_radius",),
    "model": (
        "NO_TARGET",
        "CameraViews",
        "CommandedPose",
        "Datasheet",
        "ExcludedMeasurement",
        "ExcludedPose",
        "FocusGroup",
        "ImageObservation",
        "MeasuredPose",
        "SessionData",
        "SessionEstimate",
        "group_views",
        "natural",
    ),
    "performance": (
        "Approaches",
        "PoseDistance",
    ),
    "pose_rows": ("DRIFT_BLOCK", "PoseRow", "drift_of", "image_rows", "measured_rows"),
    "repeatability": ("SessionRepeatability", "assess_repeatability"),
    "robot": (
        "MethodDifference",
        "NamedSweep",
        "RobotIdentification",
        "identify_robot",
        "semidefinite",
        "with_nominal_orientations",
    ),
    "steadiness": ("SessionSteadiness",),
    "targets": (
        "RefinedTarget",
        "refine_target",
        "target_transforms",
    ),
}
_MODULE_OF = {name: module for module, names in _NAMES.items() for name in names}

__all__ = [
    "DRIFT_BLOCK",
    "NO_TARGET",
    "Approaches",
    "CalibratedSession",
    "CameraViews",
    "CommandedPose",
    "Datasheet",
    "ExcludedMeasurement",
    "ExcludedPose",
    "FocusGroup",
    "HandEyeStation",
    "HeldOut",
    "ImageObservation",
    "ImagePose",
    "LimitAcceptance",
    "MeasuredPose",
    "MethodDifference",
    "NamedSweep",
    "PoseDistance",
    "PoseRow",
    "RefinedTarget",
    "RobotIdentification",
    "SelectedImages",
    "SessionAcceptance",
    "SessionData",
    "SessionEstimate",
    "SessionHandEye",
    "SessionRepeatability",
    "SessionSteadiness",
    "TaggedImage",
    "assess_acceptance",
    "assess_repeatability",
    "calibrate_session",
    "calibrate_session_hand_eye",
    "drift_of",
    "estimate_session",
    "group_views",
    "identify_robot",
    "image_poses",
    "image_rows",
    "measured_rows",
    "natural",
    "observed_radius",
    "qualify_session",
    "refine_target",
    "select_images",
    "semidefinite",
    "target_transforms",
    "with_nominal_orientations",
    "worst_poses",
]


def __getattr__(name: str) -> Any:
    """Load the module that defines a public name."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
