"""The one nonlinear solver: Levenberg-Marquardt with Gaussian priors and robust weights.

The estimate minimises, over the state s,

    Σᵢ ρ(dᵢ² / (σ² uᵢ²)) + ‖q(s)‖²

where dᵢ is the length of point i's residual vector, uᵢ its relative standard uncertainty, q the priors'
residuals in units of their own σ, and σ the noise scale, which is itself estimated from the residuals: a
constant would be wrong for every camera but one. Two stages:

1. Cauchy, ρ(z) = c² log(1 + z/c²), with σ from the median distance, until the step is a small part of its own
   uncertainty: gross errors lose their pull.
2. Points beyond 4 MAD (4 · 1.4826 · the median distance) are rejected; the rest is fitted with ρ(z) = z, σ² =
   Σ dᵢ²/uᵢ² / (degrees of freedom), where priors count as the part of a measurement that they are: dof =
   observations - tr(H⁻¹ H_data).

Steps are solved from normal equations scaled to unit diagonal, so that pixels, millimetres and radians weigh
alike and the condition number reported is the scaled one.

References: D. W. Marquardt, SIAM J. Appl. Math. 11 (1963) 431-441; P. W. Holland, R. E. Welsch, Comm.
Statist. A6 (1977) 813-827 (tuning constants).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np
from jaxtyping import Bool, Float

State = TypeVar("State")

Evaluate = Callable[[State], tuple[Float[np.ndarray, "m n"], Float[np.ndarray, "p m n"]]]
"""state -> residuals (observed - predicted; m components of n points) and derivatives of the *prediction*."""
Prior = Callable[[State], tuple[Float[np.ndarray, " q"], Float[np.ndarray, "q p"]]]
"""state -> prior residuals (expected - state, in their σ) and derivatives of the state's side."""
Retract = Callable[[State, Float[np.ndarray, " p"]], State]
"""(state, step) -> state; the step's coordinates are the covariance's."""

CAUCHY_C = 2.385  # 95 % efficient on Gaussian residuals (Holland and Welsch 1977)
REJECTION = 4.0 * 1.4826  # of the median distance: 4 MAD, about 7 σ of one component for two components
STEP_TOLERANCE = (
    1e-2  # of its own standard uncertainty; convergence being quadratic, what is left is far less
)
ROBUST_STEP_TOLERANCE = 0.5  # the first stage only has to tell good points from bad


@dataclass(frozen=True, slots=True)
class Fit(Generic[State]):
    """What a fit found and how far to trust it.

    `status` is "converged", "iteration_limit" or "singular"; only the first is an answer. `covariance` has
    the step's coordinates. `scale` is σ in the residuals' unit per unit of relative uncertainty, `cost` the
    objective at the end.
    """

    state: State
    status: str
    covariance: Float[np.ndarray, "p p"]
    information: Float[np.ndarray, "p p"]  # data and priors, at `scale`
    condition_number: float
    residuals: Float[np.ndarray, "m n"]
    jacobian: Float[np.ndarray, "p m n"]
    used: Bool[np.ndarray, " n"]
    scale: float
    degrees_of_freedom: float
    cost: float
    iterations: int

    @property
    def converged(self) -> bool:
        return self.status == "converged"


def fit(
    evaluate: Evaluate[State],
    retract: Retract[State],
    start: State,
    relative_uncertainty: Float[np.ndarray, " n"],
    *,
    prior: Prior[State] | None = None,
    smallest_scale: float = 1e-9,
    iteration_limit: int = 40,
) -> Fit[State]:
    """Fit robustly and return the estimate with its covariance.

    Parameters: `relative_uncertainty` (n,) is each point's standard uncertainty in any common unit; only
    ratios matter.
    """
    run = _Run(
        evaluate,
        retract,
        prior,
        1.0 / (relative_uncertainty / np.mean(relative_uncertainty)),
        smallest_scale,
        iteration_limit,
    )
    robust, _ = run.minimise(run.linearised(start), used=None)
    distance = np.sqrt(robust.squared)
    used = distance <= REJECTION * max(float(np.median(distance)), smallest_scale)
    final, ok = run.minimise(robust, used=used)
    return run.summary(final, used, "converged" if ok else "iteration_limit")


@dataclass(frozen=True, slots=True)
class _Linearised(Generic[State]):
    """A state with what is known there: weighted residuals, their squared lengths, Jacobian, and the priors' part."""

    state: State
    residuals: Float[np.ndarray, "m n"]
    squared: Float[np.ndarray, " n"]
    jacobian: Float[np.ndarray, "p m n"]
    prior_residuals: Float[np.ndarray, " q"]
    prior_jacobian: Float[np.ndarray, "q p"]


def _scale_from_median(distance: Float[np.ndarray, " n"], components: int) -> float:
    """Return σ of one residual component from the median length (chi distribution with 1, 2 or 3 components)."""
    return float(np.median(distance)) / {1: 0.674490, 2: 1.177410, 3: 1.538172}[components]


def _solve(
    scaled: Float[np.ndarray, "p p"], slope: Float[np.ndarray, " p"], damping: float
) -> Float[np.ndarray, " p"] | None:
    """Return the damped step in scaled coordinates, or None where the matrix is singular."""
    damped = scaled.copy()
    damped.flat[:: len(slope) + 1] += damping
    try:
        step = np.linalg.solve(damped, slope)
    except np.linalg.LinAlgError:
        return None
    return step if np.all(np.isfinite(step)) else None


def _in_sigmas(scaled: Float[np.ndarray, "p p"], step: Float[np.ndarray, " p"]) -> float:
    """Length of a step in units of its own standard uncertainty."""
    return math.sqrt(max(float(step @ scaled @ step), 0.0))


def _normal_equations(
    at: _Linearised[Any], used: Bool[np.ndarray, " n"] | None, sigma: float
) -> tuple[Float[np.ndarray, "p p"], Float[np.ndarray, " p"]]:
    """Return the normal matrix and the right-hand side at noise scale `sigma`."""
    if used is None:
        root = 1.0 / np.sqrt(sigma**2 + at.squared / CAUCHY_C**2)
    else:
        root = used / sigma
    J = (at.jacobian * root).reshape(len(at.jacobian), -1)
    Q = at.prior_jacobian
    return J @ J.T + Q.T @ Q, J @ (at.residuals * root).ravel() + Q.T @ at.prior_residuals


def _cost(at: _Linearised[Any], used: Bool[np.ndarray, " n"] | None, sigma: float) -> float:
    if used is None:
        cost = CAUCHY_C**2 * float(np.log1p(at.squared / (sigma * CAUCHY_C) ** 2).sum())
    else:
        cost = float(at.squared @ used) / sigma**2
    cost += float(at.prior_residuals @ at.prior_residuals)
    return cost if math.isfinite(cost) else math.inf


class _Run(Generic[State]):
    """One fit's fixed arguments and its work counter; not part of the module's face."""

    def __init__(
        self,
        evaluate: Evaluate[State],
        retract: Retract[State],
        prior: Prior[State] | None,
        root_weight: Float[np.ndarray, " n"],
        smallest_scale: float,
        iteration_limit: int,
    ) -> None:
        self.evaluate, self.retract, self.prior = evaluate, retract, prior
        self.root_weight = None if np.ptp(root_weight) < 1e-12 else root_weight
        self.smallest_scale, self.iteration_limit = smallest_scale, iteration_limit
        self.iterations = 0

    def linearised(self, state: State) -> _Linearised[State]:
        residuals, jacobian = self.evaluate(state)
        if self.root_weight is not None:
            residuals, jacobian = residuals * self.root_weight, jacobian * self.root_weight
        squared = np.einsum("mn,mn->n", residuals, residuals)
        if self.prior is None:
            q, Q = np.zeros(0), np.zeros((0, len(jacobian)))
        else:
            q, Q = self.prior(state)
        return _Linearised(state, residuals, squared, jacobian, q, Q)

    def scale(self, at: _Linearised[State], used: Bool[np.ndarray, " n"] | None) -> float:
        """σ for the next step: from the median in the robust stage, then from the sum of squares.

        Parameters that no prior holds are taken off the observations; the exact degrees of freedom enter at the
        end. Until then σ only balances data and priors.
        """
        if used is None:
            found = _scale_from_median(np.sqrt(at.squared), len(at.residuals))
        else:
            free = max(len(at.jacobian) - len(at.prior_residuals), 0)
            found = math.sqrt(float(at.squared @ used) / max(int(used.sum()) * len(at.residuals) - free, 1))
        return max(found, self.smallest_scale)

    def minimise(
        self, at: _Linearised[State], *, used: Bool[np.ndarray, " n"] | None
    ) -> tuple[_Linearised[State], bool]:
        """Minimise with Cauchy weights over all points, or plainly over those `used`; True where it converged."""
        robust = used is None
        damping, tolerance = (1e-4, ROBUST_STEP_TOLERANCE) if robust else (0.0, STEP_TOLERANCE)
        for _ in range(self.iteration_limit):
            self.iterations += 1
            sigma = self.scale(at, used)
            H, g = _normal_equations(at, used, sigma)
            cost = _cost(at, used, sigma)
            diagonal = np.sqrt(np.diag(H))
            if not np.all(np.isfinite(diagonal)) or np.any(diagonal == 0):
                return at, False
            scaled, slope = H / np.outer(diagonal, diagonal), g / diagonal
            rejected = 0
            while True:
                step = _solve(scaled, slope, damping)
                if step is not None:
                    trial = self.linearised(self.retract(at.state, step / diagonal))
                    if _cost(trial, used, sigma) <= cost * (1.0 + 1e-12) + 1e-12:
                        break
                rejected += 1
                if rejected == 16:
                    # No step downhill exists within rounding: a minimum, if the gradient agrees.
                    return at, step is not None and _in_sigmas(scaled, step) < STEP_TOLERANCE
                damping = max(5.0 * damping, 1e-10)
            at = trial
            if _in_sigmas(scaled, step) < tolerance:
                # A damped step may be short for its damping's sake; only the undamped one measures the
                # distance left.
                if robust or damping < 1e-13:
                    return at, True
                damping = 0.0
            else:
                damping *= 0.5 if rejected else 0.02
        return at, False

    def summary(self, at: _Linearised[State], used: Bool[np.ndarray, " n"], status: str) -> Fit[State]:
        """Scale, degrees of freedom, covariance and the unweighted residuals at the end of a fit."""
        state, residuals = at.state, at.residuals
        J = (at.jacobian * used).reshape(len(at.jacobian), -1)
        data = J @ J.T
        square_sum = float(np.sum(residuals[:, used] ** 2))
        count = residuals[:, used].size
        prior_residuals, Q = at.prior_residuals, at.prior_jacobian
        scale, dof = max(math.sqrt(square_sum / max(count, 1)), self.smallest_scale), float(count)
        information, covariance = data, np.full_like(data, np.nan)
        condition = math.inf
        for _ in range(3):  # σ and the degrees of freedom that priors leave depend on one another, weakly
            information = data / scale**2 + Q.T @ Q
            diagonal = np.sqrt(np.diag(information))
            if not np.all(diagonal > 0):
                status = "singular"
                break
            values, vectors = np.linalg.eigh(information / np.outer(diagonal, diagonal))
            if values[0] <= 1e-15 * values[-1]:
                status = "singular"
                break
            condition = float(values[-1] / values[0])
            covariance = (vectors / values) @ vectors.T / np.outer(diagonal, diagonal)
            dof = count - float(np.sum(covariance * data)) / scale**2
            if dof <= 0.5:
                status = "singular"
                break
            scale = max(math.sqrt(square_sum / dof), self.smallest_scale)
        else:
            information = data / scale**2 + Q.T @ Q
            covariance = np.linalg.inv(information)
        return Fit(
            state=state,
            status=status,
            covariance=0.5 * (covariance + covariance.T),
            information=information,
            condition_number=condition,
            residuals=residuals if self.root_weight is None else residuals / self.root_weight,
            jacobian=at.jacobian if self.root_weight is None else at.jacobian / self.root_weight,
            used=used,
            scale=scale,
            degrees_of_freedom=dof,
            cost=square_sum / scale**2 + float(prior_residuals @ prior_residuals),
            iterations=self.iterations,
        )
