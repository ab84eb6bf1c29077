"""Scatter with the noise of its measurements subtracted, and by how much the subtraction errs.

Because the covariance S of the cycles is itself scattered, what D = S - M̄ reads is biased: upward where noise makes a
sphere look elongated, downward where the subtraction stops at zero. The bias is found by repeating the subtraction on
Wishart replicates of the model D + M. Replicates of S itself would leave 2 % where robot and noise have equal figures:
where the subtraction stopped at zero, S is no sum of M and a covariance. The bias depends on D's size, which is biased
too, so that it is found once more with D scaled by the first answer.

References: B. Efron, R. J. Tibshirani, "An Introduction to the Bootstrap", 1993, §10.6 (bias correction);
T. W. Anderson, "An Introduction to Multivariate Statistical Analysis", 2003, §7.2 (Bartlett's decomposition).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float
from scipy.special import chdtri, ndtri

from core.metrology.repeatability.replica_readings import replica_readings
from core.metrology.rp_distribution import long_run_rp

_POINTS = 32  # a power of two, which balances the net
_SIGNS = np.array([[1.0, 1.0, 1.0], [1.0, 1.0, -1.0], [1.0, -1.0, 1.0], [-1.0, 1.0, 1.0]])
_ROUNDS = 2


@dataclass(frozen=True, slots=True)
class ScatterEstimate:
    """What an estimate g of the scatter read, mm; by what factor it reads too much, and the variance of its logarithm
    were it lognormal, both by replicates.
    """

    found: Float[np.ndarray, " k"]
    gain: Float[np.ndarray, " k"]
    log_variance: Float[np.ndarray, " k"]


def subtracted_scatter(
    covariance: Float[np.ndarray, "k 3 3"], noise: Float[np.ndarray, "k 3 3"], cycles: Float[np.ndarray, " k"]
) -> tuple[ScatterEstimate, ScatterEstimate]:
    """Return what g(S - M) and g(S) are worth, by Wishart replicates S* of the model D + M that was fitted.

    D's size is taken to where the replicates read what was observed, once, since the factor depends on it.
    """
    values, vectors = np.linalg.eigh(covariance - noise)
    values = np.maximum(values, 0.0)
    left = long_run_rp(values[:, ::-1])
    size = long_run_rp(np.linalg.eigvalsh(covariance)[:, ::-1])
    gain, log_variance = np.empty((2, len(left))), np.empty((2, len(left)))
    for n in np.unique(cycles):
        rows = np.flatnonzero(cycles == n)
        factors = _wishart_factors(int(n) - 1).copy()  # kernels take arrays that may be written
        for chunk in np.array_split(rows, max(1, len(rows) // 64)):
            D, M = _composed(vectors[chunk], values[chunk]), np.ascontiguousarray(noise[chunk])
            scale = np.ones(len(chunk))
            for _ in range(_ROUNDS):
                model = scale[:, None, None] * D + M
                roots = _roots(model)
                of_robot = replica_readings(roots, factors, M)
                gain[0, chunk] = share(of_robot.mean(axis=1), np.sqrt(scale) * left[chunk])
                scale = share(np.ones(len(chunk)), gain[0, chunk]) ** 2
            of_all = replica_readings(roots, factors, np.zeros_like(M))
            gain[1, chunk] = share(of_all.mean(axis=1), long_run_rp(np.linalg.eigvalsh(model)[:, ::-1]))
            for k, sizes in enumerate((of_robot, of_all)):
                log_variance[k, chunk] = np.log1p(share(sizes.var(axis=1), sizes.mean(axis=1) ** 2))
    return ScatterEstimate(left, gain[0], log_variance[0]), ScatterEstimate(size, gain[1], log_variance[1])


def _composed(
    vectors: Float[np.ndarray, "k 3 3"], values: Float[np.ndarray, "k 3"]
) -> Float[np.ndarray, "k 3 3"]:
    return np.asarray((vectors * values[:, None, :]) @ np.swapaxes(vectors, 1, 2))


def _roots(covariance: Float[np.ndarray, "k 3 3"]) -> Float[np.ndarray, "k 3 3"]:
    """Return roots of covariances: times Wishart factors, those of sample covariances of cycles that scatter so."""
    values, vectors = np.linalg.eigh(covariance)
    return np.ascontiguousarray(vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :])


@lru_cache(maxsize=256)
def _wishart_factors(nu: int) -> Float[np.ndarray, "b 3 3"]:
    """Return A with A Aᵀ distributed as a Wishart matrix of ν degrees of freedom over ν (Bartlett).

    Each point of a Sobol net stands with every choice of signs of the axes, D A D: eigenvectors have no sign, and no
    result may depend on which one they came with.
    """
    # Takes half a second to load, which every process of a service would pay.
    from scipy.stats import qmc

    uniform = qmc.Sobol(6, scramble=False).random(_POINTS) + 0.5 / _POINTS
    factors = np.zeros((_POINTS, 3, 3))
    for i in range(min(nu, 3)):
        factors[:, i, i] = np.sqrt(chdtri(nu - i, uniform[:, i]))
    for column, (i, j) in enumerate(((1, 0), (2, 0), (2, 1))):
        if j < nu:  # with fewer cycles than dimensions the matrix has no more columns than ν
            factors[:, i, j] = ndtri(uniform[:, 3 + column])
    flips = _SIGNS[:, :, None] * _SIGNS[:, None, :]
    factors = (factors[:, None] * flips).reshape(-1, 3, 3) / np.sqrt(nu)
    factors.flags.writeable = False
    return factors


def share(part: Float[np.ndarray, "*k"], whole: Float[np.ndarray, "*k"]) -> Float[np.ndarray, "*k"]:
    """Return part / whole; 1 where there is nothing of either, 0 where there is no whole to a part."""
    some = whole > 0.0
    return np.asarray(np.where(some, part / np.where(some, whole, 1.0), np.where(part > 0.0, 0.0, 1.0)))
