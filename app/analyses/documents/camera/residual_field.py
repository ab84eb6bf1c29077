"""The residuals of a focus group's points, for the plot of them and for its figures."""

from __future__ import annotations

import numpy as np

from app.reports.camera_plots.radial_bins import RadialResiduals
from app.reports.camera_plots.residual_cells import ResidualField
from core.geometry import camera_from_array, fold_radius_px, lens_model_of, project_any
from core.session import FocusGroup

OUTLIER = 6.0
"""Residuals beyond so many times their median distance are no matter of the lens."""


GROSS = 30.0
"""The same along the radius, where a lens beyond its model leaves much at the image's edge."""


def radial_residuals(group: FocusGroup) -> RadialResiduals:
    """Return the residuals along the radius from the principal point, outwards positive."""
    field, camera = residual_field(group, GROSS), group.estimate.camera
    off = field.points_px - np.array([camera.cx_px, camera.cy_px])
    radius = np.linalg.norm(off, axis=1)
    outwards = np.sum(field.residuals_px * off, axis=1) / np.maximum(radius, 1e-9)
    rms = float(np.sqrt(np.mean(np.sum(field.residuals_px**2, axis=1))))
    return RadialResiduals(lens_model_of(camera), radius, outwards, rms, fold_radius_px(camera))


def residual_field(group: FocusGroup, outlier: float = OUTLIER) -> ResidualField:
    """Return observed - predicted of every point, by the estimate as it stands; without points further off."""
    views, estimate = group.views, group.estimate
    residuals = np.empty_like(views.points_px)
    for k in range(len(views)):
        at = views.part(k)
        points_camera = (views.points_target[at] - estimate.positions_mm[k]) @ estimate.rotations[k]
        residuals[at] = views.points_px[at] - project_any(
            points_camera, camera_from_array(estimate.cameras[k])
        )
    distance = np.linalg.norm(residuals, axis=1)
    counts = distance <= outlier * np.median(distance)
    return ResidualField(
        group.name,
        len(views),
        views.image_width_px,
        views.image_height_px,
        views.points_px[counts],
        residuals[counts],
        int(np.count_nonzero(~counts)),
    )
