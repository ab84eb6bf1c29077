"""Sampling distribution of RP_l = l̄ + 3 S_l when the cycles scatter as a Gaussian of covariance Σ.

With p_j ~ N(μ, Σ) and endless cycles RP_l is

    g(Σ) = m + 3 √(tr Σ - m²),     m = E|p - μ| = √(8/π) R_G(λ₁, λ₂, λ₃),

λ the eigenvalues of Σ and R_G Carlson's symmetric integral of the second kind: |p - μ| is a chi variable of three
degrees of freedom times the length of Σ^½ applied to a random direction, whose mean over the sphere is R_G. For a
sphere g = 3.616 σ, for a needle 2.606 σ.

With n cycles the reading scatters about g, and how much depends on n and on the *shape* of Σ: a needle has one
degree of freedom a cycle where a sphere has three. The shape is itself estimated. So the interval is a parametric
bootstrap of the ratio reading / g, inverted, and studentised by the shape:

    t = (log(reading / g(Σ)) - μ(shape of S)) / σ(shape of S),

whose quantiles are simulated over Σ of every shape and n cycles with S re-estimated in each. Without that step the
interval covers 98 % of spheres at n = 10, since a sample of a sphere looks elongated.

References: B. C. Carlson, "Numerical computation of real or complex elliptic integrals", Numer. Algorithms 10 (1995),
doi:10.1007/BF02198293; P. Hall, "The Bootstrap and Edgeworth Expansion", 1992, ch. 3 (bootstrap-t).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float
from scipy.special import elliprg, ndtri

from core.metrology.iso9283 import rp_of_moments

CONFIDENCE = 0.95
NORMAL_FACTOR = float(ndtri(0.5 + 0.5 * CONFIDENCE))
_TAILS = ((1.0 - CONFIDENCE) / 2.0, (1.0 + CONFIDENCE) / 2.0)
_SEED = 9283
_KNOTS = (2, 3, 4, 5, 6, 8, 10, 14, 20, 30, 50, 100)
"""Numbers of cycles that are simulated; between them and beyond, the law is smooth in 1/√(n - 1)."""
_AXIS = np.linspace(0.0, 1.0, 6)
_REPLICATES = 6000
_LEAST_VARIANCE = 1e-200


def eigenvalues(matrices: Float[np.ndarray, "*k 3 3"]) -> Float[np.ndarray, "*k 3"]:
    """Return the eigenvalues of symmetric 3 × 3 matrices, largest first, in closed form (O. K. Smith, 1961).

    Exact to some 1e-8 of the largest: enough for lengths that are sums over all three, at a tenth of LAPACK's cost.
    """
    a, b, c = (matrices[..., i, i] for i in range(3))
    d, e, f = matrices[..., 0, 1], matrices[..., 0, 2], matrices[..., 1, 2]
    mean = (a + b + c) / 3.0
    a, b, c = a - mean, b - mean, c - mean
    spread = np.sqrt((a * a + b * b + c * c + 2.0 * (d * d + e * e + f * f)) / 6.0)
    half_det = 0.5 * (a * (b * c - f * f) - d * (d * c - e * f) + e * (d * f - b * e))
    cube = spread**3
    turn = np.arccos(np.clip(half_det / np.where(cube > 0.0, cube, 1.0), -1.0, 1.0)) / 3.0
    first = mean + 2.0 * spread * np.cos(turn)
    last = mean + 2.0 * spread * np.cos(turn + 2.0 * np.pi / 3.0)
    return np.stack([first, 3.0 * mean - first - last, last], axis=-1)


def mean_length(spectrum: Float[np.ndarray, "*k 3"]) -> Float[np.ndarray, "*k"]:
    """Return E|x| of x ~ N(0, Σ) with these eigenvalues (negative ones, by rounding or subtraction, count as 0)."""
    largest = np.maximum(spectrum[..., :1], 0.0)
    positive = largest > _LEAST_VARIANCE  # below, Carlson's integral underflows
    shape = np.where(positive, np.maximum(spectrum, 0.0) / np.where(positive, largest, 1.0), 0.0)
    return np.asarray(np.sqrt(8.0 / np.pi * largest[..., 0]) * elliprg(*np.moveaxis(shape, -1, 0)))


def long_run_rp(spectrum: Float[np.ndarray, "*k 3"]) -> Float[np.ndarray, "*k"]:
    """Return g(Σ), the reading l̄ + 3 S_l after endless cycles."""
    return rp_of_moments(mean_length(spectrum), np.asarray(np.maximum(spectrum, 0.0).sum(axis=-1)))


@dataclass(frozen=True, slots=True)
class RpDistribution:
    """How log(reading / g) is spread over n cycles, for a batch of poses; all without unit.

    `centre` and `spread` are its mean and standard deviation at the shape given; `t_low`, `t_high` the quantiles of
    t there; `mean_scatter` is E S_l / √E S_l², the loss that a standard deviation of few cycles has.
    """

    centre: Float[np.ndarray, " k"]
    spread: Float[np.ndarray, " k"]
    t_low: Float[np.ndarray, " k"]
    t_high: Float[np.ndarray, " k"]
    mean_scatter: Float[np.ndarray, " k"]

    def interval(
        self, readings: Float[np.ndarray, " k"]
    ) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
        """Return the bounds between which g lies at the confidence level, given the readings."""
        centred = np.exp(-self.centre)
        return (
            readings * centred * np.exp(-self.spread * self.t_high),
            readings * centred * np.exp(-self.spread * self.t_low),
        )


def rp_sampling_distribution(
    spectrum: Float[np.ndarray, "k 3"], cycles: Float[np.ndarray, " k"]
) -> RpDistribution:
    """Return the law of the reading for covariances with these eigenvalues, largest first, and these n ≥ 2.

    `cycles` may be fractional: an effective number where some cycles count more than others.
    """
    x = 1.0 / np.sqrt(np.maximum(cycles, 2.0) - 1.0)
    u, v = _shape(spectrum)
    knots = np.array([*(1.0 / np.sqrt(n - 1.0) for n in _KNOTS), 0.0])
    right = np.clip(np.searchsorted(-knots, -x), 1, len(_KNOTS))
    weight = (x - knots[right]) / (knots[right - 1] - knots[right])
    values = np.zeros((5, len(x)))
    for knot in np.unique(np.concatenate([right, right - 1])):
        share = np.where(right == knot, 1.0 - weight, np.where(right - 1 == knot, weight, 0.0))
        values += share * _bilinear(_limit_nodes() if knot == len(_KNOTS) else _nodes(_KNOTS[knot]), u, v)
    centre, spread, low, high, loss = values
    return RpDistribution(centre * x * x, spread * x, low, high, 1.0 - loss * x * x)


def _shape(spectrum: Float[np.ndarray, "*k 3"]) -> tuple[Float[np.ndarray, "*k"], Float[np.ndarray, "*k"]]:
    """Return √(λ₂/λ₁) and √(λ₃/λ₂), each from 0 to 1 (1, 1 where there is no scatter at all)."""
    first, second, third = np.moveaxis(np.maximum(spectrum, 0.0), -1, 0)
    u = np.where(first > 0.0, second / np.where(first > 0.0, first, 1.0), 1.0)
    v = np.where(second > 0.0, third / np.where(second > 0.0, second, 1.0), 1.0)
    return np.sqrt(np.clip(u, 0.0, 1.0)), np.sqrt(np.clip(v, 0.0, 1.0))


@lru_cache(maxsize=len(_KNOTS))
def _nodes(n: int) -> Float[np.ndarray, "5 6 6"]:
    """Simulate n cycles of every node's shape: centre, spread, t_low, t_high, loss, freed of their n-dependence."""
    rng = np.random.default_rng([_SEED, n])
    z = rng.standard_normal((_REPLICATES, n, 3))
    z -= z.mean(axis=1, keepdims=True)
    squares = np.ascontiguousarray((z * z).reshape(-1, 3))
    scatter = z.transpose(0, 2, 1) @ z / (n - 1.0)
    size = len(_AXIS)
    logs = np.empty((size, size, _REPLICATES))
    estimated = np.empty((size, size, 2, _REPLICATES))
    loss = np.empty((size, size))
    for i, u in enumerate(_AXIS):
        for j, v in enumerate(_AXIS):
            root = np.array([1.0, u, u * v])
            lengths = np.sqrt(squares @ root**2).reshape(_REPLICATES, n)
            s = lengths.std(axis=1, ddof=1)
            logs[i, j] = np.log((lengths.mean(axis=1) + 3.0 * s) / long_run_rp(root**2))
            mean_square = np.mean(s * s)
            # Two cycles are equally far from their mean: S_l is nothing but rounding there.
            loss[i, j] = (1.0 - s.mean() / np.sqrt(mean_square)) * (n - 1.0) if n > 2 else 0.0
            estimated[i, j] = _shape(eigenvalues(scatter * np.outer(root, root)))
    centre = logs.mean(axis=2) * (n - 1.0)
    spread = logs.std(axis=2) * np.sqrt(n - 1.0)
    quantiles = np.empty((2, size, size))
    for i in range(size):
        for j in range(size):
            m, s = _bilinear(np.stack([centre, spread]), *estimated[i, j])
            t = (logs[i, j] - m / (n - 1.0)) / (s / np.sqrt(n - 1.0))
            quantiles[:, i, j] = np.quantile(t, _TAILS)
    nodes = np.stack([centre, spread, *quantiles, loss])
    nodes.flags.writeable = False
    return nodes


@lru_cache(maxsize=1)
def _limit_nodes() -> Float[np.ndarray, "5 6 6"]:
    """Return the law of endless cycles: Gaussian, its bias and width those of the last knot per cycle."""
    nodes = _nodes(_KNOTS[-1]).copy()
    nodes[2:4] = ndtri(np.array(_TAILS))[:, None, None]
    return nodes


def _bilinear(
    nodes: Float[np.ndarray, "c 6 6"], u: Float[np.ndarray, " k"], v: Float[np.ndarray, " k"]
) -> Float[np.ndarray, "c k"]:
    steps = len(_AXIS) - 1
    i = np.minimum((u * steps).astype(np.intp), steps - 1)
    j = np.minimum((v * steps).astype(np.intp), steps - 1)
    a, b = u * steps - i, v * steps - j
    return np.asarray(
        (1 - a) * ((1 - b) * nodes[:, i, j] + b * nodes[:, i, j + 1])
        + a * ((1 - b) * nodes[:, i + 1, j] + b * nodes[:, i + 1, j + 1])
    )
