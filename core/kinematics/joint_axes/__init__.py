"""Joint axes from sweeps: closed forms, the fit of one arc, and all arcs with their covariance."""

from core.kinematics.joint_axes.arc_fit import ArcProblem
from core.kinematics.joint_axes.arc_model import AXIS_PARAMETERS, Motion
from core.kinematics.joint_axes.axis_fit import LEAST_POSES, AxisFits, fit_axes
from core.kinematics.joint_axes.closed_form import fit_circle

__all__ = ["AXIS_PARAMETERS", "LEAST_POSES", "ArcProblem", "AxisFits", "Motion", "fit_axes", "fit_circle"]
