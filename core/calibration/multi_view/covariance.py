"""Covariances of cameras and poses from the residuals of fitted views."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from core.calibration.fixed_principal_point import STEP_EMBEDDING
from core.calibration.multi_view.correlated_residuals import VarianceInflation, variance_inflation
from core.calibration.multi_view.fitting import Fitted
from core.calibration.multi_view.group_estimate import PoseUncertainties
from core.calibration.multi_view.repeats import (
    OwnFit,
    RepeatScatter,
    correlated_scatter,
    image_p_values,
    pose_contrasts,
)
from core.calibration.multi_view.schur_blocks import (
    change_variances,
    disagreement,
    drifting_cameras,
    in_target_frame,
    pose_covariances,
    reduced,
    repeated_scales,
    transformed,
)
from core.calibration.multi_view.view_stack import Placements, ViewStack, coordinates, groups_of
from core.calibration.priors import RADIAL_PRIORS, camera_prior
from core.calibration.residuals import View
from core.calibration.state import SMALLEST_NOISE_PX
from core.calibration.uncertainty import SAG_VARIANCE, valley_sag
from core.geometry import free_parameters


@dataclass(frozen=True, slots=True, kw_only=True)
class MultiViewCovariance(PoseUncertainties):
    """The uncertainties of `estimators.GroupEstimate`, and how much larger they are than independent residuals'."""

    growth: VarianceInflation


def multi_view_covariance(fitted: Fitted) -> MultiViewCovariance:
    """Return the covariances of camera and poses from the residuals at the placements."""
    views, at, used, shared = fitted.views, fitted.at, fitted.used, fitted.shared
    own = _own_coordinates(fitted.estimator, at.placements)
    P = _own_priors(fitted, at.placements)
    parts = reduced(at.products, own)
    count = parts.L.shape[1]
    points = views.sums(used.astype(np.float64))
    if shared is not None:
        scale = np.full(len(views), shared.scale)
    else:
        scale = np.sqrt(at.square_sums / np.maximum(2.0 * points - count, 1.0))
    # No fit takes its noise for less.
    scale = np.maximum(scale, SMALLEST_NOISE_PX / views.uncertainty)
    noise = repeated_scales(
        views, at.residuals, used, fitted.labels, count, float(np.sqrt(np.mean(scale**2)))
    )
    size = at.placements.parameters.shape[1]
    free = free_parameters(size)
    in_common = {"pooled": free, "pooled_free_focal": free - 1}.get(fitted.estimator, 0)
    camera = None if shared is None else shared.covariance
    growth = variance_inflation(
        views,
        at,
        used,
        fitted.labels,
        parts,
        own,
        scale,
        None if camera is None else camera[:free, :free],
        in_common,
    )
    # The fit weighed data against priors by all that its residuals hold; of that only the noise scatters.
    C, scatter = pose_covariances(parts.L / scale[:, None, None] ** 2, P)
    scatter = scatter * (noise / scale)[:, None, None] ** 2
    rotations, centroids = at.placements.rotations, at.placements.translations_mm
    J = in_target_frame(rotations, centroids)
    contradiction, unsteady = None, np.zeros(len(views), dtype=np.bool_)
    white = RepeatScatter(transformed(J, scatter[:, -6:, -6:]), change_variances(parts, at.placements, noise))
    if shared is not None:
        contradiction = disagreement(parts, at.square_sums, 2.0 * points, in_common)
        unsteady = drifting_cameras(views, fitted.labels, parts, at.placements, white.changes)
    fit = OwnFit(parts, own, C, scale)
    groups = groups_of(fitted.labels * len(views.targets) + views.target)
    contrasts = [pose_contrasts(views, at.placements, at.residuals, used, own, group) for group in groups]
    repeated, by_camera = correlated_scatter(views, at, used, groups, contrasts, fit, white, unsteady)
    if unsteady.any():
        unsteady = by_camera | drifting_cameras(views, fitted.labels, parts, at.placements, repeated.changes)
    positions = views.centroids - np.einsum("kji,kj->ki", rotations, centroids)
    common = np.zeros((len(views), 6, free + 1))
    if camera is not None:
        camera = growth.camera * camera
        D = -parts.by_camera[:, -6:]
        common[:, :, :free] = J @ (D @ error_factors(camera[:free, :free]))
    common[:, :3, free] = _print_scale(views)[:, None] * positions
    camera_covariance, focal_uncertainty = np.zeros((size, size)), None
    if own is not None:
        of_each = growth.own * transformed(own[:, :free], C)
        camera_covariance[:free, :free] = of_each.mean(axis=0)
        if camera is None:
            variance = of_each[:, 0, 0] + 2.0 * of_each[:, 0, 1] + of_each[:, 1, 1]
            focal_uncertainty = np.sqrt(variance) / at.placements.parameters[:, :2].sum(axis=1)
    if camera is not None:
        of_shared = camera[:free, :free]
        if own is not None:
            # What an image has of its own follows the errors of what is shared.
            follows = np.eye(free) - own[:, :free] @ parts.by_camera
            of_shared = transformed(follows, of_shared[None]).mean(axis=0)
        camera_covariance[:free, :free] += of_shared
    of_poses, scatter_of_poses = growth.own * transformed(J, C[:, -6:, -6:]), repeated.poses
    if fitted.estimator == "per_image":
        of_poses += _off_the_tangent(views, at.placements, growth.own * C)
        scatter_of_poses = scatter_of_poses + _off_the_tangent(views, at.placements, scatter)
    squared_px = views.sums(np.where(used, np.sum(at.residuals**2, axis=0), 0.0))
    return MultiViewCovariance(
        camera_covariance=camera_covariance,
        positions_mm=positions,
        covariance=of_poses + common @ np.swapaxes(common, 1, 2),
        scatter=scatter_of_poses,
        common=common,
        rms_px=np.sqrt(squared_px / points),
        reduced_chi2=float(np.mean(scale**2)),
        disagreement=contradiction,
        unsteady=unsteady,
        image_p_values=image_p_values(views, [one for one in contrasts if one is not None]),
        misfit=float(np.mean((scale / noise) ** 2)),
        focal_uncertainty=focal_uncertainty,
        growth=growth,
    )


def _own_coordinates(estimator: str, placements: Placements) -> Float[np.ndarray, "k p l"] | None:
    """Return derivatives by what each view has of its own, the pose last; None for the pose alone."""
    count = len(placements)
    if estimator in ("per_image", "per_image_session_prior"):
        everything = np.eye(placements.free + 6)
        return np.broadcast_to(everything, (count, *everything.shape))
    if estimator == "per_image_fixed_pp":
        return np.broadcast_to(STEP_EMBEDDING, (count, 14, 9))
    if estimator == "pooled_free_focal":
        free = placements.free
        own = np.zeros((count, free + 6, 7))
        own[:, free:, 1:] = np.eye(6)
        for i in range(count):
            own[i, :free, 0] = coordinates(placements.parameters[i])[:, 0]
        return own
    return None


def _own_priors(fitted: Fitted, placements: Placements) -> Float[np.ndarray, "k l l"] | None:
    """Return the priors' information on what each view has of its own."""
    if fitted.own_priors is not None:
        return fitted.own_priors
    if fitted.estimator == "per_image":
        views = fitted.views
        of_camera = camera_prior(views.image_width_px, views.image_height_px, fitted.lens, 14)
        Q = fitted.prior_factor * np.array([of_camera(parameters)[1] for parameters in placements.parameters])
        return np.asarray(np.swapaxes(Q, 1, 2) @ Q)
    if fitted.estimator == "per_image_fixed_pp":
        diagonal = np.zeros(9)
        diagonal[1:3] = 1.0 / np.array(RADIAL_PRIORS) ** 2
        return np.broadcast_to(np.diag(diagonal), (len(placements), 9, 9))
    return None


def _off_the_tangent(
    views: ViewStack, placements: Placements, covariances: Float[np.ndarray, "k 14 14"]
) -> Float[np.ndarray, "k 6 6"]:
    """Return the part of each pose's covariance that the valley of its own focal length has off its tangent."""
    sags = np.array(
        [
            valley_sag(View(parameters, rotation, translation), covariance, centroid)[1]
            for parameters, rotation, translation, covariance, centroid in zip(
                placements.parameters,
                placements.rotations,
                placements.translations_mm,
                covariances,
                views.centroids,
                strict=True,
            )
        ]
    )
    return SAG_VARIANCE * sags[:, :, None] * sags[:, None, :]


def error_factors(covariance: Float[np.ndarray, "p p"]) -> Float[np.ndarray, "p p"]:
    """Return B with B Bᵀ = Σ, by eigenvectors of the correlations: what one standard uncertainty of each of p
    independent errors does to the parameters.
    """
    unit = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values, vectors = np.linalg.eigh(covariance / np.outer(unit, unit))
    return np.asarray(unit[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))


def _print_scale(views: ViewStack) -> Float[np.ndarray, " k"]:
    """Return the relative standard uncertainty of the prints' scale: the same in every length."""
    relative = [t.scale_standard_uncertainty or 0.0 for t in views.targets]
    return np.array(relative)[views.target]
