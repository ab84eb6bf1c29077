"""How much more the poses of arcs scatter than their covariances say: the robot's share.

V_k = C_k + s_p² E_p + s_r² E_r, with C_k the instrument's covariance (zero where none is known), E_p and E_r the unit
matrices of position and of rotation. Restricted maximum likelihood over all arcs, each with its own parameters of
covariance Σ: with P = V⁻¹, less what free angles take, P = V⁻¹ - V⁻¹g gᵀV⁻¹ / gᵀV⁻¹g,

    score_j = ½ Σ [rᵀP E_j P r - tr(P E_j) + tr(P E_j P J Σ Jᵀ)],     information_ij = ½ Σ tr(P E_i P E_j)

and steps of score over information, each variance held at its floor or above.

References: H. D. Patterson, R. Thompson, Biometrika 58 (1971) 545-554, 10.1093/biomet/58.3.545; D. A. Harville, J.
American Statistical Association 72 (1977) 320-338, 10.1080/01621459.1977.10480998.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

SMALLEST_MM, SMALLEST_RAD = 1e-6, 1e-9
"""No arm and no instrument is steadier; poses free of noise need it."""
_ITERATIONS = 40
_SETTLED = 1e-3


@dataclass(frozen=True, slots=True)
class Variances:
    """Of each coordinate of position (mm²) and of rotation (rad²)."""

    position: float
    rotation: float

    def diagonal(self, components: int) -> Float[np.ndarray, " m"]:
        return np.array([self.position] * 3 + [self.rotation] * 3)[:components]

    def near(self, other: Variances, share: float) -> bool:
        """Tell whether the standard deviations agree within a share of the larger."""
        pairs = ((self.position, other.position), (self.rotation, other.rotation))
        return all(abs(math.sqrt(a) - math.sqrt(b)) <= share * math.sqrt(max(a, b)) for a, b in pairs)


@dataclass(frozen=True, slots=True)
class ArcResiduals:
    """One arc: covariances, residuals, derivatives of the prediction, and by the free angle where there is one."""

    own: Float[np.ndarray, "n m m"]
    residuals: Float[np.ndarray, "n m"]
    jacobian: Float[np.ndarray, "n m p"]
    by_angle: Float[np.ndarray, "n m"] | None


def floor() -> Variances:
    """Return the least variances assumed."""
    return Variances(SMALLEST_MM**2, SMALLEST_RAD**2)


def weights(own: Float[np.ndarray, "n m m"], variances: Variances) -> Float[np.ndarray, "n m m"]:
    """Return W with W V Wᵀ = 1, lower triangular."""
    V = own + np.diag(variances.diagonal(own.shape[1]))
    # mm² and rad² differ by orders of magnitude.
    unit = 1.0 / np.sqrt(np.diagonal(V, axis1=1, axis2=2))
    lower = np.linalg.cholesky(V * unit[:, :, None] * unit[:, None, :])
    return np.asarray(np.linalg.inv(lower) * unit[:, None, :])


def estimate_variances(arcs: Sequence[ArcResiduals], start: Variances, kinds: int) -> Variances:
    """Return the variances that the residuals speak for; `kinds` is 1 for positions alone."""
    m = arcs[0].own.shape[1]
    E = np.zeros((kinds, m))
    E[0, :3] = 1.0
    E[1:, 3:] = 1.0
    least = np.array([SMALLEST_MM**2, SMALLEST_RAD**2])[:kinds]
    values = np.array([start.position, start.rotation])[:kinds]
    for _ in range(_ITERATIONS):
        score, information = np.zeros(kinds), np.zeros((kinds, kinds))
        for arc in arcs:
            W = weights(arc.own, Variances(float(values[0]), float(values[-1])))
            P = W.swapaxes(1, 2) @ W
            if arc.by_angle is not None:
                g = np.einsum("nij,nj->ni", P, arc.by_angle)
                P = P - g[:, :, None] * (g / np.sum(g * arc.by_angle, axis=1)[:, None])[:, None, :]
            PJ = P @ arc.jacobian
            H = np.einsum("nmp,nmq->pq", arc.jacobian, PJ)
            Pr = np.einsum("nij,nj->ni", P, arc.residuals)
            taken = np.einsum("nip,pq,niq->ni", PJ, np.linalg.pinv(H, hermitian=True), PJ)
            score += 0.5 * E @ (Pr**2 - np.diagonal(P, axis1=1, axis2=2) + taken).sum(axis=0)
            information += 0.5 * E @ (P**2).sum(axis=0) @ E.T
        former = values
        # One that is at its floor and wants to go below is held, and the other estimated given that.
        free = (values > least) | (score > 0.0)
        step = np.zeros(kinds)
        step[free] = np.linalg.solve(information[np.ix_(free, free)], score[free])
        values = np.maximum(values + step, least)
        if np.all(np.abs(values - former) <= _SETTLED * values):
            break
    return Variances(float(values[0]), float(values[1]) if kinds == 2 else start.rotation)
