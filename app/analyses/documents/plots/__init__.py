"""Plots of a session. This package loads matplotlib: only the analysis process imports it, when a plot is requested."""

from app.analyses.documents.plots.cycle_points import cycle_points
from app.analyses.documents.plots.drawing import (
    drift_pages,
    drift_plot,
    projection_map,
    residual_map,
    scatter_pages,
    scatter_plot,
    steadiness_pages,
    steadiness_plot,
)
from app.analyses.documents.plots.identifiability import identifiability_plot
from app.analyses.documents.plots.joint_curves import joint_curves_plot
from app.analyses.documents.plots.lens_profile import lens_profile_plot
from app.analyses.documents.plots.workspace import error_map, joint_noise_map

__all__ = [
    "cycle_points",
    "drift_pages",
    "drift_plot",
    "error_map",
    "identifiability_plot",
    "joint_curves_plot",
    "joint_noise_map",
    "lens_profile_plot",
    "projection_map",
    "residual_map",
    "scatter_pages",
    "scatter_plot",
    "steadiness_pages",
    "steadiness_plot",
]
