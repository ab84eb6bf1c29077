"""Noise of a robot's joints, from the scatter of repeated poses."""

from core.kinematics.joint_noise.fit import (
    JointNoise,
    chi_ratio,
    fit_joint_noise,
    log_likelihood,
    scatter_covariance,
)
from core.kinematics.joint_noise.scatter import PoseScatters, gather_scatters, joint_jacobian

__all__ = [
    "JointNoise",
    "PoseScatters",
    "chi_ratio",
    "fit_joint_noise",
    "gather_scatters",
    "joint_jacobian",
    "log_likelihood",
    "scatter_covariance",
]
