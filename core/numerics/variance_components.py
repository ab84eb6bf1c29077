"""Variance components of poses: how much they scatter beyond their covariances, in position and in rotation.

    y_i = J_i b + noise,      V_i = C_i + s_p² E_p + s_r² E_r

with C_i the known covariance of pose i (zero where none is known), E_p and E_r the unit matrices of position and of
rotation. Restricted maximum likelihood over all groups of poses, each with parameters b of its own, of covariance Σ:
with P = V⁻¹, less what a free parameter of each pose takes, P = V⁻¹ - V⁻¹g gᵀV⁻¹ / gᵀV⁻¹g, and r the residuals,

    score_j = ½ Σ [rᵀP E_j P r - tr(P E_j) + tr(P E_j P J Σ Jᵀ)],     information_jk = ½ Σ tr(P E_j P E_k)

and steps of score over information, each variance held at its floor or above. The last term of the score gives back
what the fit took for its parameters; the information leaves that out, which makes the steps a little short and never
too long.

References: H. D. Patterson, R. Thompson, Biometrika 58 (1971) 545-554, 10.1093/biomet/58.3.545; D. A. Harville, J.
American Statistical Association 72 (1977) 320-338, 10.1080/01621459.1977.10480998.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

_ITERATIONS = 100
_SETTLED = 1e-4  # relative change of a variance


@dataclass(frozen=True, slots=True)
class Variances:
    """Of each coordinate of position (mm²) and of rotation (rad²)."""

    position: float
    rotation: float

    @classmethod
    def of_deviations(cls, position_mm: float, rotation: float) -> Variances:
        """Return the squares of standard deviations (mm, rad)."""
        return cls(position_mm**2, rotation**2)

    @property
    def deviations(self) -> tuple[float, float]:
        """Return the standard deviations (mm, rad)."""
        return math.sqrt(self.position), math.sqrt(self.rotation)

    def diagonal(self, components: int) -> Float[np.ndarray, " m"]:
        """Return the variances of a pose's six components (x, y, z, then rotation), or of its position's three."""
        return np.array([self.position] * 3 + [self.rotation] * 3)[:components]

    def near(self, other: Variances, share: float) -> bool:
        """Return whether the standard deviations agree within a share of the larger."""
        pairs = zip(self.deviations, other.deviations, strict=True)
        return all(abs(a - b) <= share * max(a, b) for a, b in pairs)


SMALLEST = Variances.of_deviations(1e-6, 1e-9)
"""No robot and no instrument is steadier; poses free of noise need it."""


@dataclass(frozen=True, slots=True)
class LinearResiduals:
    """Poses about one fit of theirs, of m components: 6, or 3 for positions alone.

    Parameters
    ----------
    known
        C, the covariances.
    residuals
        Observed - predicted.
    jacobian
        J, the derivatives of the prediction.
    by_pose
        g, the derivative by a parameter that each pose has of its own; None without such a parameter.
    covariance
        Σ of a fit that stays as it is. None: the fit follows the variances, Σ = (Σ JᵀPJ)⁻¹, and its residuals
        with it.
    """

    known: Float[np.ndarray, "n m m"]
    residuals: Float[np.ndarray, "n m"]
    jacobian: Float[np.ndarray, "n m p"]
    by_pose: Float[np.ndarray, "n m"] | None = None
    covariance: Float[np.ndarray, "p p"] | None = None


def weights(known: Float[np.ndarray, "n m m"], variances: Variances) -> Float[np.ndarray, "n m m"]:
    """Return W with W V Wᵀ = 1, lower triangular."""
    V = known + np.diag(variances.diagonal(known.shape[1]))
    # mm² and rad² differ by orders of magnitude.
    unit = 1.0 / np.sqrt(np.diagonal(V, axis1=1, axis2=2))
    lower = np.linalg.cholesky(V * unit[:, :, None] * unit[:, None, :])
    return np.tril(np.linalg.inv(lower) * unit[:, None, :])


def estimate_variances(
    groups: Sequence[LinearResiduals], start: Variances, least: Variances = SMALLEST
) -> Variances:
    """Return the variances, none below `least`, that explain the residuals; of positions alone the rotation's stays.

    Raises ValueError for no groups.
    """
    if not groups:
        raise ValueError("Variance components need at least one group of poses.")
    m = groups[0].known.shape[1]
    kinds = m // 3
    E = np.repeat(np.eye(kinds), 3, axis=1)
    floor = np.array([least.position, least.rotation])[:kinds]
    values = np.array([start.position, start.rotation])[:kinds]
    for _ in range(_ITERATIONS):
        score, information = np.zeros(kinds), np.zeros((kinds, kinds))
        for group in groups:
            W = weights(group.known, Variances(float(values[0]), float(values[-1])))
            P = W.swapaxes(1, 2) @ W
            if group.by_pose is not None:
                g = np.einsum("nij,nj->ni", P, group.by_pose)
                P = P - g[:, :, None] * (g / np.sum(g * group.by_pose, axis=1)[:, None])[:, None, :]
            PJ = P @ group.jacobian
            Pr = np.einsum("nij,nj->ni", P, group.residuals)
            covariance = group.covariance
            if covariance is None:
                H = np.einsum("nmp,nmq->pq", group.jacobian, PJ)
                covariance = np.linalg.pinv(H, hermitian=True)
                Pr = Pr - PJ @ (covariance @ np.einsum("nmp,nm->p", PJ, group.residuals))
            taken = np.sum((PJ @ covariance) * PJ, axis=2)
            score += 0.5 * E @ (Pr**2 - np.diagonal(P, axis1=1, axis2=2) + taken).sum(axis=0)
            information += 0.5 * E @ (P**2).sum(axis=0) @ E.T
        former = values
        # A variance at its floor whose score is negative is held, and the other estimated given that: a joint step
        # would leave the other too large.
        free = (values > floor) | (score > 0.0)
        step = np.zeros(kinds)
        step[free] = np.linalg.solve(information[np.ix_(free, free)], score[free])
        values = np.maximum(values + step, floor)
        if np.all(np.abs(values - former) <= _SETTLED * values):
            break
    return Variances(float(values[0]), float(values[1]) if kinds == 2 else start.rotation)
