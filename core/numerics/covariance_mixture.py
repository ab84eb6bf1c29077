"""Non-negative components of a covariance, from sample covariances of several groups.

    E S_i = V_i(θ) = Σ_k θ_k M_ik,      θ_k ≥ 0,      ν_i S_i ~ Wishart(V_i, ν_i)

Restricted maximum likelihood: S_i are of contrasts, from which what was fitted is already projected out. The score
vanishes where Σ ν_i tr(V⁻¹ S V⁻¹ M_k) = Σ ν_i tr(V⁻¹ M_k) for every θ_k > 0. The multiplicative step

    θ_k ← θ_k √( Σ ν_i tr(V_i⁻¹ S_i V_i⁻¹ M_ik) / Σ ν_i tr(V_i⁻¹ M_ik) )

never leaves θ ≥ 0 and never lessens the likelihood: it is the minimum of a majorant of -2 log L that is separable in
the components.

References: D. A. Harville, J. American Statistical Association 72 (1977) 320-338, 10.1080/01621459.1977.10480998;
H. Zhou, L. Hu, J. Zhou, K. Lange, J. Computational and Graphical Statistics 28 (2019) 350-361,
10.1080/10618600.2018.1529601 (the multiplicative step).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg.lapack import dpotrf, dpotri

MAX_STEPS = 100
SETTLED = 1e-5
"""Relative change of every group's variance, in its own standard units, below which the steps end."""


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
    small value, not at zero: the steps approach the bound and stop when the covariances have settled.

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
    sizes = share / np.maximum(freedom @ traces, 1e-300)
    # Matrices are symmetric: their upper triangles say all, and are read twice a step instead of whole four times.
    packed = [_Packed.of(group) for group in groups]
    V = [one.covariance(sizes) for one in packed]
    for _ in range(MAX_STEPS):
        sums, moved = np.zeros((len(sizes), 2)), 0.0
        inverses = [_inverse(one) for one in V]
        for group, one, inverse in zip(groups, packed, inverses, strict=True):
            sums += group.freedom * one.traces(inverse @ group.sample @ inverse, inverse)
        found, expected = sums.T
        sizes = sizes * np.sqrt(np.maximum(found, 0.0) / np.maximum(expected, 1e-300))
        for i, (one, inverse) in enumerate(zip(packed, inverses, strict=True)):
            former, V[i] = V[i], one.covariance(sizes)
            moved = max(moved, abs(float(np.vdot(V[i] - former, inverse))) / len(inverse))
        if moved < SETTLED:
            break
    return sizes


@dataclass(frozen=True, slots=True)
class _Packed:
    """The upper triangles of a group's components, row by row, and how often each element is in the matrix."""

    rows: Int[np.ndarray, " u"]
    columns: Int[np.ndarray, " u"]
    counts: Float[np.ndarray, " u"]
    components: Float[np.ndarray, "k u"]

    @classmethod
    def of(cls, group: SampleCovariance) -> _Packed:
        rows, columns = np.triu_indices(len(group.sample))
        counts = np.where(rows == columns, 1.0, 2.0)
        return cls(rows, columns, counts, group.components[:, rows, columns])

    def covariance(self, sizes: Float[np.ndarray, " k"]) -> Float[np.ndarray, "d d"]:
        upper = sizes @ self.components
        V = np.empty((int(self.rows[-1]) + 1,) * 2)
        V[self.rows, self.columns] = upper
        V[self.columns, self.rows] = upper
        return V

    def traces(
        self, one: Float[np.ndarray, "d d"], other: Float[np.ndarray, "d d"]
    ) -> Float[np.ndarray, "k 2"]:
        """Return tr(M_k X) of two symmetric matrices, to rounding errors of their halves."""
        both = np.stack([matrix[self.rows, self.columns] * self.counts for matrix in (one, other)], axis=1)
        return np.asarray(self.components @ both)


def _inverse(V: Float[np.ndarray, "d d"]) -> Float[np.ndarray, "d d"]:
    """Return V⁻¹ by Cholesky's factor, in less than half of the time of a general inverse; which serves where rounding
    leaves V not positive definite.
    """
    factor, failed = dpotrf(V, lower=1, clean=0)
    inverse, also = dpotri(factor, lower=1, overwrite_c=1)
    if failed or also:
        return np.linalg.inv(V)
    lower = np.tril(inverse)
    return np.asarray(lower + np.tril(inverse, -1).T)


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
