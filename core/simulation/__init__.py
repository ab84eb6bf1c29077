"""Ground truth for tests, the demo and planning: scenes whose every grid point is known, and their images."""

from core.simulation.arm import (
    KR5_ARC,
    KR5_ARC_HOME,
    KR5_ARC_LIMITS,
    T_FLANGE_CAMERA,
    Arm,
    free_angles,
    joint_motions,
    kr5_arc,
    sweep_angles,
)
from core.simulation.arm_session import ArmSession, simulate_arm_session
from core.simulation.background import background, illumination
from core.simulation.forecast import MAX_IMAGES_PER_STOP, Forecast, PlannedSession, forecast_repeatability
from core.simulation.looking import sample_viewing_configurations
from core.simulation.paper_experiment import JOINT_REPEATABILITY_RAD, CubePose, SessionImage, cube_experiment
from core.simulation.renderer import render, render_levels
from core.simulation.scenes import Light, Scene, random_pose

__all__ = [
    "JOINT_REPEATABILITY_RAD",
    "KR5_ARC",
    "KR5_ARC_HOME",
    "KR5_ARC_LIMITS",
    "MAX_IMAGES_PER_STOP",
    "T_FLANGE_CAMERA",
    "Arm",
    "ArmSession",
    "CubePose",
    "Forecast",
    "Light",
    "PlannedSession",
    "Scene",
    "SessionImage",
    "background",
    "cube_experiment",
    "forecast_repeatability",
    "free_angles",
    "illumination",
    "joint_motions",
    "kr5_arc",
    "random_pose",
    "render",
    "render_levels",
    "sample_viewing_configurations",
    "simulate_arm_session",
    "sweep_angles",
]
