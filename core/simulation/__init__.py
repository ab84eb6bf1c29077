"""Ground truth for tests, the demo and planning: scenes whose every grid point is known, and their images."""

from core.simulation.renderer import render
from core.simulation.robot import SessionImage, robot_session
from core.simulation.scenes import Light, Scene, standard_camera, standard_scene, standard_target

__all__ = [
    "Light",
    "Scene",
    "SessionImage",
    "render",
    "robot_session",
    "standard_camera",
    "standard_scene",
    "standard_target",
]
