"""The one nonlinear solver: Levenberg-Marquardt with Gaussian priors and robust weights.

The estimate minimises, over the state s,

    Σᵢ ρ(dᵢ² / (σ² uᵢ²)) + ‖q(s)‖²

where dᵢ is the length of point i's residual vector, uᵢ its relative standard uncertainty, q the priors'
residuals in units of their own σ, and σ the noise scale, which is itself estimated from the residuals: a
constant would be wrong for every camera but one. Three stages:

1. Plain, ρ(z) = z, over all points, by Gauss-Newton steps. Where the residuals are the noise that was expected and
   none lies beyond 4 MAD (4 · 1.4826 · the median distance) there are no gross errors, and this is the answer.
2. Else Cauchy, ρ(z) = c² log(1 + z/c²), with σ from the median distance, until the step is a small part of its own
   uncertainty: gross errors lose their pull.
3. Points beyond 4 MAD are rejected and the rest is fitted plainly.

σ² = Σ dᵢ²/uᵢ² / (degrees of freedom), where priors count as the part of a measurement that they are: dof =
observations - tr(H⁻¹ H_data).

Steps are solved from normal equations scaled to unit diagonal, so that pixels, millimetres and radians have
equal weight and the condition number reported is the scaled one.

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

from core.numerics.normal_equations import condition_number, damped_step, inverse

State = TypeVar("State")

Evaluate = Callable[[State], tuple[Float[np.ndarray, "m n"], Float[np.ndarray, "p m n"]]]
"""state -> residuals (observed - predicted; m components of n points) and derivatives of the *prediction*."""
Prior = Callable[[State], tuple[Float[np.ndarray, " q"], Float[np.ndarray, "q p"]]]
"""state -> prior residuals (expected - state, in their σ) and derivatives of the state's side."""
Retract = Callable[[State, Float[np.ndarray, " p"]], State]
"""(state, step) -> state; the step's coordinates are the covariance's."""

CAUCHY_C = 2.385  # 95 % efficient on Gaussian residuals (Holland and Welsch 1977)
REJECTION = 4.0 * 1.4826  # of the median distance: 4 MAD, about 7 σ of one component for two components
MEDIAN_LENGTH = {1: 0.674490, 2: 1.177410, 3: 1.538172, 4: 1.832128, 5: 2.086015, 6: 2.312600}
"""Median length of a vector of so many normal components, in their σ (chi distribution)."""
STEP_TOLERANCE = 1e-2  # of its own standard uncertainty; steps shrink, so that what is left is far less
NEGLIGIBLE_STEP = 2e-3  # need not be taken at all
SETTLED = 1e-3  # relative change of σ, which balances data and priors, by the last step
ROBUST_STEP_TOLERANCE = 0.5  # the robust stage only separates good points from bad
MIN_DAMPING = 1e-10  # of the unit diagonal
REJECTED_STEPS = 16
# The first stage: how long it is tried, and when its answer may stand without the others.
PLAIN_ITERATIONS = 10
OBSERVATIONS_PER_PARAMETER = 4.0  # with fewer, gross errors can hide in a plain fit
EXPECTED_SCALE = 1.5  # of the stated uncertainty: beyond that, gross errors may be hiding one another


@dataclass(frozen=True, slots=True)
class Fit(Generic[State]):
    """Result of a fit: estimate, covariance, status and statistics.

    `status` is "converged", "iteration_limit" or "singular"; only the first is an answer. `covariance` has
    the step's coordinates. `scale` is σ in the residuals' unit per unit of relative uncertainty.
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
    iterations: int

    @property
    def converged(self) -> bool:
        return self.status == "converged"


def fit(
    evaluate: Evaluate[State],
    retract: Retract[State],
    start: State,
    uncertainty: Float[np.ndarray, " n"],
    *,
    prior: Prior[State] | None = None,
    smallest_scale: float = 1e-9,
    iteration_limit: int = 40,
    used: Bool[np.ndarray, " n"] | None = None,
) -> Fit[State]:
    """Fit robustly and return the estimate with its covariance.

    Parameters: `uncertainty` (n,) is each point's standard uncertainty in the residuals' unit. Only ratios enter the
    estimate; the level shows whether the residuals are the expected noise. `used` are the points that count,
    where that is already decided: the fit is a plain one.
    """
    expected = float(np.mean(uncertainty))
    run = _Run(evaluate, retract, prior, expected / uncertainty, smallest_scale, iteration_limit)
    at = run.linearised(start)
    if used is not None:
        final, ok = run.minimise(at, used=used)
        return run.summary(final, used, "converged" if ok else "iteration_limit")
    if at.residuals.size >= OBSERVATIONS_PER_PARAMETER * len(at.jacobian):
        everything = np.ones(len(uncertainty), dtype=np.bool_)
        largest = max(EXPECTED_SCALE * expected, smallest_scale)
        plain, ok = run.minimise(at, used=everything, largest_scale=largest, limit=PLAIN_ITERATIONS)
        # Gross errors can pull a plain fit anywhere: then it is no start for the next stage either.
        if ok and run.inliers(plain).all():
            if run.scale(plain, everything) <= largest:
                return run.summary(plain, everything, "converged")
            at = plain
    robust, _ = run.minimise(at, used=None)
    used = run.inliers(robust)
    final, ok = run.minimise(robust, used=used)
    return run.summary(final, used, "converged" if ok else "iteration_limit")


@dataclass(frozen=True, slots=True)
class _Linearised(Generic[State]):
    """Linearisation at a state: weighted residuals, their squared lengths, Jacobian, and the priors' part."""

    state: State
    residuals: Float[np.ndarray, "m n"]
    squared: Float[np.ndarray, " n"]
    jacobian: Float[np.ndarray, "p m n"]
    prior_residuals: Float[np.ndarray, " q"]
    prior_jacobian: Float[np.ndarray, "q p"]


def _normal_equations(
    at: _Linearised[Any], used: Bool[np.ndarray, " n"] | None, sigma: float
) -> tuple[Float[np.ndarray, "p p"], Float[np.ndarray, " p"]]:
    """Return the normal matrix and the right-hand side at noise scale `sigma`."""
    jacobian, residuals = at.jacobian, at.residuals
    if used is None:
        root = 1.0 / np.sqrt(1.0 + at.squared / (sigma * CAUCHY_C) ** 2)
        jacobian, residuals = jacobian * root, residuals * root
    elif not used.all():
        jacobian, residuals = jacobian * used, residuals * used
    J, Q, weight = jacobian.reshape(len(jacobian), -1), at.prior_jacobian, 1.0 / sigma**2
    return weight * (J @ J.T) + Q.T @ Q, weight * (J @ residuals.ravel()) + Q.T @ at.prior_residuals


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
            found = math.sqrt(float(np.median(at.squared))) / MEDIAN_LENGTH[len(at.residuals)]
        else:
            free = max(len(at.jacobian) - len(at.prior_residuals), 0)
            found = math.sqrt(float(at.squared @ used) / max(int(used.sum()) * len(at.residuals) - free, 1))
        return max(found, self.smallest_scale)

    def inliers(self, at: _Linearised[State]) -> Bool[np.ndarray, " n"]:
        """Which points lie within the rejection's distance."""
        limit = max(REJECTION**2 * float(np.median(at.squared)), (REJECTION * self.smallest_scale) ** 2)
        within: Bool[np.ndarray, " n"] = at.squared <= limit
        return within

    def minimise(
        self,
        at: _Linearised[State],
        *,
        used: Bool[np.ndarray, " n"] | None,
        largest_scale: float = math.inf,
        limit: int | None = None,
    ) -> tuple[_Linearised[State], bool]:
        """Minimise with Cauchy weights over all points, or plainly over those `used`; True where it converged."""
        robust = used is None
        damping, tolerance = (1e-4, ROBUST_STEP_TOLERANCE) if robust else (0.0, STEP_TOLERANCE)
        sigma, full = 0.0, math.inf  # noise scale and length of the last step, if it was a full one
        for _ in range(self.iteration_limit if limit is None else limit):
            sigma, former = min(self.scale(at, used), largest_scale), sigma
            if full < tolerance and abs(sigma - former) < SETTLED * sigma:
                return at, True
            self.iterations += 1
            H, g = _normal_equations(at, used, sigma)
            cost = _cost(at, used, sigma)
            rejected = 0
            while True:
                step, length = damped_step(H, g, damping)
                if damping == 0.0 and length < NEGLIGIBLE_STEP:
                    return at, True
                if length < math.inf:
                    trial = self.linearised(self.retract(at.state, step))
                    if _cost(trial, used, sigma) <= cost * (1.0 + 1e-12) + 1e-12:
                        break
                rejected += 1
                if rejected == REJECTED_STEPS:
                    # No step downhill exists within rounding: a minimum, if the gradient agrees.
                    return at, length < tolerance
                damping = max(5.0 * damping, MIN_DAMPING)
            at = trial
            if robust and length < tolerance:
                return at, True
            # A damped step may be short for its damping's sake; only a full one measures the distance left.
            full = length if damping == 0.0 else math.inf
            damping = 0.0 if length < tolerance else damping * (0.5 if rejected else 0.02)
            if damping < MIN_DAMPING:
                damping = 0.0
        return at, False

    def summary(self, at: _Linearised[State], used: Bool[np.ndarray, " n"], status: str) -> Fit[State]:
        """Scale, degrees of freedom, covariance and the unweighted residuals at the end of a fit."""
        J = (at.jacobian if used.all() else at.jacobian * used).reshape(len(at.jacobian), -1)
        data, held = J @ J.T, at.prior_jacobian.T @ at.prior_jacobian
        square_sum, count = float(at.squared @ used), int(used.sum()) * len(at.residuals)
        scale, dof = max(math.sqrt(square_sum / max(count, 1)), self.smallest_scale), float(count)
        for _ in range(3):  # σ and the degrees of freedom that priors leave depend on one another, weakly
            dof = count - float(np.vdot(inverse(data / scale**2 + held), data)) / scale**2
            if not dof > 0.5:  # NaN, too, where there is no inverse
                status = "singular"
                break
            scale = max(math.sqrt(square_sum / dof), self.smallest_scale)
        information = data / scale**2 + held
        covariance, condition = inverse(information), condition_number(information)
        return Fit(
            state=at.state,
            status=status if math.isfinite(condition) else "singular",
            covariance=covariance,
            information=information,
            condition_number=condition,
            residuals=at.residuals if self.root_weight is None else at.residuals / self.root_weight,
            jacobian=at.jacobian if self.root_weight is None else at.jacobian / self.root_weight,
            used=used,
            scale=scale,
            degrees_of_freedom=dof,
            iterations=self.iterations,
        )
