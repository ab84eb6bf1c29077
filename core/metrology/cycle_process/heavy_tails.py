"""How heavy the tails of the cycles are: Student's ν, common to all poses, by its marginal likelihood.

A pose's n cycles x_j in d dimensions are multivariate t with mean μ and scale Σ of their own. With the prior
|Σ|^-(d+1)/2 the marginal likelihood is affine-invariant: size, shape and place of a pose's scatter do not enter. For
Gaussian cycles it is known in closed form,

    π^-(n-1)d/2 n^-d/2 Γ_d((n-1)/2) |S|^-(n-1)/2,     S = Σ (x_j - x̄)(x_j - x̄)ᵀ.

For ν it is an average over draws of (μ, Σ) from an inverse Wishart about the likelihood's maximum, found by expectation
maximisation, with weights that make it exact in the limit (importance sampling). The draws are fixed.

The prior is .6 for Gaussian cycles, the rest equal for all ν of the grid.

References: K. L. Lange, R. J. A. Little, J. M. G. Taylor, J. Am. Stat. Assoc. 84 (1989) 881-896, doi:10.2307/2290063
(t by expectation maximisation); J. Geweke, Econometrica 57 (1989) 1317-1339, doi:10.2307/1913710.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import gammaincinv, gammaln, logsumexp, multigammaln

TAIL_DEGREES = np.array([3.0, 4.0, 5.0, 6.0, 8.0, 12.0, 20.0])
"""From two down the scatter is not finite."""
_PRIOR_GAUSSIAN = 0.6
_MAX_POSES = 16
"""More poses add little to what is known of ν, which one interval of few per cent changes by less than its width."""
_STEPS = 12
_MIN_DRAWS, _MAX_DRAWS = 32, 256
_CELLS = 60_000
_SEED = 419
_WIDER = 0.8
"""The proposal has this share of the information at the maximum, so that it covers the tails."""


def tail_weights(poses: Sequence[Float[np.ndarray, "_ _"]]) -> Float[np.ndarray, " t"]:
    """Return the posterior probabilities of ν in `TAIL_DEGREES`; what they lack to one is that of Gaussian cycles."""
    usable = [x for x in poses if x.shape[1] > 0 and len(x) >= x.shape[1] + 2]
    if len(usable) > _MAX_POSES:
        usable = [usable[i] for i in np.linspace(0, len(usable) - 1, _MAX_POSES).round().astype(int)]
    evidence = np.zeros(1 + len(TAIL_DEGREES))
    shapes = sorted({x.shape for x in usable})
    cells = sum(len(x) for x in usable)
    draws = int(np.clip(_CELLS // max(cells, 1), _MIN_DRAWS, _MAX_DRAWS))
    for shape in shapes:
        x = np.stack([one for one in usable if one.shape == shape])
        x = x / np.sqrt(np.mean(x * x, axis=(1, 2), keepdims=True))
        evidence[0] += _gaussian(x)
        for k, nu in enumerate(TAIL_DEGREES):
            evidence[1 + k] += _student(x, float(nu), draws)
    prior = np.full(len(evidence), (1.0 - _PRIOR_GAUSSIAN) / len(TAIL_DEGREES))
    prior[0] = _PRIOR_GAUSSIAN
    posterior = prior * np.exp(evidence - evidence.max())
    return np.asarray(posterior[1:] / posterior.sum())


def _gaussian(x: Float[np.ndarray, "p n d"]) -> float:
    poses, n, d = x.shape
    about = x - x.mean(axis=1, keepdims=True)
    log_determinants = np.linalg.slogdet(np.swapaxes(about, 1, 2) @ about)[1]
    constant = multigammaln(0.5 * (n - 1.0), d) - 0.5 * d * ((n - 1.0) * np.log(np.pi) + np.log(n))
    return float(poses * constant - 0.5 * (n - 1.0) * log_determinants.sum())


def _student(x: Float[np.ndarray, "p n d"], nu: float, draws: int) -> float:
    """Return the sum over poses of the log marginal likelihood."""
    return float((logsumexp(student_draws(x, nu, draws).log_weight, axis=1) - np.log(draws)).sum())


@dataclass(frozen=True, slots=True)
class ScaleDraws:
    """Draws of the scale Σ of each pose from a proposal, as V Vᵀ, and the log of posterior over proposal.

    The mean of exp(log_weight) is the marginal likelihood.
    """

    roots: Float[np.ndarray, "p b d d"]
    log_weight: Float[np.ndarray, "p b"]


def student_draws(x: Float[np.ndarray, "p n d"], nu: float, draws: int) -> ScaleDraws:
    """Return draws of Σ given that cycles are Student t with this ν; the draws are the same for all data but scale."""
    n, d = x.shape[1:]
    mean, root = _maximum(x, nu)
    whitened = np.linalg.inv(root) @ np.swapaxes(x - mean[:, None], 1, 2)
    proposal = _proposal(n, d, nu, draws)
    # Σ⁻¹ = B Bᵀ / m in whitened coordinates, and the mean lies e / √(κ n) off in those of Σ.
    y = np.swapaxes(proposal.factors, 1, 2) @ whitened[:, None] - proposal.offsets[:, :, None]
    square = np.einsum("pben,pben->pbn", y, y)
    constant = gammaln(0.5 * (nu + d)) - gammaln(0.5 * nu) - 0.5 * d * np.log(nu * np.pi)
    tails = 0.5 * (nu + d) * np.log1p(square / nu).sum(axis=2)
    likelihood = n * (constant - 0.5 * proposal.log_scale) - tails
    sizes = np.log(np.einsum("pdd->pd", root)).sum(axis=1)
    weight = likelihood + proposal.log_weight - (n - 1.0) * sizes[:, None]
    inverse = np.swapaxes(np.linalg.inv(proposal.factors), 1, 2)
    return ScaleDraws(root[:, None] @ inverse, weight)


def gaussian_draws(x: Float[np.ndarray, "p n d"], draws: int) -> Float[np.ndarray, "p b d d"]:
    """Return draws of Σ as V Vᵀ given that cycles are Gaussian: inverse Wishart of n - 1 degrees of freedom."""
    n, d = x.shape[1:]
    about = x - x.mean(axis=1, keepdims=True)
    root = np.linalg.cholesky(np.swapaxes(about, 1, 2) @ about)
    factors, _ = _bartlett(n, d, n - 1.0, draws)
    return np.asarray(root[:, None] @ np.swapaxes(np.linalg.inv(factors), 1, 2))


def _maximum(
    x: Float[np.ndarray, "p n d"], nu: float
) -> tuple[Float[np.ndarray, "p d"], Float[np.ndarray, "p d d"]]:
    """Return the mean and the Cholesky factor of the scale near the likelihood's maximum."""
    n, d = x.shape[1:]
    weight = np.ones(x.shape[:2])
    for _ in range(_STEPS):
        mean = np.einsum("pn,pnd->pd", weight, x) / weight.sum(axis=1)[:, None]
        about = x - mean[:, None]
        scale = np.swapaxes(weight[:, :, None] * about, 1, 2) @ about / (n - 1.0)
        root = np.linalg.cholesky(scale + 1e-12 * np.eye(d))
        y = about @ np.swapaxes(np.linalg.inv(root), 1, 2)
        weight = (nu + d) / (nu + np.einsum("pnd,pnd->pn", y, y))
    return mean, root


@dataclass(frozen=True, slots=True)
class _Proposal:
    """Draws of (μ, Σ) in whitened coordinates: factors B / √m, offsets of the mean, log |Σ|, and the log of prior over
    proposal.
    """

    factors: Float[np.ndarray, "b d d"]
    offsets: Float[np.ndarray, "b d"]
    log_scale: Float[np.ndarray, " b"]
    log_weight: Float[np.ndarray, " b"]


def _proposal(n: int, d: int, nu: float, draws: int) -> _Proposal:
    information = _WIDER * (nu + d) / (nu + d + 2.0)
    m = max((n - 1.0) * information, d + 1.0)
    factors, offsets = _bartlett(n, d, m, draws)
    log_root = np.log(np.einsum("bdd->bd", factors)).sum(axis=1)
    log_scale = d * np.log(m) - 2.0 * log_root
    trace = np.einsum("bde,bde->b", factors, factors)
    log_q = (
        0.5 * m * d * np.log(m)
        - 0.5 * (m + d + 1.0) * log_scale
        - 0.5 * trace
        - 0.5 * m * d * np.log(2.0)
        - multigammaln(0.5 * m, d)
    )
    spread = information * n
    log_q += (
        -0.5 * d * np.log(2.0 * np.pi / spread)
        - 0.5 * log_scale
        - 0.5 * np.einsum("bd,bd->b", offsets, offsets)
    )
    return _Proposal(
        factors / np.sqrt(m), offsets / np.sqrt(spread), log_scale, -0.5 * (d + 1.0) * log_scale - log_q
    )


def _bartlett(
    n: int, d: int, degrees: float, draws: int
) -> tuple[Float[np.ndarray, "b d d"], Float[np.ndarray, "b d"]]:
    """Return Cholesky factors of Wishart matrices, and normal vectors; the same random numbers for all degrees."""
    rng = np.random.default_rng([_SEED, n, d])
    normal = rng.standard_normal((draws, d, d))
    uniform = rng.random((draws, d))
    offsets = rng.standard_normal((draws, d))
    factors = np.tril(normal, -1)
    for i in range(d):
        factors[:, i, i] = np.sqrt(_chi_square(degrees - i, uniform[:, i]))
    return factors, offsets


def _chi_square(degrees: float, uniform: Float[np.ndarray, " b"]) -> Float[np.ndarray, " b"]:
    return np.asarray(2.0 * gammaincinv(0.5 * degrees, uniform))
