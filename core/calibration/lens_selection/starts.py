"""Cameras and placements from which the fit of a lens model beyond Brown's begins.

Where Brown's model has been fitted, its poses are near and its radial function, over the radius that the images show,
is near the other model's. Where it has not, the focal length is tried over a grid, the lens taken for equidistant: the
tangent of a wide lens's angle, which a pinhole camera's start would need, has no measure in the image.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from core.calibration.multi_view import (
    BundleAdjustment,
    Placements,
    ViewStack,
    bundle_adjust,
    stack_states,
)
from core.calibration.priors import Lens
from core.calibration.state import pose_from_undistorted_points
from core.errors import GridposeError
from core.geometry import (
    AnyCamera,
    Camera,
    KannalaBrandtCamera,
    LensModel,
    RationalCamera,
    camera_from_array,
    free_parameters,
    undistort_any,
)
from core.numerics import shared_camera

FOCALS = (0.2, 0.28, 0.36, 0.46, 0.6, 0.8, 1.2)
"""Of the image's longer side: focal lengths to begin with where no fit is known."""
SAMPLES = 60


def nearest_camera(brown: Camera, model: LensModel, radius: float) -> AnyCamera:
    """Return the camera of a model whose image is nearest to Brown's, for r = tan θ up to `radius`."""
    inner = (brown.fx_px, brown.fy_px, brown.cx_px, brown.cy_px)
    if model == "brown":
        return brown
    if model == "rational":
        return RationalCamera(*inner, brown.k1, brown.k2, brown.p1, brown.p2, brown.k3)
    r = np.linspace(radius / SAMPLES, radius, SAMPLES)
    theta, t2 = np.arctan(r), np.arctan(r) ** 2
    rho = r * (1.0 + r * r * (brown.k1 + r * r * (brown.k2 + r * r * brown.k3)))
    # ρ = θ (1 + k1 θ² + ...), weighed by θ; a small ridge, for the powers resemble one another.
    A = (theta * t2 ** np.arange(1, 5)[:, None]).T
    ridge = 1e-3 * np.eye(4)
    k = np.linalg.lstsq(np.vstack([A, ridge]), np.concatenate([rho - theta, np.zeros(4)]), rcond=None)[0]
    return camera_from_array(np.array([*inner, *k, brown.p1, brown.p2]))


def seen_radius(views: ViewStack, camera: Camera) -> float:
    """Return tan θ of the outermost point that has a direction before Brown's camera."""
    normalised = undistort_any(views.points_px, camera)
    tangents = np.hypot(*normalised.T)
    radius = float(np.max(tangents[np.isfinite(tangents)], initial=0.0))
    return min(max(radius, 0.05), 5.0)


def with_camera(placements: Placements, camera: AnyCamera) -> Placements:
    """Return the placements before another camera."""
    parameters = np.tile(camera.as_array(), (len(placements), 1))
    return Placements(parameters, placements.rotations, placements.translations_mm)


def fit_model(views: ViewStack, start: Placements, lens: Lens | None) -> BundleAdjustment | None:
    """Fit one camera of the start's model robustly; None where the equations have no solution."""
    try:
        return bundle_adjust(
            views, start, shared_camera(free_parameters(start.parameters.shape[1])), lens=lens
        )
    except np.linalg.LinAlgError:
        return None


def fit_angular_from_grid(views: ViewStack, lens: Lens | None) -> BundleAdjustment | None:
    """Fit Kannala's and Brandt's model from equidistant lenses of several focal lengths; return the best fit."""
    longer = max(views.image_width_px, views.image_height_px)
    centre = 0.5 * (views.image_width_px - 1), 0.5 * (views.image_height_px - 1)
    focals = [factor * longer for factor in FOCALS] if lens is None else [lens.focal_px]
    found: list[BundleAdjustment] = []
    for focal in focals:
        start = _placements(views, KannalaBrandtCamera(focal, focal, *centre))
        fitted = None if start is None else fit_model(views, start, lens)
        if fitted is not None and fitted.converged and math.isfinite(fitted.scale):
            found.append(fitted)
    return min(found, key=lambda one: (-int(one.kept.sum()), one.scale), default=None)


def _placements(views: ViewStack, camera: KannalaBrandtCamera) -> Placements | None:
    try:
        return stack_states([pose_from_undistorted_points(camera, views.view(i)) for i in range(len(views))])
    except GridposeError:
        return None


def observed_radius_px(points_px: Float[np.ndarray, "n 2"], camera: AnyCamera) -> float:
    """Return how far from the principal point the outermost point lies, px."""
    return float(
        np.max(np.hypot(points_px[:, 0] - camera.cx_px, points_px[:, 1] - camera.cy_px), initial=0.0)
    )
