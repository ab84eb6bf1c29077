"""The model of an arm beyond its chain: which terms it has, and what they are.

Which level is taken: the one of the greatest marginal likelihood, where the evidence is strong and it predicts held-out
poses no worse than the chain alone; with fewer than 60 configurations it has to predict them better. The covariance of
the chain's parameters is another question. They scatter by whatever the robot has beyond its chain, whether or not
these terms are good for prediction: cov = C + C B V Bᵀ C, where C is the level's posterior covariance, B the products
of its columns with those of the terms that it lacks, and V the variances of these.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from core.kinematics.error_model.evidence import Fitted, solve
from core.kinematics.error_model.fit import ErrorFit, Level, fit_levels
from core.kinematics.error_model.gravity import likely_gravity
from core.kinematics.error_model.held_out import growth, hold_out
from core.kinematics.error_model.linear_problem import Design
from core.kinematics.error_model.priors import FEW_POSES
from core.kinematics.error_model.terms import ALONG_Z, Kind
from core.kinematics.global_fit import Blocking, HoldOutError, rms
from core.numerics import Variances

STRONG_EVIDENCE = 10.0
"""In twice the logarithm of the likelihood: what poses have to say for terms beyond the chain."""
STRONG_GAIN = 0.95
"""Held-out error of a level by that of the chain alone: what few configurations have to gain."""
_RANDOM = "random"


@dataclass(frozen=True, slots=True)
class ErrorModel:
    """An arm with the terms of a level.

    Parameters
    ----------
    fit, level
        All levels, and the one that is taken.
    growth
        Of stated deviations of predictions: positions, rotations.
    held_out, chain_alone
        Rms errors of the level, and of the chain alone, at folds dealt at random and at blocks of joint space.
    """

    fit: ErrorFit
    level: Level
    growth: Float[np.ndarray, " k"]
    held_out: Mapping[str, HoldOutError]
    chain_alone: Mapping[str, HoldOutError]

    @property
    def fitted(self) -> Fitted:
        return self.fit.levels[self.level]

    @property
    def scatter(self) -> Variances:
        """What poses scatter by about the model from visit to visit, beyond their stated covariances."""
        return self.fit.visit_scatter_of(self.level)

    @property
    def held_out_ratio(self) -> float | None:
        """The level's error at folds dealt at random, by that of the chain alone."""
        return self._ratio(_RANDOM)

    @property
    def blocked_ratio(self) -> float | None:
        """The same at clusters of joint space."""
        return self._ratio(Blocking.CLUSTERS)

    def _ratio(self, folds: str) -> float | None:
        if folds not in self.held_out:
            return None
        return self.held_out[folds].position_rms_mm / self.chain_alone[folds].position_rms_mm

    @property
    def knows_approach(self) -> bool:
        """Whether the side that joints came from is known, so that this is a term."""
        return bool(self.fit.design.terms.of(Kind.APPROACH).any())

    def chain_posterior(self) -> tuple[Float[np.ndarray, " f"], Float[np.ndarray, "f f"]]:
        """Return the step of the free columns from the arm of the design, and its covariance.

        The terms that the level lacks count in the covariance, unless the likelihood speaks for their absence.
        """
        fit, problem = self.fit, self.fit.design
        everything, own = fit.levels[Level.ALL], self.fitted
        chain = int(problem.free.sum())
        if self.level is not Level.ALL and everything.minus_2_log < own.minus_2_log:
            at_level = self.level.problem(problem, fit.sums)
            own = solve(at_level, everything.hyperparameters, everything.noise)
            lacking = chain + np.flatnonzero(~at_level.chosen)
            v = everything.hyperparameters.variances(problem.terms)[0][~at_level.chosen]
            products = np.tensordot(1.0 / everything.noise, fit.sums.normal[:, :, lacking], axes=1)
            moved = own.covariance[:chain] @ products
            covariance = own.covariance[:chain, :chain] + (moved * v) @ moved.T
            return own.coefficients[:chain], covariance
        return own.coefficients[:chain], own.covariance[:chain, :chain]

    def residuals(self) -> Float[np.ndarray, "m v"]:
        """Return observed - predicted of all poses that the model was fitted to, by the level's own fit."""
        return of_poses(self.fit.design, self.fit.design.left(self.fitted.coefficients))


def of_poses(problem: Design, residuals: Float[np.ndarray, "m n"]) -> Float[np.ndarray, "m v"]:
    """Return the residuals of the poses themselves where those of their configurations are these."""
    return np.asarray(problem.of_poses - (problem.residuals - residuals)[:, problem.visit])


def choose_model(
    problem: Design,
    scatter: Variances,
    folds: Int[np.ndarray, " v"] | None,
    blocks: Mapping[Blocking, Int[np.ndarray, " v"]],
    *,
    always: bool = False,
) -> ErrorModel:
    """Fit all levels and take one.

    Parameters
    ----------
    scatter
        That of a fit of the chain alone, where the estimation begins.
    folds, blocks
        Of the poses: dealt at random (None where they are too few), and blocks of joint space by what they share.
    always
        Take all terms, whatever the evidence.

    Raises LinAlgError where the poses leave the columns dependent.
    """
    fit = fit_levels(problem, scatter)
    gravity = likely_gravity(fit)
    if gravity is not ALONG_Z:
        problem = replace(problem, gravity=gravity)
        fit = fit_levels(problem, scatter)
    first = np.unique(problem.visit, return_index=True)[1]
    counted = fit.used[problem.visit]

    def errors(residuals: Float[np.ndarray, "m n"]) -> HoldOutError:
        return rms(of_poses(problem, residuals)[:, counted])

    found: dict[Level, HoldOutError] = {}
    if folds is not None:
        left = hold_out(fit, folds[first], list(Level)).residuals
        found = {level: errors(residuals) for level, residuals in left.items()}
    level = Level.ALL if always else chosen_level(fit, found)
    held_out, chain_alone = {}, {}
    if found:
        held_out[_RANDOM], chain_alone[_RANDOM] = found[level], found[Level.DH]
    factor = np.ones(problem.kinds)
    if folds is not None and Blocking.CLUSTERS not in blocks:
        factor = growth(fit, folds[first], level)
    for blocking, block in blocks.items():
        of_clusters = blocking is Blocking.CLUSTERS
        apart = hold_out(fit, block[first], list({level, Level.DH}), growth_of=level if of_clusters else None)
        held_out[blocking] = errors(apart.residuals[level])
        chain_alone[blocking] = errors(apart.residuals[Level.DH])
        if apart.growth is not None:
            factor = apart.growth
    return ErrorModel(fit, level, factor, held_out, chain_alone)


def chosen_level(fit: ErrorFit, held_out: Mapping[Level, HoldOutError]) -> Level:
    """Return the level by marginal likelihood and held-out errors; the chain alone where none could be held out."""
    if not held_out:
        return Level.DH
    chain, few = fit.levels[Level.DH].minus_2_log, int(fit.used.sum()) < FEW_POSES
    most_error = STRONG_GAIN if few else 1.0
    for level in sorted(fit.levels, key=lambda one: fit.levels[one].minus_2_log):
        ratio = held_out[level].position_rms_mm / held_out[Level.DH].position_rms_mm
        if level is Level.DH or (
            chain - fit.levels[level].minus_2_log > STRONG_EVIDENCE and ratio <= most_error
        ):
            return level
    return Level.DH
