"""Predictions of configurations that a fit had no part of, at known hyperparameters, with their uncertainty.

Without a fold the sums are the sums of all less those of the fold, so that each fold costs one solution. A prediction's
covariance is x C xᵀ + noise: of the coefficients, and of one more measurement.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from core.kinematics.error_model.evidence import Fitted, LevelProblem, Sums, coefficients, solve
from core.kinematics.error_model.fit import ErrorFit, Level
from core.kinematics.error_model.linear_problem import Rows
from core.kinematics.error_model.priors import Hyperparameters

_MOST_KEPT = 1000
"""Configurations whose rows are kept in memory while a fold is held out: some 40 MB."""


@dataclass(frozen=True, slots=True)
class HeldOut:
    """Every configuration predicted by those of other folds.

    Parameters
    ----------
    residuals
        Observed - predicted, at each level that was asked for.
    growth
        The rms of residual over stated deviation, of positions and of rotations, at the level that was asked for: what
        deviations have to be multiplied by, so that they hold where nothing was measured. Never less than one.
    """

    residuals: dict[Level, Float[np.ndarray, "m n"]]
    growth: Float[np.ndarray, " k"] | None


def hold_out(
    fit: ErrorFit, fold: Int[np.ndarray, " n"], levels: Sequence[Level], *, growth_of: Level | None = None
) -> HeldOut:
    """Predict every configuration by those of other folds, at each level, with the growth of one of them.

    `fold` is that of every configuration; those that do not count are predicted by their fold's others all the same.
    """
    problem = fit.design
    asked = list(dict.fromkeys([*levels, *([] if growth_of is None else [growth_of])]))
    residuals = {level: problem.residuals.copy() for level in asked}
    squares = np.zeros_like(problem.residuals)
    for out, rest, blocks in _folds(fit, fold):
        found = {level: coefficients(*_known(fit, rest, level)) for level in asked if level is not growth_of}
        grown = None if growth_of is None else solve(*_known(fit, rest, growth_of))
        for some, rows in problem.with_rows(out) if blocks is None else blocks:
            for level in asked:
                b = found[level] if grown is None or level is not growth_of else grown.coefficients
                residuals[level][:, some] -= np.einsum("pmn,p->mn", rows, b)
            if growth_of is not None and grown is not None:
                stated = variances(rows, grown) + _noise(fit, growth_of, some)
                squares[:, some] = residuals[growth_of][:, some] ** 2 / stated
    if growth_of is None:
        return HeldOut(residuals, None)
    z = squares[:, fit.used].reshape(problem.kinds, -1)
    return HeldOut(residuals, np.maximum(np.sqrt(z.mean(axis=1)), 1.0))


def growth(fit: ErrorFit, fold: Int[np.ndarray, " n"], level: Level) -> Float[np.ndarray, " k"]:
    """Return `HeldOut.growth` alone."""
    found = hold_out(fit, fold, [level], growth_of=level).growth
    assert found is not None
    return found


def variances(rows: Float[np.ndarray, "p m n"], fitted: Fitted) -> Float[np.ndarray, "m n"]:
    """Return the variances of predictions by their coefficients' uncertainty."""
    p, m, n = rows.shape
    flat = rows.reshape(p, m * n)
    return np.asarray(np.sum(flat * (fitted.covariance @ flat), axis=0).reshape(m, n))


def _folds(
    fit: ErrorFit, fold: Int[np.ndarray, " n"]
) -> Iterator[tuple[Int[np.ndarray, " q"], Sums, list[Rows] | None]]:
    """Yield each fold's configurations, the sums over those of all others that count, and the fold's rows, of a fold
    that is not too large.
    """
    for one in np.unique(fold):
        out = np.flatnonzero(fold == one)
        counted = out[fit.used[out]]
        if len(out) > _MOST_KEPT:
            yield out, fit.sums - fit.design.sums(counted, fit.scatter), None
            continue
        blocks = list(fit.design.with_rows(out))
        yield out, fit.sums - fit.design.sums(counted, fit.scatter, _counted(fit, blocks)), blocks


def _counted(fit: ErrorFit, blocks: Sequence[Rows]) -> Iterator[Rows]:
    for some, rows in blocks:
        used = fit.used[some]
        yield (some, rows) if used.all() else (some[used], np.ascontiguousarray(rows[..., used]))


def _known(
    fit: ErrorFit, sums: Sums, level: Level
) -> tuple[LevelProblem, Hyperparameters, Float[np.ndarray, " k"]]:
    """Return what a level's coefficients are solved from, where some configurations are held out."""
    whole = fit.levels[level]
    return level.problem(fit.design, sums), whole.hyperparameters, whole.noise


def _noise(fit: ErrorFit, level: Level, members: Int[np.ndarray, " q"]) -> Float[np.ndarray, "m q"]:
    """Return the variances of one more measurement about the model."""
    scatter = fit.scatter_of(level).diagonal(fit.design.seen.components)
    return np.asarray(np.diagonal(fit.design.seen.own[members], axis1=1, axis2=2).T + scatter[:, None])
