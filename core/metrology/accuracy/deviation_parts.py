"""What leaves a deviation of one pose open, and the limits of its length.

A length that is read with noise is too long: where the deviation is as small as its noise ν, the lengths of r - ν hold
it almost never. So the interval holds the lengths of which |r| is neither among the lowest nor among the highest
readings: |l d + ν| = |r| is solved for l draw by draw, d the direction of r, and 0 is the length where noise alone is
as long. The variance of the deviations is drawn too: where most of the residuals' variance is noise, it may be 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int
from scipy.special import gammaincinv

from core.metrology.rp_distribution import CONFIDENCE

_DRAWS = 10_000
_SEED = 9283
_MEDIAN_OF_CHI2 = 2.366
"""Of three degrees of freedom."""


_STEPS = np.concatenate([[0.0], np.geomspace(1e-4, 1e4, 161)])


@dataclass(frozen=True, slots=True)
class DeviationSpread:
    """What is known of s², the variance of the deviations of all poses along an axis.

    `squares` are |r_i|² of the poses that tied the frames, `noise` what visits add to each along an axis.
    Σ |r_i|² / (s² + noise_i) is of χ² with `degrees_of_freedom`, which gives s² (Mandel and Paule) and its distribution
    (Viechtbauer).

    References: R. C. Paule, J. Mandel, J. Res. NBS 87 (1982), doi:10.6028/jres.087.022; W. Viechtbauer, Stat. Med. 26
    (2007), doi:10.1002/sim.2514.
    """

    squares: Float[np.ndarray, " m"]
    noise: Float[np.ndarray, " m"]
    degrees_of_freedom: float

    def variances(self, chi2: Float[np.ndarray, " t"]) -> Float[np.ndarray, " t"]:
        """Return the s² for which the sum is as stated; 0 where noise alone makes the residuals as large."""
        whole = float(np.sum(self.squares))
        if whole <= 0.0:
            return np.zeros(len(chi2))
        most = whole / np.maximum(chi2, 1e-300)  # without noise
        if not np.any(self.noise > 0.0):
            return np.asarray(most)
        steps = _STEPS * whole / self.degrees_of_freedom
        with np.errstate(divide="ignore"):
            sums = np.sum(self.squares / (steps[:, None] + self.noise), axis=1)
        found = np.interp(chi2, sums[::-1], steps[::-1])
        return np.where(chi2 < sums[-1], most, found)


@dataclass(frozen=True, slots=True)
class DeviationParts:
    """What leaves the deviation of one pose open, mm or rad: `residual` is the centre of what is known of it.

    The tie leaves open the `share` of the deviations' variance, `of_visits` is the covariance of the visits' means, of
    `visits_degrees_of_freedom`, None where their scatter is stated, and the columns of `shared` are what one standard
    uncertainty of each error does that all poses share. Of a pose that `tied` the frames, the tie follows a part of
    the deviation; of others, the tie is an error of the residual.
    """

    residual: Float[np.ndarray, "3"]
    share: Float[np.ndarray, "3 3"]
    of_visits: Float[np.ndarray, "3 3"]
    shared: Float[np.ndarray, "3 k"]
    visits_degrees_of_freedom: float | None
    spread: DeviationSpread
    tied: bool = True

    @property
    def variance(self) -> float:
        """That of the deviations of all poses, along an axis."""
        return float(self.spread.variances(np.array([self.spread.degrees_of_freedom]))[0])

    @property
    def degrees_of_freedom(self) -> float:
        """Those of the tie."""
        return self.spread.degrees_of_freedom

    @property
    def of_tie(self) -> Float[np.ndarray, "3 3"]:
        """The covariance of what the tie leaves open."""
        return self.variance * self.share

    @property
    def own(self) -> Float[np.ndarray, "3 3"]:
        """The covariance of tie and visits."""
        return self.of_tie + self.of_visits

    @property
    def own_degrees_of_freedom(self) -> float:
        """Those of `own`, by the formula of Welch and Satterthwaite on its trace."""
        tie, visits = float(np.trace(self.of_tie)), float(np.trace(self.of_visits))
        squares = tie**2 / self.degrees_of_freedom + visits**2 / (self.visits_degrees_of_freedom or math.inf)
        return (tie + visits) ** 2 / squares if squares > 0.0 else self.degrees_of_freedom

    @property
    def visits_share(self) -> float:
        """The share of the variance that more visits narrow, between 0 and 1."""
        visits = float(np.trace(self.of_visits))
        whole = visits + float(np.trace(self.of_tie)) + float(np.sum(self.shared**2))
        return visits / whole if whole > 0.0 else 1.0

    def draws_without_visits(self, trials: int) -> Float[np.ndarray, "t 3"]:
        """Return draws of the deviation with the mean of the visits as it is, with random numbers of their own."""
        random = _draws(trials)
        return np.asarray((self.residual[:, None] + random.of_tie(self) + random.of_shared(self)).T)

    def lengths(self, trials: int) -> Float[np.ndarray, " t"]:
        """Return draws of the deviation's length, whose quantiles are its limits (module's text)."""
        random = _draws(trials)
        tie, noise = random.of_tie(self), random.of_visits(self) + random.of_shared(self)
        if not self.tied:
            return _lengths_before_noise(self.residual, noise + tie)
        before = self.residual[:, None] - noise
        directions = before / np.maximum(_norms(before), 1e-300)
        return _norms(_lengths_before_noise(self.residual, noise) * directions + tie)


def length_limits(parts: DeviationParts) -> tuple[float, float]:
    """Return the interval of a deviation's length.

    A residual shorter than its noise usually is says no more of the upper limit than one as long as that.
    """
    lengths = parts.lengths(_DRAWS)
    low, high = np.quantile(lengths, [0.5 - 0.5 * CONFIDENCE, 0.5 + 0.5 * CONFIDENCE])
    noise = parts.of_visits + parts.shared @ parts.shared.T + (0.0 if parts.tied else 1.0) * parts.of_tie
    usual = math.sqrt(_MEDIAN_OF_CHI2 * float(np.trace(noise)) / 3.0)
    length = float(np.linalg.norm(parts.residual))
    if 0.0 < length < usual:
        longer = replace(parts, residual=parts.residual * (usual / length))
        high = max(high, float(np.quantile(longer.lengths(_DRAWS), 0.5 + 0.5 * CONFIDENCE)))
    return float(low), float(high)


def _lengths_before_noise(
    residual: Float[np.ndarray, "3"], noise: Float[np.ndarray, "3 t"]
) -> Float[np.ndarray, " t"]:
    """Return the lengths that each draw of the noise makes as long as the residual."""
    length = float(np.linalg.norm(residual))
    d = residual / length if length > 0.0 else np.array([1.0, 0.0, 0.0])
    along = d @ noise
    across = np.maximum(_squares(noise) - along**2, 0.0)
    left = length**2 - across
    return np.where(left > 0.0, np.maximum(np.sqrt(np.maximum(left, 0.0)) - along, 0.0), 0.0)


def _squares(vectors: Float[np.ndarray, "3 t"]) -> Float[np.ndarray, " t"]:
    return np.asarray(np.einsum("it,it->t", vectors, vectors))


def _norms(vectors: Float[np.ndarray, "3 t"]) -> Float[np.ndarray, " t"]:
    return np.sqrt(_squares(vectors))


@dataclass(frozen=True, slots=True)
class _Draws:
    """Random numbers, the same wherever as many are asked for; `order` sorts the first row of ranks.

    Vectors are columns: numpy works on long rows many times as fast as on rows of three.
    """

    normal: Float[np.ndarray, "3 3 t"]
    ranks: Float[np.ndarray, "2 t"]
    order: Int[np.ndarray, " t"]

    def of_tie(self, parts: DeviationParts) -> Float[np.ndarray, "3 t"]:
        freedom = parts.degrees_of_freedom
        chi2 = freedom / _stretch(self.ranks.shape[1], 0, freedom) ** 2
        variances = np.empty_like(chi2)
        variances[self.order] = parts.spread.variances(chi2[self.order])  # interpolates sorted values at once
        return np.asarray(_root(parts.share) @ (self.normal[0] * np.sqrt(variances)))

    def of_visits(self, parts: DeviationParts) -> Float[np.ndarray, "3 t"]:
        normal, freedom = self.normal[1], parts.visits_degrees_of_freedom
        if freedom is not None:
            normal = normal * _stretch(self.ranks.shape[1], 1, freedom)
        return np.asarray(_root(parts.of_visits) @ normal)

    def of_shared(self, parts: DeviationParts) -> Float[np.ndarray, "3 t"] | float:
        if not np.any(parts.shared):
            return 0.0
        return np.asarray(_root(parts.shared @ parts.shared.T) @ self.normal[2])


@lru_cache(maxsize=2)
def _draws(trials: int) -> _Draws:
    rng = np.random.default_rng([_SEED, trials])
    normal = np.ascontiguousarray(rng.standard_normal((3, trials, 3)).swapaxes(1, 2))
    ranks = rng.uniform(size=(2, trials))
    return _Draws(normal, ranks, np.argsort(ranks[0]))


@lru_cache(maxsize=16)  # the poses of a session share them, and they take longer than all else
def _stretch(trials: int, k: int, degrees_of_freedom: float) -> Float[np.ndarray, " t"]:
    """Return by what each normal draw is longer as one of t."""
    chi2 = 2.0 * gammaincinv(0.5 * degrees_of_freedom, _draws(trials).ranks[k])
    return np.asarray(np.sqrt(degrees_of_freedom / np.maximum(chi2, 1e-300)))


def _root(covariance: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
