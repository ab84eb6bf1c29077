"""A robot's parameters from a session: its poses with joint angles, their sweeps, and the identification."""

from core.session.robot.correction import SessionCorrection, session_correction
from core.session.robot.error_map import SessionErrorMap, session_error_map, workspace_limits
from core.session.robot.identification import identify_robot
from core.session.robot.method_agreement import MethodDifference
from core.session.robot.result import RobotIdentification
from core.session.robot.robot_poses import (
    MAX_POSES,
    RobotPoses,
    gather_robot_poses,
    poses_of_readings,
    semidefinite,
    shared_error_columns,
    shared_errors,
    with_nominal_orientations,
)
from core.session.robot.sweeps import NamedSweep

__all__ = [
    "MAX_POSES",
    "MethodDifference",
    "NamedSweep",
    "RobotIdentification",
    "RobotPoses",
    "SessionCorrection",
    "SessionErrorMap",
    "gather_robot_poses",
    "identify_robot",
    "poses_of_readings",
    "semidefinite",
    "session_correction",
    "session_error_map",
    "shared_error_columns",
    "shared_errors",
    "with_nominal_orientations",
    "workspace_limits",
]
