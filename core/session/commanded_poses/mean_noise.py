"""Variance of the mean pose of several visits, an axis: from the visits' scatter, or what the instrument states.

Poses scatter differently, and few visits say little of a scatter. So each pose has its own, drawn towards that of all
poses by as much as these differ less than chance would have it: of s_i² with f_i degrees of freedom, 1 / σ_i² being
of a scaled χ² of f_0, it is (f_0 s_0² + f_i s_i²) / (f_0 + f_i) with f_0 + f_i. s_0 and f_0 are estimated by the
moments of log s_i².

Reference: G. K. Smyth, "Linear models and empirical Bayes methods for assessing differential expression", Stat. Appl.
Genet. Mol. Biol. 3 (2004), doi:10.2202/1544-6115.1027.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.optimize import brentq
from scipy.special import digamma, polygamma

from core.geometry import rotation_vectors, transform, transform_mean
from core.metrology import CycleProcess, MeanNoise, mean_of_cycles
from core.session.model import MeasuredPose

_LEAST_SHARE = 1e-9
"""Of the variance of all poses, as which a smaller one of a pose counts: readings that do not change."""
_MIN_PRIOR_FREEDOM, _MAX_PRIOR_FREEDOM = 1.0, 1e4


def mean_position_noise(
    poses: Sequence[Sequence[MeasuredPose]], process: CycleProcess | None = None
) -> MeanNoise:
    """Return the noise of the poses' mean positions.

    Where no pose has two visits, it is what the covariances that differ from visit to visit state, and without these
    0. `process` is what the visits follow, None for independent ones.
    """
    about = [np.array([v.position_mm for v in visits]) for visits in poses]
    return _mean_noise(about, poses, slice(0, 3), process)


def mean_rotation_noise(
    poses: Sequence[Sequence[MeasuredPose]], process: CycleProcess | None = None
) -> MeanNoise:
    """Return the noise of the poses' mean orientations, as `mean_position_noise`; every visit has a rotation."""
    about = []
    for visits in poses:
        rotations = np.array([v.rotation for v in visits if v.rotation is not None])
        mean = transform_mean(np.array([transform(R, np.zeros(3)) for R in rotations]))
        about.append(rotation_vectors(rotations, mean[:3, :3]))
    return _mean_noise(about, poses, slice(3, 6), process)


def _mean_noise(
    values: Sequence[Float[np.ndarray, "_ 3"]],
    poses: Sequence[Sequence[MeasuredPose]],
    part: slice,
    process: CycleProcess | None,
) -> MeanNoise:
    counts = np.array([len(v) for v in values])
    freedom = 3.0 * (counts - 1.0)
    if not np.any(freedom > 0.0):
        stated = [
            [np.trace(v.scatter[part, part]) / 3.0 for v in visits if v.scatter is not None]
            for visits in poses
        ]
        return MeanNoise(
            np.array([float(np.mean(of_pose)) if of_pose else 0.0 for of_pose in stated]),
            np.full(len(poses), np.inf),
        )
    squares = np.array([float(np.sum((v - v.mean(axis=0)) ** 2)) for v in values])
    variance, found = moderated_variances(squares, freedom)
    inflation = np.array([mean_of_cycles(process, n).inflation if n > 1 else 1.0 for n in counts.tolist()])
    return MeanNoise(variance * inflation**2 / counts, found)


def moderated_variances(
    squares: Float[np.ndarray, " n"], freedom: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Return variances and their degrees of freedom from sums of squares with so many of them, some larger than 0."""
    pooled = float(np.sum(squares) / np.sum(freedom))
    known = freedom > 0.0
    half = 0.5 * freedom[known]
    logs = np.log(np.maximum(squares[known] / freedom[known], max(_LEAST_SHARE * pooled, 1e-300)))
    logs = logs - digamma(half) + np.log(half)
    beyond = float(np.var(logs, ddof=1) - np.mean(polygamma(1, half))) if len(logs) > 1 else 0.0
    if beyond <= float(polygamma(1, 0.5 * _MAX_PRIOR_FREEDOM)):  # the poses differ by no more than chance
        return np.full(len(squares), pooled), np.full(len(squares), float(np.sum(freedom)))
    least, most = 0.5 * _MIN_PRIOR_FREEDOM, 0.5 * _MAX_PRIOR_FREEDOM
    prior_half = least
    if beyond < float(polygamma(1, least)):
        prior_half = float(brentq(lambda x: float(polygamma(1, x)) - beyond, least, most))
    prior = float(np.exp(np.mean(logs) + digamma(prior_half) - np.log(prior_half)))
    total = 2.0 * prior_half + freedom
    return (2.0 * prior_half * prior + squares) / total, total
