"""The posterior of the long-run RP_l where the tails of the cycles may be heavy, against that of Gaussian cycles.

With x = w^-½ y, y Gaussian of covariance Σ and w ~ χ²_ν / ν, the long-run figure is

    g = m + 3 √(tr Σ ν / (ν - 2) - m²),     m = E w^-½ E|y|.

Σ is drawn pose by pose, for Gaussian cycles and for each ν (`heavy_tails`); draws of all ν together, each with the
probability of its ν, make the posterior of g.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.special import gammaln

from core.metrology.cycle_process.heavy_tails import TAIL_DEGREES, gaussian_draws, student_draws
from core.metrology.cycle_process.process import CycleProcess
from core.metrology.iso9283 import rp_of_moments
from core.metrology.rp_distribution import CONFIDENCE, eigenvalues, mean_length

_MIN_DRAWS, _MAX_DRAWS = 64, 1024
_CELLS = 1_000_000
_LEAST_WEIGHT = 1e-3


def tail_shift(
    process: CycleProcess, x: Float[np.ndarray, "p n d"]
) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, " p"]]:
    """Return by how much the logarithms of the bounds of RP_l move; no shift for n < d + 2."""
    poses, n, d = x.shape
    if n < d + 2:
        return np.zeros(poses), np.zeros(poses)
    degrees = [
        (nu, p) for nu, p in zip(TAIL_DEGREES.tolist(), process.tails, strict=True) if p > _LEAST_WEIGHT
    ]
    draws = int(np.clip(_CELLS // (poses * n * max(len(degrees), 1)), _MIN_DRAWS, _MAX_DRAWS))
    gaussian = _long_run(gaussian_draws(x, draws), None)
    values, weights = [gaussian], [np.full(gaussian.shape, process.independent_gaussian / draws)]
    for nu, probability in degrees:
        found = student_draws(x, nu, draws)
        weight = np.exp(found.log_weight - found.log_weight.max(axis=1, keepdims=True))
        values.append(_long_run(found.roots, nu))
        weights.append(probability * weight / weight.sum(axis=1, keepdims=True))
    together, chances = np.concatenate(values, axis=1), np.concatenate(weights, axis=1)
    tail = (1.0 - CONFIDENCE) / 2.0
    plain = np.full(draws, 1.0 / draws)
    low, high = np.empty((2, poses))
    for i in range(poses):
        for bound, level in ((low, tail), (high, 1.0 - tail)):
            bound[i] = _quantile(together[i], chances[i], level) - _quantile(gaussian[i], plain, level)
    return low, high


def _long_run(roots: Float[np.ndarray, "p b d d"], nu: float | None) -> Float[np.ndarray, "p b"]:
    """Return the logarithm of g."""
    d = roots.shape[-1]
    padded = np.zeros((*roots.shape[:2], 3, 3))
    padded[..., :d, :d] = roots @ np.swapaxes(roots, 2, 3)
    spectrum = np.maximum(eigenvalues(padded), 0.0)
    length, square = mean_length(spectrum), spectrum.sum(axis=-1)
    if nu is not None:
        length = length * np.sqrt(0.5 * nu) * np.exp(gammaln(0.5 * (nu - 1.0)) - gammaln(0.5 * nu))
        square = square * nu / (nu - 2.0)
    return np.asarray(np.log(rp_of_moments(length, square)))


def _quantile(values: Float[np.ndarray, " b"], weights: Float[np.ndarray, " b"], level: float) -> float:
    order = np.argsort(values)
    sums = np.cumsum(weights[order])
    middle = (sums - 0.5 * weights[order]) / sums[-1]
    return float(np.interp(level, middle, values[order]))
