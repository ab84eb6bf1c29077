"""Projection uncertainty of a focus group's camera over the image, and where its points are."""

from __future__ import annotations

from typing import Any

import numpy as np

from app.reports.camera_plots.coverage_cells import ProjectionField, coverage_cells
from core.geometry import projection_covariance, worst_direction
from core.session import FocusGroup


def projection_field(group: FocusGroup) -> ProjectionField:
    """Return the standard uncertainty of a projected point at infinity in every cell, and how many points it has."""
    views, estimate = group.views, group.estimate
    cells = coverage_cells(views.points_px, views.image_width_px, views.image_height_px)
    middle = cells.middle_px.reshape(-1, 2)
    count = cells.count.ravel()
    covariance = projection_covariance(
        middle, estimate.camera, estimate.camera_covariance, middle[count > 0], count[count > 0].astype(float)
    )
    return ProjectionField(
        group.name, len(views), cells, worst_direction(covariance).reshape(cells.count.shape)
    )


def projection_document(field: ProjectionField) -> dict[str, Any]:
    """Return the field as the API shows it."""
    cells, areas = field.cells, field.areas
    return {
        "cell_size_px": cells.size_px,
        "covered_share": cells.covered_share,
        "largest_covered_px": field.largest_covered_px,
        "largest_blank_px": field.largest_blank_px,
        "blank_areas": [area.name for area in areas if area.is_blank],
        "areas": [
            {
                "name": area.name,
                "point_count": area.point_count,
                "blank_share": area.blank_share,
                "standard_uncertainty_px": area.standard_uncertainty_px,
            }
            for area in areas
        ],
        "cell_point_counts": cells.count.tolist(),
        "cell_standard_uncertainties_px": [
            [float(value) if np.isfinite(value) else None for value in row] for row in field.uncertainty_px
        ],
    }
