"""Predictions of configurations that a fit had no part of, at known hyperparameters, with their uncertainty.

Without a fold the sums are the sums of all less those of the fold, so that each fold costs one solution. A prediction's
covariance is x C xᵀ + noise: of the coefficients, and of one more measurement.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float, Int

from core.kinematics.error_model.evidence import Fitted, Sums, coefficients, solve
from core.kinematics.error_model.fit import ErrorFit, Level


def held_out_residuals(
    fit: ErrorFit, fold: Int[np.ndarray, " n"], levels: Sequence[Level]
) -> dict[Level, Float[np.ndarray, "m n"]]:
    """Return observed - predicted of every configuration by those of other folds, at each level.

    `fold` is that of every configuration; those that do not count are predicted by their fold's others all the same.
    """
    problem = fit.design
    residuals = {level: problem.residuals.copy() for level in levels}
    for out, rest in _folds(fit, fold):
        found = {
            level: coefficients(
                rest,
                problem.prior,
                problem.terms,
                level.chosen(problem.terms),
                fit.levels[level].hyperparameters,
                fit.levels[level].noise,
            )
            for level in levels
        }
        for some in problem.blocks(out):
            rows = problem.rows(some)
            for level, b in found.items():
                residuals[level][:, some] -= np.einsum("pmn,p->mn", rows, b)
    return residuals


def growth(fit: ErrorFit, fold: Int[np.ndarray, " n"], level: Level) -> Float[np.ndarray, " k"]:
    """Return the rms of residual over stated deviation at held-out folds.

    Of positions and of rotations: what deviations have to be multiplied by, so that they hold where nothing was
    measured. Never less than one.
    """
    problem = fit.design
    whole = fit.levels[level]
    squares = np.zeros_like(problem.residuals)
    for out, rest in _folds(fit, fold):
        found = solve(
            rest,
            problem.prior,
            problem.terms,
            level.chosen(problem.terms),
            whole.hyperparameters,
            whole.noise,
        )
        for some in problem.blocks(out):
            rows = problem.rows(some)
            left = problem.residuals[:, some] - np.einsum("pmn,p->mn", rows, found.coefficients)
            squares[:, some] = left**2 / (variances(rows, found) + _noise(fit, level, some))
    z = squares[:, fit.used].reshape(problem.kinds, -1)
    return np.asarray(np.maximum(np.sqrt(z.mean(axis=1)), 1.0))


def variances(rows: Float[np.ndarray, "p m n"], fitted: Fitted) -> Float[np.ndarray, "m n"]:
    """Return the variances of predictions by their coefficients' uncertainty."""
    p, m, n = rows.shape
    flat = rows.reshape(p, m * n)
    return np.asarray(np.sum(flat * (fitted.covariance @ flat), axis=0).reshape(m, n))


def _folds(fit: ErrorFit, fold: Int[np.ndarray, " n"]) -> Iterator[tuple[Int[np.ndarray, " q"], Sums]]:
    """Yield each fold's configurations, and the sums over those of all others that count."""
    for one in np.unique(fold):
        out = np.flatnonzero(fold == one)
        yield out, fit.sums - fit.design.sums(out[fit.used[out]], fit.scatter)


def _noise(fit: ErrorFit, level: Level, members: Int[np.ndarray, " q"]) -> Float[np.ndarray, "m q"]:
    """Return the variances of one more measurement about the model."""
    scatter = fit.scatter_of(level).diagonal(fit.design.seen.components)
    return np.asarray(np.diagonal(fit.design.seen.own[members], axis1=1, axis2=2).T + scatter[:, None])
