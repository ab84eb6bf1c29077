"""What the residuals of fitted views say of their cameras and poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from core.calibration.fixed_centre import TO_FULL_STEP
from core.calibration.group_fits import Fitted
from core.calibration.model import RADIAL_PRIORS, SMALLEST_NOISE_PX, Lens, camera_prior
from core.calibration.shared_lens import coordinates
from core.calibration.systematic import Growth, growth_of
from core.calibration.view_doubt import (
    disagreement,
    in_target_frame,
    pose_covariances,
    reduced,
    repeated_scales,
    transformed,
    unsteady_repeats,
)
from core.calibration.view_stack import Placements, ViewStack


@dataclass(frozen=True, slots=True)
class Doubt:
    """The figures of `estimators.GroupEstimate` that speak of uncertainty, and the poses they are about."""

    camera_covariance: Float[np.ndarray, "9 9"]
    positions_mm: Float[np.ndarray, "k 3"]
    covariance: Float[np.ndarray, "k 6 6"]
    scatter: Float[np.ndarray, "k 6 6"]
    common: Float[np.ndarray, "k 6 9"]
    rms_px: Float[np.ndarray, " k"]
    reduced_chi2: float
    disagreement: float | None
    unsteady: Bool[np.ndarray, " k"]
    growth: Growth


def doubt_of(fitted: Fitted, lens: Lens | None) -> Doubt:
    """Add to placements what their residuals say of them."""
    views, at, used, shared = fitted.views, fitted.at, fitted.used, fitted.shared
    own = _own_coordinates(fitted.estimator, at.placements)
    P = _own_priors(fitted.estimator, views, at.placements, lens)
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
    in_common = {"pooled": 8, "pooled_free_focal": 7}.get(fitted.estimator, 0)
    camera = None if shared is None else shared.covariance
    growth = growth_of(
        views,
        at,
        used,
        fitted.labels,
        parts,
        own,
        scale,
        None if camera is None else camera[:8, :8],
        in_common,
    )
    # The fit weighed data against priors by all that its residuals hold; of that only the noise scatters.
    C, scatter = pose_covariances(parts.L / scale[:, None, None] ** 2, P)
    scatter = scatter[:, -6:, -6:] * (noise / scale)[:, None, None] ** 2
    rotations, centroids = at.placements.rotations, at.placements.translations_mm
    J = in_target_frame(rotations, centroids)
    contradiction, unsteady = None, np.zeros(len(views), dtype=np.bool_)
    if shared is not None:
        contradiction = disagreement(parts, at.square_sums, 2.0 * points, in_common)
        unsteady = unsteady_repeats(views, fitted.labels, parts, at.placements, noise)
    positions = views.centroids - np.einsum("kji,kj->ki", rotations, centroids)
    common = np.zeros((len(views), 6, 9))
    if camera is not None:
        camera = growth.camera * camera
        D = -parts.by_camera[:, -6:]
        common[:, :, :8] = J @ (D @ _root(camera[:8, :8]))
    common[:, :3, 8] = _print_scale(views)[:, None] * positions
    camera_covariance = np.zeros((9, 9))
    if own is not None:
        camera_covariance[:8, :8] = growth.own * transformed(own[:, :8], C).mean(axis=0)
    if camera is not None:
        camera_covariance += camera
    squared_px = views.sums(np.where(used, np.sum(at.residuals**2, axis=0), 0.0))
    return Doubt(
        camera_covariance,
        positions,
        growth.own * transformed(J, C[:, -6:, -6:]) + common @ np.swapaxes(common, 1, 2),
        transformed(J, scatter),
        common,
        np.sqrt(squared_px / points),
        float(np.mean(scale**2)),
        contradiction,
        unsteady,
        growth,
    )


def _own_coordinates(estimator: str, placements: Placements) -> Float[np.ndarray, "k 14 l"] | None:
    """Return derivatives by what each view has of its own, the pose last; None for the pose alone."""
    count = len(placements)
    if estimator == "per_image":
        return np.broadcast_to(np.eye(14), (count, 14, 14))
    if estimator == "per_image_fixed_pp":
        return np.broadcast_to(TO_FULL_STEP, (count, 14, 9))
    if estimator == "pooled_free_focal":
        own = np.zeros((count, 14, 7))
        own[:, 8:, 1:] = np.eye(6)
        for i in range(count):
            own[i, :8, 0] = coordinates(placements.parameters[i])[:, 0]
        return own
    return None


def _own_priors(
    estimator: str, views: ViewStack, placements: Placements, lens: Lens | None
) -> Float[np.ndarray, "k l l"] | None:
    """Return the priors' information on what each view has of its own."""
    if estimator == "per_image":
        of_camera = camera_prior(views.image_width_px, views.image_height_px, lens, 14)
        Q = np.array([of_camera(parameters)[1] for parameters in placements.parameters])
        return np.asarray(np.swapaxes(Q, 1, 2) @ Q)
    if estimator == "per_image_fixed_pp":
        diagonal = np.zeros(9)
        diagonal[1:3] = 1.0 / np.array(RADIAL_PRIORS) ** 2
        return np.broadcast_to(np.diag(diagonal), (len(placements), 9, 9))
    return None


def _root(covariance: Float[np.ndarray, "p p"]) -> Float[np.ndarray, "p p"]:
    """Return B with B Bᵀ = Σ, by eigenvectors of the correlations."""
    unit = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values, vectors = np.linalg.eigh(covariance / np.outer(unit, unit))
    return np.asarray(unit[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))


def _print_scale(views: ViewStack) -> Float[np.ndarray, " k"]:
    """Return the relative standard uncertainty of the prints' scale: the same in every length."""
    relative = [(t.pitch_standard_uncertainty_mm or 0.0) / t.pitch_mm for t in views.targets]
    return np.array(relative)[views.target]
