"""Circle point analysis: Denavit-Hartenberg parameters from the joint axes of sweeps, with covariance."""

from core.kinematics.circle_point_analysis.common_normals import reparametrise
from core.kinematics.circle_point_analysis.identification import AxesIdentification, identify_from_axes

__all__ = ["AxesIdentification", "identify_from_axes", "reparametrise"]
