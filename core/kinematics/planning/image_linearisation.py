"""Images of one camera as an identification will see them: poses, and the errors of lens and prints in common."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from core.calibration import (
    CommonFit,
    Lens,
    Placements,
    ShapePrior,
    VarianceInflation,
    ViewStack,
    in_target_frame,
    linearise,
    marginalise_shape,
    transformed,
)
from core.errors import DegenerateGeometry
from core.kinematics.pose_observations import PoseData

_NO_GROWTH = VarianceInflation(1.0, 1.0)
_MIN_EIGENVALUE = 1e-14
"""Smallest eigenvalue of a pose's scaled information: below it, rounding dominates."""


def linearise_images(
    views: ViewStack,
    placements: Placements,
    lens: Lens | None,
    joint_angles: Float[np.ndarray, "k j"],
) -> PoseData:
    """Return images of exact points of one target as poses with the uncertainty that their stated noise leaves, one at
    each of the joint angles (rad); `lens` is the prior on the camera.
    """
    used = np.ones(len(views.column), dtype=np.bool_)
    at = linearise(views, placements, used)
    information = at.of_poses
    _require_poses(information)
    fit = CommonFit(views, used, placements, at.residuals, np.arange(len(views)), 1.0, _NO_GROWTH, lens)
    marginal = marginalise_shape(fit, [ShapePrior.of(t) for t in views.targets], noise_known=True)
    rotations, centroids = placements.rotations, placements.translations_mm
    return PoseData(
        joint_angles,
        views.centroids - np.einsum("kji,kj->ki", rotations, centroids),
        np.ascontiguousarray(rotations.transpose(0, 2, 1)),
        transformed(in_target_frame(rotations, centroids), np.linalg.inv(information)),
        marginal.common[marginal.place],
    )


def _require_poses(information: Float[np.ndarray, "k 6 6"]) -> None:
    """Raise DegenerateGeometry where an image does not determine its own pose."""
    unit = np.sqrt(np.maximum(np.diagonal(information, axis1=1, axis2=2), 1e-300))
    scaled = information / (unit[:, :, None] * unit[:, None, :])
    if not np.isfinite(information).all() or np.linalg.eigvalsh(scaled)[:, 0].min() < _MIN_EIGENVALUE:
        raise DegenerateGeometry(
            "Some images do not determine the camera's pose: their grid points lie too close together, or on a line.",
            "Show more of the grid, larger in the image.",
        )
