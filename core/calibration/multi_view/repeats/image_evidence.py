"""Evidence that a single image is degraded: noise that the other images of the session do not have.

Glare, motion blur, a passing shadow or something in front of the board leave larger residuals in one image. Two tests
for each image, both of residuals about the pose's mean, which no motion of the robot enters:

- the variance of its fine residuals, over the median of its pose's images, against χ²: as many degrees of freedom as
  the spread of all images asks for, which correlated noise makes fewer;
- its low-order pattern, zᵀV⁻¹z of its contrasts z against χ², with V fitted to the quieter images of each pose and
  scaled so that the median is that of χ².
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.special import chdtrc, chdtri, ndtri

from core.calibration.multi_view.repeats.contrasts import PoseContrasts
from core.calibration.multi_view.repeats.noise_model import fit_noise_model, model_covariance, squared_sizes
from core.calibration.multi_view.view_stack import ViewStack

QUIETER = 0.85
"""Share of each pose's images to which the noise is fitted."""
MIN_IMAGES = 5
"""Of a pose: with fewer its median says little about its images."""
_MEDIAN_STEPS = 8


def image_p_values(views: ViewStack, poses: list[PoseContrasts]) -> Float[np.ndarray, "k 2"]:
    """Return for each image the chance of its fine residuals and of its pattern; 1 where it cannot be tested."""
    result = np.ones((len(views), 2))
    tested = [pose for pose in poses if len(pose.images) >= MIN_IMAGES and not pose.is_exact]
    fine = [pose for pose in tested if pose.fine_contrasts >= MIN_IMAGES and np.median(pose.fine) > 0.0]
    if fine:
        ratios = [pose.fine / np.median(pose.fine) for pose in fine]
        seen = _degrees_of_freedom(np.concatenate(ratios))
        for pose, ratio in zip(fine, ratios, strict=True):
            freedom = min(seen, float(pose.fine_contrasts))
            result[pose.images, 0] = chdtrc(freedom, ratio * chdtri(freedom, 0.5))
    quieter = [_quieter(pose) for pose in tested]
    model = fit_noise_model(views, quieter)
    if model is None:
        return result
    for pose, quiet in zip(tested, quieter, strict=True):
        V = model_covariance(model, quiet, views.image_height_px)
        kept = np.isin(pose.images, quiet.images)
        off_mean = pose.values - pose.values[kept].mean(axis=0)
        # An image varies less about a mean that it is part of than about one of others.
        variance = 1.0 + np.where(kept, -1.0, 1.0) / len(quiet.images)
        squares = squared_sizes(V, off_mean) / variance
        d = float(pose.values.shape[1])
        result[pose.images, 1] = chdtrc(d, squares / np.median(squares) * chdtri(d, 0.5))
    return result


def _quieter(pose: PoseContrasts) -> PoseContrasts:
    """Return the pose's images with the smaller residuals, about their own mean."""
    size = np.sum((pose.values - _spatial_median(pose.values)) ** 2, axis=1)
    kept = np.sort(np.argsort(size, kind="stable")[: int(np.ceil(QUIETER * len(size)))])
    values = pose.values[kept]
    return replace(pose, images=pose.images[kept], values=values - values.mean(axis=0), fine=pose.fine[kept])


def _spatial_median(values: Float[np.ndarray, "n d"]) -> Float[np.ndarray, " d"]:
    """Return about the point with the least sum of distances (Weiszfeld 1937).

    Unlike medians of columns it does not depend on the basis, which linear algebra chooses freely among contrasts.
    """
    middle = values.mean(axis=0)
    for _ in range(_MEDIAN_STEPS):
        distance = np.linalg.norm(values - middle, axis=1)
        weight = 1.0 / np.maximum(distance, max(1e-9 * distance.max(), 1e-290))
        middle = weight @ values / weight.sum()
    return np.asarray(middle)


def _degrees_of_freedom(ratios: Float[np.ndarray, " m"]) -> float:
    """Return those of the χ² whose upper quantiles over its median are as far as the ratios' (Wilson, Hilferty 1931).

    Noise of varying size has longer tails than its middle shows: the farthest quantile counts.
    """
    found = []
    for share in (0.75, 0.9):
        root = float(np.quantile(ratios, share)) ** (1.0 / 3.0) - 1.0
        found.append(2.0 / 9.0 * (float(ndtri(share)) / max(root, 1e-6)) ** 2)
    return min(found)
