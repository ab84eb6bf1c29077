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
from jaxtyping import Float

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
    flat = [group.components.reshape(len(sizes), -1) for group in groups]
    for _ in range(MAX_STEPS):
        found, expected, moved = np.zeros(len(sizes)), np.zeros(len(sizes)), 0.0
        inverses = [np.linalg.inv(group.covariance(sizes)) for group in groups]
        for group, inverse, components in zip(groups, inverses, flat, strict=True):
            explained = inverse @ group.sample @ inverse
            found += group.freedom * (components @ explained.ravel())
            expected += group.freedom * (components @ inverse.ravel())
        former = sizes
        sizes = sizes * np.sqrt(np.maximum(found, 0.0) / np.maximum(expected, 1e-300))
        for inverse, components in zip(inverses, flat, strict=True):
            change = (sizes - former) @ components
            moved = max(moved, float(np.abs(change @ inverse.ravel())) / len(inverse))
        if moved < SETTLED:
            break
    return sizes


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
