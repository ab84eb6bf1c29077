"""A slow motion in noisy visits: the local level model, a random walk seen through white noise.

Visits y_c = m_c + e_c, of unit variance in e and q a cycle in the steps of m, have with the mean taken off the
covariance A = q B + C, B that of the walk. In the eigenvectors of B (against C = 1 - 1 1ᵀ / n) both are diagonal, the
likelihood of q is a sum, and the smoothed motion is q λ / (1 + q λ) of each component. q is the same along x, y and z
and maximises the restricted likelihood; at q = 0 nothing moves.

References: A. C. Harvey, "Forecasting, structural time series models and the Kalman filter", 1989, §2.3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from core.metrology.iso9283 import deviations

_RATIOS = np.concatenate([[0.0], np.geomspace(1e-5, 1e2, 57)])
"""Variance of a step over that of a visit."""
MIN_EVIDENCE = 2.71
"""Of twice the log likelihood over that at rest: half a χ² of one degree of freedom exceeds it once in twenty."""


@dataclass(frozen=True, slots=True)
class SlowMotion:
    """The motion at each visit about its mean, mm, and its standard uncertainty along an axis; zero at rest."""

    motion_mm: Float[np.ndarray, "n 3"]
    standard_uncertainty_mm: Float[np.ndarray, " n"]


def slow_motion(cycles: Int[np.ndarray, " n"], positions_mm: Float[np.ndarray, "n 3"]) -> SlowMotion:
    """Return the slow motion of n ≥ 3 visits in the order of their cycles."""
    y = deviations(positions_mm)
    n = len(y)
    time = (cycles - cycles[0]).astype(np.float64)
    walk = np.minimum(time[:, None], time)
    centred = walk - walk.mean(axis=0)
    centred = centred - centred.mean(axis=1, keepdims=True)
    values, vectors = np.linalg.eigh(0.5 * (centred + centred.T))
    values, vectors = np.maximum(values[1:], 0.0), vectors[:, 1:]  # the least is that of the mean
    squares = np.sum((vectors.T @ y) ** 2, axis=1)
    if not squares.any():
        return SlowMotion(np.zeros((n, 3)), np.zeros(n))
    spread = 1.0 + _RATIOS[:, None] * values
    variance = (squares / spread).sum(axis=1) / (3.0 * (n - 1))
    log_likelihood = -1.5 * ((n - 1) * np.log(variance) + np.log(spread).sum(axis=1))
    best = int(np.argmax(log_likelihood))
    if 2.0 * (log_likelihood[best] - log_likelihood[0]) < MIN_EVIDENCE:
        return SlowMotion(np.zeros((n, 3)), np.zeros(n))
    share = 1.0 - 1.0 / spread[best]
    motion = (vectors * share) @ (vectors.T @ y)
    left = variance[best] * np.einsum("nk,k,nk->n", vectors, share, vectors)
    return SlowMotion(motion, np.sqrt(left))
