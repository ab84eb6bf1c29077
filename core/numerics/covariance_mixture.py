"""Non-negative components of a covariance, from sample covariances of several groups.

    E S_i = V_i(θ) = Σ_k θ_k M_ik,      θ_k ≥ 0,      ν_i S_i ~ Wishart(V_i, ν_i)

Restricted maximum likelihood: S_i are of contrasts, from which what was fitted is already projected out. The score
vanishes where Σ ν_i tr(V⁻¹ S V⁻¹ M_k) = Σ ν_i tr(V⁻¹ M_k) for every θ_k > 0. The multiplicative step

    θ_k ← θ_k √( Σ ν_i tr(V_i⁻¹ S_i V_i⁻¹ M_ik) / Σ ν_i tr(V_i⁻¹ M_ik) )

never leaves θ ≥ 0 and never lessens the likelihood: it is the minimum of a majorant of -2 log L that is separable in
the components. It is short, too: with forty components hundreds of steps lead to the maximum. So the root is replaced
by powers of the ratio, in turns; where one lessens the likelihood, the step above is taken in its place.

References: D. A. Harville, J. American Statistical Association 72 (1977) 320-338, 10.1080/01621459.1977.10480998;
H. Zhou, L. Hu, J. Zhou, K. Lange, J. Computational and Graphical Statistics 28 (2019) 350-361,
10.1080/10618600.2018.1529601 (the multiplicative step); R. Salakhutdinov, S. Roweis, International Conference on
Machine Learning (2003) 664-671 (longer steps where the likelihood allows them).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg.blas import dsymm
from scipy.linalg.lapack import dpotrf, dpotri

SAFE_POWER = 0.5
POWERS = (1.0, 2.0, 4.0)
"""Of the ratio, in turns. Forty such steps come nearer to the maximum than a hundred safe ones."""
MAX_TURNS = 13
SETTLED = 0.01
"""Gain in log L by a turn of the powers below which the steps end: sizes as likely as that are the same."""


@dataclass(frozen=True, slots=True)
class SampleCovariance:
    """S of d contrasts with `freedom` degrees of freedom, and what each component of unit size contributes to it."""

    sample: Float[np.ndarray, "d d"]
    freedom: float
    components: Float[np.ndarray, "k d d"]

    def covariance(self, sizes: Float[np.ndarray, " k"]) -> Float[np.ndarray, "d d"]:
        """Return V = Σ θ_k M_k."""
        return np.asarray(np.tensordot(sizes, self.components, axes=1))


def estimate_components(groups: Sequence[SampleCovariance]) -> Float[np.ndarray, " k"]:
    """Return θ ≥ 0, the size of each component, in the unit of S over that of M.

    The first component must make every V_i positive definite (white noise does). A component that is nothing ends at a
    small value, not at zero: the steps approach the bound and stop when the likelihood has settled.

    Raises ValueError for no groups and for groups without variance.
    """
    if not groups:
        raise ValueError("A covariance mixture needs at least one group.")
    freedom = np.array([group.freedom for group in groups])
    # tr S is the sum over components of θ_k tr M_k: each starts with an equal share of it.
    share = float(np.sum(freedom * [np.trace(group.sample) for group in groups])) / len(groups[0].components)
    traces = np.stack([np.trace(group.components, axis1=1, axis2=2) for group in groups])
    if share <= 0.0:
        raise ValueError("A covariance mixture needs samples that scatter.")
    packed = [_Packed.of(group) for group in groups]
    at = _Point.of(packed, share / np.maximum(freedom @ traces, 1e-300))
    for _ in range(MAX_TURNS):
        former = at.likelihood
        for power in POWERS:
            at = _further(packed, at, power)
        if at.likelihood - former < SETTLED:
            break
    return at.sizes


@dataclass(frozen=True, slots=True)
class _Packed:
    """A group with the lower triangles of its symmetric components: they say all, and are read twice a step instead of
    the whole matrices four times. `place` is where their elements are in a matrix stored by columns, `counts` how
    often each is in it.
    """

    size: int
    place: Int[np.ndarray, " u"]
    counts: Float[np.ndarray, " u"]
    components: Float[np.ndarray, "k u"]
    sample: Float[np.ndarray, "d d"]
    freedom: float

    @classmethod
    def of(cls, group: SampleCovariance) -> _Packed:
        size = len(group.sample)
        rows, columns = np.tril_indices(size)
        counts = np.where(rows == columns, 1.0, 2.0)
        components = group.components[:, rows, columns]
        return cls(
            size, columns * size + rows, counts, components, np.asfortranarray(group.sample), group.freedom
        )

    def evaluated(self, lower: Float[np.ndarray, " u"]) -> tuple[float, Float[np.ndarray, "2 k"]]:
        """Return log L but for a constant, and ν tr(V⁻¹ S V⁻¹ M_k) and ν tr(V⁻¹ M_k), of V's lower triangle."""
        V = np.zeros(self.size**2)
        V[self.place] = lower
        inverse, logarithm = _inverse(V.reshape(self.size, self.size).T)
        product = dsymm(1.0, inverse, self.sample, lower=1)
        both = np.empty((2, len(lower)))
        both[0] = dsymm(1.0, inverse, product, side=1, lower=1).T.ravel()[self.place]
        both[1] = inverse.T.ravel()[self.place]
        both *= self.counts
        likelihood = -0.5 * self.freedom * (logarithm + float(np.trace(product)))
        return likelihood, self.freedom * (both @ self.components.T)


@dataclass(frozen=True, slots=True)
class _Point:
    """Where a step begins: sizes, log L, and found over expected of each component."""

    sizes: Float[np.ndarray, " k"]
    likelihood: float
    ratio: Float[np.ndarray, " k"]

    @classmethod
    def of(cls, packed: Sequence[_Packed], sizes: Float[np.ndarray, " k"]) -> _Point:
        likelihoods, sums = zip(*(one.evaluated(sizes @ one.components) for one in packed), strict=True)
        found, expected = np.sum(sums, axis=0)
        ratio = np.maximum(found, 0.0) / np.maximum(expected, 1e-300)
        return cls(sizes, math.fsum(likelihoods), ratio)


def _further(packed: Sequence[_Packed], at: _Point, power: float) -> _Point:
    """Return the point of a step with a power of the ratio, or of the safe one where that lessens the likelihood."""
    with np.errstate(over="ignore", invalid="ignore"):
        sizes = at.sizes * at.ratio**power
    if np.isfinite(sizes).all() and sizes[0] > 0.0:
        new = _Point.of(packed, sizes)
        if new.likelihood >= at.likelihood:
            return new
    return _Point.of(packed, at.sizes * at.ratio**SAFE_POWER)


def _inverse(V: Float[np.ndarray, "d d"]) -> tuple[Float[np.ndarray, "d d"], float]:
    """Return V⁻¹ and log |V| of V's lower triangle: by Cholesky's factor, which has the inverse's lower triangle alone,
    in less than half of the time of a general inverse; that serves where rounding leaves V not positive definite.
    """
    factor, failed = dpotrf(V, lower=1, clean=0)
    if not failed:
        logarithm = 2.0 * float(np.sum(np.log(np.diagonal(factor))))
        inverse, failed = dpotri(factor, lower=1, overwrite_c=1)
        if not failed:
            return inverse, logarithm
    whole = np.tril(V) + np.tril(V, -1).T
    return np.asfortranarray(np.linalg.inv(whole)), float(np.linalg.slogdet(whole)[1])


def log_likelihood(groups: Sequence[SampleCovariance], sizes: Float[np.ndarray, " k"]) -> float:
    """Return the logarithm of the samples' likelihood, but for what does not depend on the sizes."""
    total = 0.0
    for group in groups:
        V = group.covariance(sizes)
        explained = float(np.trace(np.linalg.solve(V, group.sample)))
        total -= 0.5 * group.freedom * (float(np.linalg.slogdet(V)[1]) + explained)
    return total


def first_component_alone(groups: Sequence[SampleCovariance]) -> Float[np.ndarray, " k"]:
    """Return the sizes of greatest likelihood where all components but the first are nothing."""
    squares = sum(g.freedom * float(np.trace(np.linalg.solve(g.components[0], g.sample))) for g in groups)
    sizes = np.zeros(len(groups[0].components))
    sizes[0] = squares / sum(g.freedom * len(g.sample) for g in groups)
    return sizes
