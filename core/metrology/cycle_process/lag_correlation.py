"""The lag-one correlation φ of cycles, common to all poses, by restricted maximum likelihood on a grid.

Cycle c of a pose deviates as x_c = φ^k x_{c-k} + √(1 - φ^2k) e_c from the last visit k cycles before, with covariance Σ
of its own. Mean and Σ integrated out (flat, and |Σ|^-(d+1)/2), the likelihood of φ is

    |R|^-d/2 (1ᵀ R⁻¹ 1)^-d/2 |Xᵀ P X|^-(n-1)/2,     P = R⁻¹ - R⁻¹ 1 1ᵀ R⁻¹ / (1ᵀ R⁻¹ 1),

a product over the poses. Half of the prior is at φ = 0, half uniform over the grid.

References: H. D. Patterson, R. Thompson, Biometrika 58 (1971) 545-554, doi:10.1093/biomet/58.3.545.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

CORRELATIONS = np.linspace(0.02, 0.98, 49)
_PRIOR_INDEPENDENT = 0.5


def correlation_weights(
    poses: Sequence[tuple[Float[np.ndarray, "n d"], Int[np.ndarray, " n"]]],
) -> Float[np.ndarray, " c"]:
    """Return the posterior probabilities of φ in `CORRELATIONS`; what they lack to one is that of φ = 0."""
    grid = np.concatenate([[0.0], CORRELATIONS])
    total = np.zeros(len(grid))
    for x, cycles in poses:
        n, d = x.shape
        if d == 0 or n < d + 2:
            continue
        total += np.array([_log_likelihood(x, cycles, phi) for phi in grid])
    prior = np.full(len(grid), (1.0 - _PRIOR_INDEPENDENT) / len(CORRELATIONS))
    prior[0] = _PRIOR_INDEPENDENT
    posterior = prior * np.exp(total - total.max())
    return np.asarray(posterior[1:] / posterior.sum())


def _log_likelihood(x: Float[np.ndarray, "n d"], cycles: Int[np.ndarray, " n"], phi: float) -> float:
    n, d = x.shape
    # A second visit in the same cycle stands for the next one.
    rho = phi ** np.maximum(np.diff(cycles), 1)
    left = np.sqrt(1.0 - rho * rho)
    y = np.concatenate([x[:1], (x[1:] - rho[:, None] * x[:-1]) / left[:, None]])
    ones = np.concatenate([[1.0], (1.0 - rho) / left])
    weight = float(ones @ ones)
    along = ones @ y
    scatter = y.T @ y - np.outer(along, along) / weight
    sign, log_determinant = np.linalg.slogdet(scatter)
    if sign <= 0.0:
        return 0.0
    return float(-d * np.log(left).sum() - 0.5 * d * np.log(weight) - 0.5 * (n - 1.0) * log_determinant)
