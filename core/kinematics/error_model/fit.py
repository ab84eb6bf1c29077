"""The fit of the error model: hyperparameters and noise by restricted likelihood, outliers rejected, three levels.

The poses' own scatter begins at what the fit without the terms left. Where poses state covariances of their own, rows
are whitened anew with the scatter that was found until it stays; where they state none, its size is exact at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from jaxtyping import Bool, Float, Int

from core.kinematics.error_model.evidence import Fitted, LevelProblem, Sums, maximise
from core.kinematics.error_model.linear_problem import Design
from core.kinematics.error_model.priors import LEAST_POSES, Hyperparameters, spreads
from core.kinematics.error_model.terms import Kind, Terms
from core.kinematics.global_fit import whitened, whitener
from core.numerics import MEDIAN_LENGTH, SMALLEST, Variances

REJECTION = 5.0
"""Median absolute deviations, as standard deviations of a coordinate, beyond which a configuration is an outlier."""
_MAX_ROUNDS = 4
_SETTLED = 0.05


class Level(StrEnum):
    """Which terms a model has beyond the chain."""

    DH = "dh"
    COMPLIANCE = "dh_compliance"
    ALL = "all"

    def chosen(self, terms: Terms) -> Bool[np.ndarray, " c"]:
        """Mark the columns of this level."""
        if self is Level.ALL:
            return np.ones(len(terms), dtype=np.bool_)
        if self is Level.COMPLIANCE:
            return terms.of(Kind.COMPLIANCE, Kind.LINK_COMPLIANCE, Kind.RADIAL)
        return np.zeros(len(terms), dtype=np.bool_)

    def problem(self, design: Design, sums: Sums) -> LevelProblem:
        """Return what the level is fitted to, given the sums over the configurations that count."""
        return LevelProblem(sums, design.prior, design.terms, self.chosen(design.terms))


@dataclass(frozen=True, slots=True)
class ErrorFit:
    """All levels fitted to the same configurations.

    `scatter` is that of the level with all terms and what `sums` are whitened by; `used` marks the configurations that
    count.
    """

    design: Design
    used: Bool[np.ndarray, " n"]
    scatter: Variances
    sums: Sums
    levels: dict[Level, Fitted]

    @property
    def members(self) -> Int[np.ndarray, " q"]:
        """The configurations that count."""
        return np.flatnonzero(self.used)

    def scatter_of(self, level: Level) -> Variances:
        """Return the scatter of configurations, the means of their visits, at a level, beyond stated covariances."""
        return _grown(self.design, self.scatter, self.levels[level].noise)

    def visit_scatter_of(self, level: Level) -> Variances:
        """Return the scatter of one visit: that of configurations, and what the mean of several visits has less."""
        of_means, more = self.scatter_of(level), self._lost_in_means()
        rotation = more[1] if self.design.kinds == 2 else 0.0
        return Variances(of_means.position + more[0], of_means.rotation + rotation)

    def _lost_in_means(self) -> list[float]:
        """Return by how much a coordinate of one visit varies more than that of a mean of as many visits as there were,
        beyond stated covariances; zero where no configuration was visited twice.
        """
        problem, visit = self.design, self.design.visit
        visits = np.bincount(visit, minlength=len(problem))
        counted = self.used[visit]
        degrees = int(counted.sum()) - int(self.used.sum())
        if degrees < 1:
            return [0.0] * problem.kinds
        apart = (problem.of_poses - problem.residuals[:, visit])[:, counted]
        own = np.diagonal(problem.seen.own, axis1=1, axis2=2).T * visits  # `seen` has that of their mean
        expected = (own * (visits - 1))[:, self.used].sum(axis=1)
        spread = (np.sum(apart**2, axis=1) - expected).reshape(problem.kinds, 3).sum(axis=1) / (3.0 * degrees)
        return [float(v) for v in np.maximum(spread, 0.0) * float(np.mean(1.0 - 1.0 / visits[self.used]))]


def fit_levels(problem: Design, scatter: Variances) -> ErrorFit:
    """Fit chain, tool, bases and terms at each level; `scatter` is that of a fit of the chain alone.

    Raises LinAlgError where columns are not independent.
    """
    used = _inliers(problem, problem.residuals, scatter, np.ones(problem.kinds))
    sums = problem.sums(np.flatnonzero(used), scatter)
    spread = spreads(int(used.sum())) if used.sum() >= LEAST_POSES else np.zeros(7)
    begin = (Hyperparameters.defaults(), np.ones(problem.kinds))
    for _ in range(_MAX_ROUNDS):
        least = _least(problem, scatter)
        found = maximise(Level.ALL.problem(problem, sums), begin, spread, least)
        begin = (found.hyperparameters, found.noise)
        again = _inliers(problem, problem.left(found.coefficients), scatter, found.noise)
        grown = _grown(problem, scatter, found.noise)
        if problem.seen.own.any() and not grown.near(scatter, _SETTLED):
            used, scatter = again, grown
            sums = problem.sums(np.flatnonzero(used), scatter)
            begin = (found.hyperparameters, np.ones(problem.kinds))
        elif not np.array_equal(again, used):
            sums = _changed(problem, sums, used, again, scatter)
            used = again
        else:
            break
    levels = {Level.ALL: found}
    for level in (Level.COMPLIANCE, Level.DH):
        levels[level] = maximise(level.problem(problem, sums), begin, spread, _least(problem, scatter))
    return ErrorFit(problem, used, scatter, sums, levels)


def _inliers(
    problem: Design, residuals: Float[np.ndarray, "m n"], scatter: Variances, noise: Float[np.ndarray, " k"]
) -> Bool[np.ndarray, " n"]:
    """Mark the configurations whose residuals, whitened, are within `REJECTION` of their median size."""
    unit = whitened(whitener(problem.seen, scatter), residuals)
    passes = np.ones(len(problem), dtype=np.bool_)
    for kind in range(problem.kinds):
        lengths = np.linalg.norm(unit[3 * kind : 3 * kind + 3], axis=0)
        usual = max(float(np.median(lengths)) / MEDIAN_LENGTH[3], float(np.sqrt(noise[kind])))
        passes &= lengths <= REJECTION * usual
    return passes


def _least(problem: Design, scatter: Variances) -> Float[np.ndarray, " k"]:
    """Return the least factors on the noise: stated covariances hold, and no robot is steadier than `SMALLEST`."""
    total, own = _sizes(problem, scatter)
    floor = np.array([SMALLEST.position, SMALLEST.rotation])[: problem.kinds]
    return np.minimum((own + floor) / total, 1.0)


def _grown(problem: Design, scatter: Variances, noise: Float[np.ndarray, " k"]) -> Variances:
    total, own = _sizes(problem, scatter)
    floor = np.array([SMALLEST.position, SMALLEST.rotation])[: problem.kinds]
    values = np.maximum(noise * total - own, floor).tolist()
    return Variances(values[0], values[1] if problem.kinds == 2 else scatter.rotation)


def _sizes(problem: Design, scatter: Variances) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Return the median variance of a coordinate, whole and stated, of positions and of rotations."""
    own = np.median(np.diagonal(problem.seen.own, axis1=1, axis2=2).reshape(len(problem), -1, 3).mean(2), 0)
    return own + np.array([scatter.position, scatter.rotation])[: problem.kinds], own


def _changed(
    problem: Design,
    sums: Sums,
    before: Bool[np.ndarray, " n"],
    after: Bool[np.ndarray, " n"],
    scatter: Variances,
) -> Sums:
    """Return the sums with configurations added and removed."""
    added = problem.sums(np.flatnonzero(after & ~before), scatter)
    removed = problem.sums(np.flatnonzero(before & ~after), scatter)
    return sums - (removed - added)
