"""Scatter of poses by the noise that the repeats of a pose show, white or not.

With white noise of variance s² a pose scatters by s² G Gᵀ, G = (JᵀWJ)⁻¹JᵀW, and the residuals say how large s is.
Noise that neighbouring points share moves the pose more and the residuals less. Its model is

    cov(e) = s² D + Σ θ_k K_k,      θ_k ≥ 0,      scatter = G cov(e) Gᵀ,

D the stated variances over their mean, K_k the fields of `noise_fields`, and the sizes those of the greatest likelihood
of the contrasts of all poses (`contrasts`, `core.numerics.covariance_mixture`). Each image is then scaled to its own
noise, zᵀV⁻¹z over the number of its contrasts z, as far as images differ by more than chance.

A displacement of the whole image, or any other that a motion of the camera would cause, leaves no residual: nothing in
the images of one stop distinguishes it from motion. What is inferred of it is what fields of the dictionary that also
show in the contrasts imply.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.linalg import solve_triangular

from core.calibration.multi_view.linearisation import Linearised
from core.calibration.multi_view.repeats.contrasts import (
    PoseContrasts,
    camera_share,
    jacobian_of,
    own_part,
)
from core.calibration.multi_view.repeats.noise_fields import propagated_fields, propagated_mixture
from core.calibration.multi_view.schur_blocks import SchurBlocks, camera_changes, in_target_frame, transformed
from core.calibration.multi_view.view_stack import ViewStack, evenly
from core.calibration.state import SMALLEST_NOISE_PX
from core.numerics import SampleCovariance, estimate_components, first_component_alone, log_likelihood

MIN_FREEDOM = 3
"""Images beyond one of each pose, over all poses: with fewer the noise is taken for white."""
MAX_POSES = 24
MIN_POSES = 6
MAX_FREEDOM = 1000
"""Poses, evenly chosen, from which the noise model is estimated: as many as hold so many images beyond one of each."""
MAX_CAMERA_SHARE = 0.5
"""Of the variance beyond white noise: with more of it in the camera's directions the camera changed."""
CHANCE = 10.0
"""Twice the log likelihood ratio that white noise seldom reaches: with less the noise is white, and the model's share
grows beyond it.
"""


@dataclass(frozen=True, slots=True)
class OwnFit:
    """How an image's own coordinates follow its points: what `multi_view_covariance` computed of them.

    `own` are the derivatives of camera and pose by these coordinates (None: the pose alone), `covariance` is that of
    the coordinates, priors included, at noise of `scale` per unit of stated uncertainty. `parts` are the same
    coordinates' normal equations.
    """

    parts: SchurBlocks
    own: Float[np.ndarray, "k q l"] | None
    covariance: Float[np.ndarray, "k l l"]
    scale: Float[np.ndarray, " k"]


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """Sizes of the components, px²: white noise, then the fields."""

    white: float
    fields: Float[np.ndarray, " k"]


@dataclass(frozen=True, slots=True)
class RepeatScatter:
    """What the noise makes of each image: `poses`, the scatter of (x, y, z, w) in the target frame, and `changes`, the
    variances of `schur_blocks.camera_changes` as the image shows them.
    """

    poses: Float[np.ndarray, "k 6 6"]
    changes: Float[np.ndarray, "k 3"]


def correlated_scatter(
    views: ViewStack,
    at: Linearised,
    used: Bool[np.ndarray, " n"],
    groups: Sequence[Int[np.ndarray, " _"]],
    found: Sequence[PoseContrasts | None],
    fit: OwnFit,
    white: RepeatScatter,
    changed: Bool[np.ndarray, " k"],
) -> tuple[RepeatScatter, Bool[np.ndarray, " k"]]:
    """Return the scatter by the noise that the repeats show, and in which images it is the camera that changes.

    Parameters
    ----------
    groups, found
        The images of each pose before each target, and their contrasts.
    white
        The scatter under white noise, which is returned where too few repeats show anything else.
    changed
        Of each image, whether under white noise the camera seems to change among the images of its pose. It is taken
        to do so where most of what white noise does not explain is of the form that a change of the camera has; what
        these poses show is no noise of the others.
    """
    by_camera = np.zeros(len(views), dtype=np.bool_)
    for group, one in zip(groups, found, strict=True):
        by_camera[group] = changed[group].any() and (one is None or camera_share(one) > MAX_CAMERA_SHARE)
    poses, changes = white.poses.copy(), white.changes.copy()
    for kind in (False, True):
        some = [k for k, group in enumerate(groups) if by_camera[group[0]] == kind]
        _write_scatter(
            views, at, used, fit, white, [groups[k] for k in some], [found[k] for k in some], poses, changes
        )
    return RepeatScatter(poses, changes), by_camera


def _write_scatter(
    views: ViewStack,
    at: Linearised,
    used: Bool[np.ndarray, " n"],
    fit: OwnFit,
    white: RepeatScatter,
    groups: Sequence[Int[np.ndarray, " _"]],
    contrasts: Sequence[PoseContrasts | None],
    poses: Float[np.ndarray, "k 6 6"],
    changes: Float[np.ndarray, "k 3"],
) -> None:
    """Write the scatter of the images of some poses, which share one model of noise, if their repeats show any."""
    repeated = [one for one in contrasts if one is not None and not one.is_exact]
    model = fit_noise_model(views, repeated)
    if model is None:
        return
    levels = {int(one.images[0]): _levels(views, model, one) for one in repeated}
    spread = _share_beyond_chance(list(levels.values()), repeated)
    # A pose whose images are not compared is as noisy, in its stated uncertainties, as those that are.
    stated = [_stated(views, one.images) for one in repeated]
    per_stated = float(
        np.mean([level.mean() / one for level, one in zip(levels.values(), stated, strict=True)])
    )
    counts = views.sums(used.astype(np.float64))
    for group, one in zip(groups, contrasts, strict=True):
        if one is not None and one.is_exact:
            continue
        level = np.full(len(group), per_stated * _stated(views, group))
        if one is not None:
            own = levels[int(one.images[0])]
            level[:] = own.mean()
            level[np.isin(group, one.images)] = own.mean() + spread * (own - own.mean())
        level = np.maximum(level, SMALLEST_NOISE_PX**2 / (model.white + float(model.fields.sum())))
        fullest = int(group[np.argmax(counts[group])])
        of_poses, of_changes = _model_scatter(views, at, used, fit, white, group, fullest, model)
        poses[group] = level[:, None, None] * of_poses
        changes[group] = level[:, None] * of_changes


def fit_noise_model(views: ViewStack, poses: list[PoseContrasts]) -> NoiseModel | None:
    """Return the model of the poses' common noise; None where there are too few repeats."""
    freedom = sum(pose.freedom for pose in poses)
    if freedom < MIN_FREEDOM:
        return None
    # Where images differ in noise, fewer equal ones scatter as much (Welch-Satterthwaite).
    excess = 1.0 + _excess([np.sum(pose.values**2, axis=1) for pose in poses], poses)
    samples = [
        SampleCovariance(
            pose.values.T @ pose.values / pose.freedom,
            pose.freedom / excess,
            _components(pose, views.image_height_px),
        )
        for pose in evenly(poses, min(MAX_POSES, max(MIN_POSES, MAX_FREEDOM * len(poses) // freedom)))
    ]
    correlated, white = estimate_components(samples), first_component_alone(samples)
    evidence = 2.0 * (log_likelihood(samples, correlated) - log_likelihood(samples, white))
    share = 1.0 - (CHANCE / max(evidence, CHANCE)) ** 2
    sizes = share * correlated + (1.0 - share) * white
    return NoiseModel(float(sizes[0]), sizes[1:])


def _components(pose: PoseContrasts, height_px: int) -> Float[np.ndarray, "k d d"]:
    fields = propagated_fields(pose.basis, pose.points_px, float(height_px))
    return np.concatenate([_white(pose.basis, pose.relative_variance)[None], fields])


def _white(
    along: Float[np.ndarray, "2 p d"], relative_variance: Float[np.ndarray, " p"]
) -> Float[np.ndarray, "d d"]:
    """Return Aᵀ D A of combinations A of independent displacements, D their variances."""
    flat = along.reshape(-1, along.shape[2])
    return np.asarray((flat * np.tile(relative_variance, 2)[:, None]).T @ flat)


def model_covariance(model: NoiseModel, pose: PoseContrasts, height_px: int) -> Float[np.ndarray, "d d"]:
    """Return V of a pose's contrasts, px²."""
    fields = propagated_mixture(pose.basis, pose.points_px, float(height_px), model.fields)
    return model.white * _white(pose.basis, pose.relative_variance) + fields


def squared_sizes(V: Float[np.ndarray, "d d"], values: Float[np.ndarray, "n d"]) -> Float[np.ndarray, " n"]:
    """Return zᵀV⁻¹z of each row z of `values`."""
    whitened = solve_triangular(np.linalg.cholesky(V), values.T, lower=True, check_finite=False)
    return np.asarray(np.einsum("dn,dn->n", whitened, whitened))


def _levels(views: ViewStack, model: NoiseModel, pose: PoseContrasts) -> Float[np.ndarray, " n"]:
    """Return the variance of each image over the model's, by its stated uncertainty over its pose's.

    The deviation of image j from the mean of n has the variance (1 - 2/n) a_j² + ā²/n, ā² the mean over the images.
    """
    n = len(pose.images)
    V = model_covariance(model, pose, views.image_height_px)
    squares = squared_sizes(V, pose.values) / pose.values.shape[1]
    mean = float(squares.sum()) / (n - 1)
    if n < 3:
        return np.full(n, mean)
    stated = views.uncertainty[pose.images] ** 2 / _stated(views, pose.images)
    return np.maximum((squares - mean / n) / (1.0 - 2.0 / n), 0.0) / stated


def _stated(views: ViewStack, images: Int[np.ndarray, " n"]) -> float:
    """Return the mean stated variance of images, px²."""
    return float(np.mean(views.uncertainty[images] ** 2))


def _excess(sizes: Sequence[Float[np.ndarray, " _"]], poses: Sequence[PoseContrasts]) -> float:
    """Return the relative variance of the images' noise variances beyond what chance explains."""
    seen, count = _relative_variance(sizes, poses)
    return max(seen[0] - seen[1], 0.0) / count if count else 0.0


def _share_beyond_chance(sizes: Sequence[Float[np.ndarray, " _"]], poses: Sequence[PoseContrasts]) -> float:
    """Return the share of the images' differences in noise that chance does not explain (Wiener's factor)."""
    seen, _ = _relative_variance(sizes, poses)
    return max(1.0 - seen[1] / seen[0], 0.0) if seen[0] > 0.0 else 0.0


def _relative_variance(
    sizes: Sequence[Float[np.ndarray, " _"]], poses: Sequence[PoseContrasts]
) -> tuple[tuple[float, float], int]:
    """Return the sum of squared relative differences of images of one pose, what chance makes of it, and the count."""
    seen = chance = 0.0
    count = 0
    for pose, size in zip(poses, sizes, strict=True):
        n, mean = len(size), float(size.mean())
        if n < 3 or mean <= 0.0:
            continue
        seen += float(np.sum((size / mean - 1.0) ** 2))
        chance += n * 2.0 / pose.values.shape[1] * ((n - 1.0) / (n - 2.0)) ** 2
        count += n
    return (seen, chance), count


def _model_scatter(
    views: ViewStack,
    at: Linearised,
    used: Bool[np.ndarray, " n"],
    fit: OwnFit,
    white: RepeatScatter,
    group: Int[np.ndarray, " g"],
    i: int,
    model: NoiseModel,
) -> tuple[Float[np.ndarray, "g 6 6"], Float[np.ndarray, "g 3"]]:
    """Return G cov(e) Gᵀ of the images of a pose at the model's own noise, and the variances of the camera's changes.

    They are computed of image `i`, the one with most points, and taken to the others, whose points and stated
    uncertainties differ little, by what takes their scatter under white noise to one another.
    """
    part = views.part(i)
    points = np.arange(part.start, part.stop)[used[part]]
    J = jacobian_of(views, at.placements, i, points)
    own = own_part(J, fit.own, i)
    variance = views.standard_uncertainty_px[points] ** 2
    G = np.tensordot(fit.covariance[i, -6:], own, axes=1) / (variance * fit.scale[i] ** 2)
    v = camera_changes(at.placements.parameters[i])
    observed = np.einsum("di,ij,dj->d", v, fit.parts.S[i], v)
    seen = observed > 0.0
    of_camera = J[: at.placements.free] - np.tensordot(fit.parts.by_camera[i].T, own, axes=1)
    changes = np.tensordot(v[seen] / observed[seen, None], of_camera, axes=1) / variance
    along = np.ascontiguousarray(np.concatenate([G, changes]).transpose(1, 2, 0))
    fields = propagated_mixture(along, views.points_px[points], float(views.image_height_px), model.fields)
    whole = model.white * _white(along, variance / variance.mean()) + fields
    to_target = in_target_frame(at.placements.rotations[[i]], at.placements.translations_mm[[i]])
    scatter = transformed(to_target, whole[None, :6, :6])[0]
    level = _stated(views, group) / float(views.uncertainty[i]) ** 2
    change = _roots(white.poses[group]) @ np.linalg.inv(_roots(white.poses[[i]] * level))
    of_changes = np.full((len(group), 3), np.inf)
    of_changes[:, seen] = white.changes[group][:, seen] * (
        np.diagonal(whole)[6:] / (white.changes[i, seen] * level)
    )
    return transformed(change, np.broadcast_to(scatter, (len(group), 6, 6))), of_changes


def _roots(covariances: Float[np.ndarray, "k 6 6"]) -> Float[np.ndarray, "k 6 6"]:
    """Return lower triangular B with B Bᵀ = C; mm² and rad² differ by orders of magnitude."""
    unit = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    correlations = covariances / (unit[:, :, None] * unit[:, None, :])
    return np.asarray(unit[:, :, None] * np.linalg.cholesky(correlations))
