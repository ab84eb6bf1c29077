"""How much the robot itself scatters: variance components of poses about the arm that was fitted to them.

V_i = C_i + s_p² E_p + s_r² E_r, with C_i the instrument's covariance, E_p and E_r the unit matrices of position and of
rotation. Restricted maximum likelihood: with r the residuals, J their Jacobian, Σ the fit's covariance, K = V⁻¹,

    score_j = ½ Σ_i [ rᵀ K E_j K r - tr(K E_j) + tr(K E_j K J Σ Jᵀ) ],    information_jk = ½ Σ_i tr(K E_j K E_k)

and steps of score over information, each variance held at zero or above. The last term of the score gives back what the
fit took for its parameters. Where the instrument's covariance is not known, C = 0 and s_p, s_r are all there is.

References: H. D. Patterson, R. Thompson, Biometrika 58 (1971) 545-554; D. A. Harville, JASA 72 (1977) 320-338.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from core.kinematics.problem import Observations, Scatter

SMALLEST = Scatter((1e-6) ** 2, (1e-9) ** 2)
"""No robot and no instrument is steadier; noise-free simulations need it."""
ITERATIONS = 30
SETTLED = 1e-3  # relative change of a variance


def estimate_scatter(
    seen: Observations,
    residuals: Float[np.ndarray, "m n"],
    leverage: Float[np.ndarray, "n m m"],
    start: Scatter,
) -> Scatter:
    """Return the variances that the residuals speak for; `leverage` is J Σ Jᵀ of every pose."""
    m = seen.components
    kinds = 2 if m == 6 else 1
    E = np.zeros((kinds, m))
    E[0, :3] = 1.0
    E[1:, 3:] = 1.0
    floor = np.array([SMALLEST.position, SMALLEST.rotation])[:kinds]
    variances = np.array([start.position, start.rotation])[:kinds]
    r = residuals.T
    for _ in range(ITERATIONS):
        V = seen.own + np.diag(E.T @ variances)
        unit = 1.0 / np.sqrt(np.diagonal(V, axis1=1, axis2=2))
        K = np.linalg.inv(V * unit[:, :, None] * unit[:, None, :]) * unit[:, :, None] * unit[:, None, :]
        Kr = np.einsum("nab,nb->na", K, r)
        diagonal = np.diagonal(K, axis1=1, axis2=2)
        taken = np.einsum("nab,nbc,nca->na", K, leverage, K)
        score = 0.5 * E @ (Kr**2 - diagonal + taken).sum(axis=0)
        information = 0.5 * E @ (K**2).sum(axis=0) @ E.T
        former = variances
        # A variance at its floor that wants to go below is held, and the other estimated given that: a joint step
        # would leave the other too large.
        free = (variances > floor) | (score > 0.0)
        step = np.zeros(kinds)
        step[free] = np.linalg.solve(information[np.ix_(free, free)], score[free])
        variances = np.maximum(variances + step, floor)
        if np.all(np.abs(variances - former) <= SETTLED * variances):
            break
    return Scatter(float(variances[0]), float(variances[1]) if kinds == 2 else start.rotation)
