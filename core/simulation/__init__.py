"""Ground truth for tests, the demo and planning: scenes whose every grid point is known, and their images."""

from core.simulation.arm import KR5_ARC, KR5_ARC_HOME, KR5_ARC_LIMITS, Arm, free_angles, kr5_arc, sweep_angles
from core.simulation.renderer import render
from core.simulation.robot import SessionImage
from core.simulation.scenes import Light, Scene, standard_camera, standard_scene, standard_target
from core.simulation.sweeps import Repeatability, measure_poses

__all__ = [
    "KR5_ARC",
    "KR5_ARC_HOME",
    "KR5_ARC_LIMITS",
    "Arm",
    "Light",
    "Repeatability",
    "Scene",
    "SessionImage",
    "free_angles",
    "kr5_arc",
    "measure_poses",
    "render",
    "standard_camera",
    "standard_scene",
    "standard_target",
    "sweep_angles",
]
