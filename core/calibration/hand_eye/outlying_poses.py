"""Evidence that a pose excluded from a fit is a wrong one.

Distance in robust deviations is no evidence where few poses are left: three of six poses fit their frames nearly
exactly whatever they are, and the others then seem far away. A pose stays out only if its residual is improbable as
that of one more pose,

    F = eᵀ (V + J C Jᵀ)⁻¹ e / 3   against F(3, ν),

with C the covariance of the frames by the poses used, V the pose's own variance and ν the residuals that the variance
was estimated from beyond the unknowns. Position and rotation are tested each, and the probability is multiplied by the
number of tests (Bonferroni), since the pose that fits worst is one of all.

References: R. D. Cook, S. Weisberg, Residuals and Influence in Regression (Chapman and Hall 1982), section 2.2.2.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import fdtrc

WRONG = 0.01
"""Probability, over all poses, below which a pose that does not fit is a wrong one."""


def most_credible(
    residual: Float[np.ndarray, "n h 3"],
    covariance: Float[np.ndarray, "n h 3 3"],
    used: Bool[np.ndarray, " n"],
    surplus: float,
) -> int | None:
    """Return the pose among those not used that fits best, or None if all of them are wrong ones.

    Parameters
    ----------
    residual, covariance
        Of every pose, in h parts of three, predicted by the poses used: mm and mm² or rad and rad².
    surplus
        Degrees of freedom of each part's variance.
    """
    out = np.flatnonzero(~used)
    if not len(out):
        return None
    e = residual[out]
    squares = np.einsum("nhi,nhi->nh", e, np.linalg.solve(covariance[out], e[..., None])[..., 0])
    tests = residual.shape[0] * residual.shape[1]
    probability = tests * np.min(fdtrc(3.0, max(surplus, 1.0), squares / 3.0), axis=1)
    best = int(np.argmax(probability))
    return int(out[best]) if probability[best] >= WRONG else None
