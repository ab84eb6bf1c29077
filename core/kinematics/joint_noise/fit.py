"""Variances of the joints from the scatter of repeated poses: Brethé's stochastic ellipsoid, fitted.

Joint j stops with an independent error of variance τ_j² about where it is sent. At pose i the visits then scatter with

    V_i = C_i + J_i diag(τ²) J_iᵀ + s_p² E_p + s_r² E_r,

C_i the instrument's covariance, J_i the Jacobian of the pose by the joints' angles, and s what remains, equal in every
direction: of the robot where C is stated, of robot and instrument where it is not. With n_i visits the sum of
squares about the pose's mean, S_i, is Wishart with n_i - 1 degrees of freedom, which is the restricted likelihood. Its
scores and information, with A_k = ∂V/∂θ_k,

    score_k = ½ Σ [tr(V⁻¹ A_k V⁻¹ S) - (n - 1) tr(V⁻¹ A_k)],      information_kl = ½ Σ (n - 1) tr(V⁻¹ A_k V⁻¹ A_l),

give the steps; no variance is below zero. Visits whose distance from their mean has a chance of less than
`OUTLIER_CHANCE` in the whole session are excluded, and the fit repeated. Of two visits that are too far from each other
nothing says which one is wrong: both are excluded, and the pose with them.

References: J.-F. Brethé, E. Vasselin, D. Lefebvre, B. Dakyo, "Determination of the repeatability of a Kuka robot using
the stochastic ellipsoid approach", ICRA 2005, 4339-4344; D. A. Harville, J. American Statistical
Association 72 (1977) 320-338, 10.1080/01621459.1977.10480998.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import chdtri

from core.errors import TooFewPoses
from core.kinematics.joint_noise.scatter import MIN_POSES, PoseScatters
from core.numerics import covariance_of

OUTLIER_CHANCE = 0.01
MIN_VISITS_LEFT = 2
MIN_LEVER_SHARE = 1e-3
"""Of the largest: a joint that moves the poses by less says nothing of its noise."""
_MAX_ITERATIONS, _MAX_HALVINGS, _MAX_ROUNDS = 200, 30, 5
_CONVERGED = 1e-10  # of the log-likelihood, per degree of freedom
_FLOOR_MM2 = 1e-12
"""Of the residual variances, so that V is never singular: a micrometre's thousandth."""


@dataclass(frozen=True, slots=True)
class JointNoise:
    """Variances of the joints and of what is left, with their covariance.

    Parameters
    ----------
    variances
        θ: τ² of every joint (rad²), s_p² (mm²), and s_r² (mm² at the arm's reach) unless positions alone were measured.
    covariance
        Of θ, by the inverse information; zero of what is not identifiable.
    identifiable
        Which joints move the poses; the others' τ² are zero, and nothing is said of them.
    reach_mm
        The arm's: s_r over it is the standard deviation of a rotation, rad.
    outliers
        Which visits were excluded.
    """

    variances: Float[np.ndarray, " p"]
    covariance: Float[np.ndarray, "p p"]
    identifiable: Bool[np.ndarray, " j"]
    reach_mm: float
    outliers: Bool[np.ndarray, " n"]

    @property
    def joints(self) -> int:
        return len(self.identifiable)

    @property
    def deviations(self) -> Float[np.ndarray, " p"]:
        """The standard deviations: rad of every joint, then mm."""
        return np.asarray(np.sqrt(self.variances))

    def interval(self, factor: float) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, " p"]]:
        """Return the bounds of the standard deviations at `factor` standard uncertainties of the variances."""
        half = factor * np.sqrt(np.diag(self.covariance))
        return np.sqrt(np.maximum(self.variances - half, 0.0)), np.sqrt(self.variances + half)


def fit_joint_noise(seen: PoseScatters, *, rejecting: bool = True) -> JointNoise:
    """Fit the variances of the joints, and of what is left, to the scatter of poses; `rejecting` looks for outliers.

    Raises TooFewPoses where the visits of fewer than `MIN_POSES` poses agree.
    """
    dropped = np.zeros(len(seen.deviations), dtype=np.bool_)
    found = _fitted(seen)
    for _ in range(_MAX_ROUNDS if rejecting else 0):
        far = _outlying(seen, dropped, found)
        if np.array_equal(far, dropped):
            break
        dropped = far
        kept = seen.without(dropped)
        left = int(np.count_nonzero(kept.visits >= MIN_VISITS_LEFT))
        if left < MIN_POSES:
            raise TooFewPoses(
                f"Only at {left} of {len(seen.labels)} poses do repeated visits agree; {MIN_POSES} are the least that "
                "show the joints' noise.",
                "Look at the visits in repeatability, and visit the poses again, ten times each or more.",
            )
        found = _fitted(kept)
    return JointNoise(*found, seen.arm.reach_mm, dropped)


def scatter_covariance(
    jacobian: Float[np.ndarray, "k m j"], variances: Float[np.ndarray, " p"]
) -> Float[np.ndarray, "k m m"]:
    """Return the robot's covariance at poses: of its joints, and what is left."""
    m, joints = jacobian.shape[1:]
    left = np.repeat(variances[joints:], 3)[:m]
    return np.asarray(
        (jacobian * variances[:joints]) @ jacobian.transpose(0, 2, 1) + np.diag(left + _FLOOR_MM2)
    )


def log_likelihood(
    V: Float[np.ndarray, "k m m"], scatter: Float[np.ndarray, "k m m"], freedom: Float[np.ndarray, " k"]
) -> Float[np.ndarray, " k"]:
    """Return each pose's restricted log-likelihood, but for a constant."""
    determinant = np.linalg.slogdet(V)[1]
    spread = np.trace(np.linalg.solve(V, scatter), axis1=1, axis2=2)
    return np.asarray(-0.5 * (freedom * determinant + spread))


_Fitted = tuple[Float[np.ndarray, " p"], Float[np.ndarray, "p p"], Bool[np.ndarray, " j"]]


def _fitted(seen: PoseScatters) -> _Fitted:
    J, S = seen.jacobian, seen.scatter
    freedom = np.maximum(seen.visits - 1, 0).astype(np.float64)
    k, m, joints = J.shape
    lever = np.sqrt(np.einsum("kmj,kmj->j", J, J))
    identifiable = lever > MIN_LEVER_SHARE * lever.max()
    A = np.zeros((joints + m // 3, k, m, m))
    A[:joints] = np.einsum("kmj,klj->jkml", J, J)
    for part in range(m // 3):
        A[joints + part, :, range(3 * part, 3 * part + 3), range(3 * part, 3 * part + 3)] = 1.0
    usable = np.append(identifiable, np.ones(m // 3, dtype=np.bool_))

    def value(theta: Float[np.ndarray, " p"]) -> float:
        return float(log_likelihood(seen.own + scatter_covariance(J, theta), S, freedom).sum())

    # A start of equal shares: each of all the variance that the instrument leaves, by its own trace.
    excess = np.trace(S - freedom[:, None, None] * seen.own, axis1=1, axis2=2).sum()
    least = 0.01 * np.trace(S, axis1=1, axis2=2).sum()
    weight = np.einsum("k,pkmm->p", freedom, A)
    theta = np.where(usable, max(excess, least) / np.maximum(weight, 1e-300) / np.count_nonzero(usable), 0.0)
    best = value(theta)
    for _ in range(_MAX_ITERATIONS):
        score, information = _score(A, seen.own + scatter_covariance(J, theta), S, freedom)
        free = usable & ((theta > 0.0) | (score > 0.0))
        if not free.any():
            break  # the instrument's covariance is more than all scatter
        step = np.zeros_like(theta)
        step[free] = covariance_of(information[np.ix_(free, free)]) @ score[free]
        former = best
        for halving in range(_MAX_HALVINGS):
            tried = np.maximum(theta + 0.5**halving * step, 0.0)
            reached = value(tried)
            if reached >= best:
                theta, best = tried, reached
                break
        if best - former <= _CONVERGED * float(freedom.sum()):
            break
    information = _score(A, seen.own + scatter_covariance(J, theta), S, freedom)[1]
    covariance = np.zeros_like(information)
    covariance[np.ix_(usable, usable)] = covariance_of(information[np.ix_(usable, usable)])
    return theta, covariance, identifiable


def _score(
    A: Float[np.ndarray, "p k m m"],
    V: Float[np.ndarray, "k m m"],
    scatter: Float[np.ndarray, "k m m"],
    freedom: Float[np.ndarray, " k"],
) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, "p p"]]:
    W = np.linalg.inv(V)
    WA = W @ A
    score = 0.5 * (np.einsum("pkab,kba->p", WA, W @ scatter) - np.einsum("k,pkaa->p", freedom, WA))
    information = 0.5 * np.einsum("k,pkab,qkba->pq", freedom, WA, WA, optimize=True)
    return score, information


def _outlying(seen: PoseScatters, dropped: Bool[np.ndarray, " n"], found: _Fitted) -> Bool[np.ndarray, " n"]:
    """Return the visits that are too far from the mean of those kept; of a pose two that agree stay, or none.

    The visits of a pose of which none was kept are compared with their own mean.
    """
    left = np.bincount(seen.pose[~dropped], minlength=len(seen.jacobian))
    kept = ~dropped | (left < MIN_VISITS_LEFT)[seen.pose]
    counts = np.bincount(seen.pose[kept], minlength=len(seen.jacobian))
    sums = np.zeros((len(seen.jacobian), seen.deviations.shape[1]))
    np.add.at(sums, seen.pose[kept], seen.deviations[kept])
    off = seen.deviations - (sums / counts[:, None])[seen.pose]
    W = np.linalg.inv(seen.own + scatter_covariance(seen.jacobian, found[0]))
    n = counts[seen.pose].astype(np.float64)
    growth = np.where(kept, n / np.maximum(n - 1.0, 1.0), n / (n + 1.0))
    distance = growth * np.einsum("na,nab,nb->n", off, W[seen.pose], off)
    limit = float(chdtri(off.shape[1], OUTLIER_CHANCE / len(off)))
    far = distance > limit
    for pose in np.unique(seen.pose[far]):
        members = np.flatnonzero(seen.pose == pose)
        nearest = members[np.argsort(distance[members], kind="stable")[:MIN_VISITS_LEFT]]
        apart = off[nearest[0]] - off[nearest[1]]
        far[nearest] = 0.5 * apart @ W[pose] @ apart > limit
    return np.asarray(far)


def chi_ratio(
    V: Float[np.ndarray, "k m m"], scatter: Float[np.ndarray, "k m m"], freedom: Float[np.ndarray, " k"]
) -> float:
    """Return the root of the mean squared whitened deviation: 1 where V is the covariance of the visits."""
    spread = np.trace(np.linalg.solve(V, scatter), axis1=1, axis2=2)
    return math.sqrt(float(spread.sum()) / (float(freedom.sum()) * V.shape[1]))
