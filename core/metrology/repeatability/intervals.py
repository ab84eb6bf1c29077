"""Uncertainty of measured scatter: its interval, the noise floor of the instrument, and the corrected figure.

Each figure is the reading of n cycles p_j ~ N(μ, Σ_robot + M_j), M_j the covariance of measurement j.

- **Interval**: between which the figure of endless cycles of the same robot and instrument lies. 3 S is a χ² matter,
  S² ν / σ² ~ χ²_ν with ν = n - 1, exact under Gaussian scatter of any shape; RP_l has no exact law, see `radial`.
  Where measurements differ in noise, cycles count unequally: ν is then (n - 1) (mean τ_j²)² / mean τ_j⁴ with τ_j² the
  variance of cycle j (Welch-Satterthwaite).
- **Noise floor**: the expected reading of n cycles on a motionless robot, so of M_j alone. The deviation of cycle j
  from the mean of all has covariance (1 - 2/n) M_j + M̄/n, which makes E l̄ exact.
- **Corrected**: the reading that the same number of cycles would have given with a perfect instrument. Covariances
  subtract, D = S - M̄ without its negative part, and the reading is scaled by g(D) / g(S): with M = 0 it is the raw
  reading to the last digit. Because S is itself scattered, g(D) is biased (upward where noise makes a sphere look
  elongated, downward where a subtraction stops at zero); the bias is found by repeating the subtraction on Wishart
  replicates of the model D + M and divided out. Replicates of S itself would leave 2 % where robot and noise have
  equal figures: where the subtraction stopped at zero, S is no sum of M and a covariance. The bias depends on D's size,
  which is biased too, so that it is found once more with D scaled by the first answer.

References: B. L. Welch, Biometrika 34 (1947) 28-35, doi:10.1093/biomet/34.1-2.28; B. Efron, R. J. Tibshirani, "An
Introduction to the Bootstrap", 1993, §10.6 (bias correction); T. W. Anderson, "An Introduction to Multivariate
Statistical Analysis", 2003, §7.2 (Bartlett's decomposition).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from jaxtyping import Float
from scipy.special import chdtri, gammaln, ndtri

from core.metrology.iso9283 import rp_of_moments
from core.metrology.rp_distribution import (
    CONFIDENCE,
    eigenvalues,
    long_run_rp,
    mean_length,
    rp_sampling_distribution,
)

MAX_FLOOR_SHARE = 0.5
"""The corrected RP_l has an interval that keeps its level where the floor is below this share of the reading."""
_POINTS = 32  # a power of two, which balances the net
_SIGNS = np.array([[1.0, 1.0, 1.0], [1.0, 1.0, -1.0], [1.0, -1.0, 1.0], [-1.0, 1.0, 1.0]])
_ROUNDS = 2
_CHI_GRID = 128


@dataclass(frozen=True, slots=True)
class IntervalEstimate:
    """A batch of readings with what surrounds them, one row a pose; in the readings' unit.

    `excess` is the logarithm of a reading RP_l over what the cycles' covariance lets expect, which is large where tails
    are heavy: S_l is the scatter of lengths and holds fourth moments. 0 for 3 S.
    """

    low: Float[np.ndarray, "*k"]
    high: Float[np.ndarray, "*k"]
    floor: Float[np.ndarray, "*k"]
    corrected: Float[np.ndarray, "*k"]
    corrected_low: Float[np.ndarray, "*k"]
    corrected_high: Float[np.ndarray, "*k"]
    excess: Float[np.ndarray, "*k"]


def assess_three_sigma(
    variance: Float[np.ndarray, "k c"],
    noise: Float[np.ndarray, "k c"],
    noise_square: Float[np.ndarray, "k c"],
    cycles: Float[np.ndarray, " k"],
) -> IntervalEstimate:
    """Return intervals, floors and corrected values of the readings 3 S of c quantities.

    Parameters
    ----------
    variance
        S² of n cycles.
    noise, noise_square
        Mean over the cycles of the measurements' variances, and of their squares.
    cycles
        n ≥ 2 of each row.
    """
    nu = cycles[:, None] - 1.0
    excess = np.maximum(noise_square - noise * noise, 0.0)
    total = np.maximum(variance, noise)
    effective = nu * _share(total * total, total * total + excess)
    tail = (1.0 - CONFIDENCE) / 2.0
    low = 3.0 * np.sqrt(variance * effective / chdtri(effective, tail))
    high = 3.0 * np.sqrt(variance * effective / chdtri(effective, 1.0 - tail))
    floor = 3.0 * np.sqrt(noise) * _mean_root(nu * _share(noise * noise, noise * noise + excess))
    left = np.maximum(variance - noise, 0.0)
    replicas = variance[..., None] * _chi_square_means(tuple(np.ravel(nu)))[:, None, :]
    expected = np.sqrt(np.maximum(replicas - noise[..., None], 0.0)).mean(axis=-1)
    unsubtracted = np.sqrt(replicas).mean(axis=-1)
    corrected = 3.0 * left * _share(unsubtracted, expected * np.sqrt(variance))
    return IntervalEstimate(
        low,
        high,
        floor,
        corrected,
        np.sqrt(np.maximum(low * low - 9.0 * noise, 0.0)),
        np.sqrt(np.maximum(high * high - 9.0 * noise, 0.0)),
        np.zeros(variance.shape),
    )


def noise_only_lengths(covariances: Float[np.ndarray, "n 3 3"]) -> tuple[float, float]:
    """Return E l̄ and √(E S_l²) of n ≥ 2 measurements of a motionless robot, mm, given each M_j (mm²).

    Two lengths correlate as the square of their points' correlation, 1 / (n - 1)², to within a few percent of it: hence
    the factor n (n - 2) / (n - 1)² on the lengths' mean variance, which is exact at n = 2 (S_l = 0) and in the limit.
    What the expected lengths of unequal measurements differ by comes in whole, by n / (n - 1).
    """
    n = len(covariances)
    deviations = (1.0 - 2.0 / n) * covariances + covariances.mean(axis=0) / n
    lengths = mean_length(eigenvalues(deviations))
    length = float(lengths.mean())
    between = float(np.var(lengths))
    within = float(np.einsum("nii->", deviations)) / n - length * length - between
    squared = max(within, 0.0) * n * (n - 2.0) / (n - 1.0) ** 2 + between * n / (n - 1.0)
    return length, float(np.sqrt(squared)) if n > 2 else 0.0


def assess_radial(
    reading: Float[np.ndarray, " k"],
    covariance: Float[np.ndarray, "k 3 3"],
    noise: Float[np.ndarray, "k 3 3"],
    trace_excess: Float[np.ndarray, " k"],
    still: Float[np.ndarray, "k 2"],
    cycles: Float[np.ndarray, " k"],
) -> IntervalEstimate:
    """Return intervals, floors and corrected values of the readings RP_l, mm.

    Parameters
    ----------
    covariance, noise
        S of the n cycles and the mean of their measurements' covariances, mm².
    trace_excess
        Variance over the cycles of the measurements' tr M_j, mm⁴.
    still
        From `noise_only_lengths`.
    cycles
        n ≥ 2 of each row.
    """
    # By LAPACK: the shape is a square root, which makes 1e-8 of a vanishing axis 1e-4.
    spectrum = np.maximum(np.linalg.eigvalsh(covariance)[:, ::-1], 0.0)
    noise_trace = np.trace(noise, axis1=1, axis2=2)
    floor = (
        still[:, 0]
        + 3.0
        * still[:, 1]
        * rp_sampling_distribution(
            eigenvalues(noise), _effective(cycles, noise_trace, trace_excess)
        ).mean_scatter
    )
    effective = _effective(cycles, np.maximum(spectrum.sum(axis=1), noise_trace), trace_excess)
    law = rp_sampling_distribution(spectrum, effective)
    low, high = law.interval(reading)
    # Two cycles are equally far from their mean, S_l = 0: the long-run figure lies above such a reading.
    low = np.minimum(low, reading)
    subtracted, plain = _subtraction(covariance, noise, cycles)
    # With M = 0 the ratios are 1, and the reading stands.
    corrected = reading * _share(subtracted.found, plain.found) * _share(plain.gain, subtracted.gain)
    corrected = corrected / _heavy_tail(spectrum, noise_trace, trace_excess)
    # The reading's own spread, with that of g(S) in it replaced by that of g(D).
    spread = np.sqrt(
        np.maximum(law.spread**2 + subtracted.log_variance - plain.log_variance, 0.04 * law.spread**2)
    )
    corrected_low, corrected_high = replace(law, spread=spread).interval(corrected)
    scattered = (reading > 0.0) & (plain.found > 0.0)
    ratio = np.where(scattered, reading, 1.0) / np.where(scattered, plain.found, 1.0)
    excess = np.where(scattered, np.log(ratio) - law.centre + np.log(plain.gain), 0.0)
    return IntervalEstimate(low, high, floor, corrected, corrected_low, corrected_high, excess)


def _heavy_tail(
    spectrum: Float[np.ndarray, "k 3"],
    noise_trace: Float[np.ndarray, " k"],
    trace_excess: Float[np.ndarray, " k"],
) -> Float[np.ndarray, " k"]:
    """Return by what factor cycles of unequal noise read more than equal ones of the same covariance.

    With τ_j² the variance of cycle j, mean lengths go by E τ = √(E τ²) (1 + v)^-⅛, v the variance of τ² over its mean
    squared: exact to second order in v.
    """
    total = spectrum.sum(axis=1)
    unevenness = np.where(total > 0.0, trace_excess, 0.0) / np.where(
        total > 0.0, np.maximum(total, noise_trace) ** 2, 1.0
    )
    m = mean_length(spectrum) * (1.0 + unevenness) ** -0.125
    return _share(rp_of_moments(m, total), long_run_rp(spectrum))


@dataclass(frozen=True, slots=True)
class _Estimated:
    """What an estimate g of the scatter read, mm; by what factor it reads too much, and the variance of its logarithm
    were it lognormal, both by replicates.
    """

    found: Float[np.ndarray, " k"]
    gain: Float[np.ndarray, " k"]
    log_variance: Float[np.ndarray, " k"]


def _subtraction(
    covariance: Float[np.ndarray, "k 3 3"], noise: Float[np.ndarray, "k 3 3"], cycles: Float[np.ndarray, " k"]
) -> tuple[_Estimated, _Estimated]:
    """Return what g(S - M) and g(S) are worth, by Wishart replicates S* of the model D + M that was fitted.

    Replicates of S itself would not do: where a subtraction stopped at zero, S is no sum of M and a covariance. D's
    size is then taken to where the replicates read what was observed, once, since the factor depends on it.
    """
    values, vectors = np.linalg.eigh(covariance - noise)
    values = np.maximum(values, 0.0)
    left = long_run_rp(values[:, ::-1])
    size = long_run_rp(np.linalg.eigvalsh(covariance)[:, ::-1])
    gain, log_variance = np.empty((2, len(left))), np.empty((2, len(left)))
    for n in np.unique(cycles):
        rows = np.flatnonzero(cycles == n)
        factors = _wishart_factors(int(n) - 1)
        for chunk in np.array_split(rows, max(1, len(rows) // 64)):
            D, M = _composed(vectors[chunk], values[chunk]), noise[chunk]
            scale = np.ones(len(chunk))
            for _ in range(_ROUNDS):
                model = scale[:, None, None] * D + M
                replicas = _replicas(model, factors)
                of_robot = long_run_rp(eigenvalues(replicas - M[:, None]))
                gain[0, chunk] = _share(of_robot.mean(axis=1), np.sqrt(scale) * left[chunk])
                scale = _share(np.ones(len(chunk)), gain[0, chunk]) ** 2
            of_all = long_run_rp(eigenvalues(replicas))
            gain[1, chunk] = _share(of_all.mean(axis=1), long_run_rp(np.linalg.eigvalsh(model)[:, ::-1]))
            for k, sizes in enumerate((of_robot, of_all)):
                log_variance[k, chunk] = np.log1p(_share(sizes.var(axis=1), sizes.mean(axis=1) ** 2))
    return _Estimated(left, gain[0], log_variance[0]), _Estimated(size, gain[1], log_variance[1])


def _composed(
    vectors: Float[np.ndarray, "k 3 3"], values: Float[np.ndarray, "k 3"]
) -> Float[np.ndarray, "k 3 3"]:
    return np.asarray((vectors * values[:, None, :]) @ np.swapaxes(vectors, 1, 2))


def _replicas(
    covariance: Float[np.ndarray, "k 3 3"], factors: Float[np.ndarray, "b 3 3"]
) -> Float[np.ndarray, "k b 3 3"]:
    """Return sample covariances of cycles that scatter as `covariance`."""
    values, vectors = np.linalg.eigh(covariance)
    roots = (vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :])[:, None] @ factors
    return np.asarray(roots @ np.swapaxes(roots, 2, 3))


@lru_cache(maxsize=256)
def _wishart_factors(nu: int) -> Float[np.ndarray, "b 3 3"]:
    """Return A with A Aᵀ distributed as a Wishart matrix of ν degrees of freedom over ν (Bartlett).

    Each point of a Sobol net stands with every choice of signs of the axes, D A D: eigenvectors have no sign, and no
    result may depend on which one they came with.
    """
    # Takes half a second to load, which every process of a service would pay.
    from scipy.stats import qmc

    uniform = qmc.Sobol(6, scramble=False).random(_POINTS) + 0.5 / _POINTS
    factors = np.zeros((_POINTS, 3, 3))
    for i in range(min(nu, 3)):
        factors[:, i, i] = np.sqrt(chdtri(nu - i, uniform[:, i]))
    for column, (i, j) in enumerate(((1, 0), (2, 0), (2, 1))):
        if j < nu:  # with fewer cycles than dimensions the matrix has no more columns than ν
            factors[:, i, j] = ndtri(uniform[:, 3 + column])
    flips = _SIGNS[:, :, None] * _SIGNS[:, None, :]
    factors = (factors[:, None] * flips).reshape(-1, 3, 3) / np.sqrt(nu)
    factors.flags.writeable = False
    return factors


@lru_cache(maxsize=64)
def _chi_square_means(nus: tuple[float, ...]) -> Float[np.ndarray, "k g"]:
    """Return midpoint quantiles of χ²_ν / ν, a row for each ν."""
    tails = (np.arange(_CHI_GRID) + 0.5) / _CHI_GRID
    nu = np.array(nus)
    unique, inverse = np.unique(nu, return_inverse=True)
    grid = chdtri(unique[:, None], tails) / unique[:, None]
    return np.asarray(grid[inverse])


def _effective(
    cycles: Float[np.ndarray, " k"], variance: Float[np.ndarray, " k"], excess: Float[np.ndarray, " k"]
) -> Float[np.ndarray, " k"]:
    """Return how many equal cycles scatter as much as these, whose variances differ (Welch-Satterthwaite)."""
    return 1.0 + (cycles - 1.0) * _share(variance * variance, variance * variance + excess)


def _mean_root(nu: Float[np.ndarray, "*k"]) -> Float[np.ndarray, "*k"]:
    """Return E √(χ²_ν / ν), the mean of S over σ (c₄ of quality control, n = ν + 1)."""
    return np.asarray(np.sqrt(2.0 / nu) * np.exp(gammaln((nu + 1.0) / 2.0) - gammaln(nu / 2.0)))


def _share(part: Float[np.ndarray, "*k"], whole: Float[np.ndarray, "*k"]) -> Float[np.ndarray, "*k"]:
    """Return part / whole; 1 where there is nothing of either, 0 where there is no whole to a part."""
    some = whole > 0.0
    return np.asarray(np.where(some, part / np.where(some, whole, 1.0), np.where(part > 0.0, 0.0, 1.0)))
