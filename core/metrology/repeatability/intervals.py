"""Uncertainty of measured scatter: its interval, the noise floor of the instrument, and the corrected figure.

Each figure is the reading of n cycles p_j ~ N(μ, Σ_robot + M_j), M_j the covariance of measurement j.

- **Interval**: between which the figure of endless cycles of the same robot and instrument lies. 3 S is a χ² matter,
  S² ν / σ² ~ χ²_ν with ν = n - 1, exact under Gaussian scatter of any shape; RP_l has no exact law, see
  `rp_distribution`. Where measurements differ in noise, cycles count unequally: ν is then (n - 1) (mean τ_j²)² / mean
  τ_j⁴ with τ_j² the variance of cycle j (Welch-Satterthwaite).
- **Noise floor**: the expected reading of n cycles on a motionless robot, so of M_j alone. The deviation of cycle j
  from the mean of all has covariance (1 - 2/n) M_j + M̄/n, which makes E l̄ exact.
- **Corrected**: the reading that the same number of cycles would have given with a perfect instrument. Covariances
  subtract, D = S - M̄ without its negative part, and the reading is scaled by g(D) / g(S): with M = 0 it is the raw
  reading to the last digit. g(D) is biased, since S is itself scattered; `noise_subtraction` finds by how much, and it
  is divided out.

Reference: B. L. Welch, Biometrika 34 (1947) 28-35, doi:10.1093/biomet/34.1-2.28.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from jaxtyping import Float
from scipy.special import chdtri, gammaln

from core.metrology.iso9283 import rp_of_moments
from core.metrology.repeatability.noise_subtraction import share, subtracted_scatter
from core.metrology.rp_distribution import (
    CONFIDENCE,
    eigenvalues,
    long_run_rp,
    mean_length,
    rp_sampling_distribution,
)

MAX_FLOOR_SHARE = 0.5
"""The corrected RP_l has an interval that keeps its level where the floor is below this share of the reading."""
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
    effective = nu * share(total * total, total * total + excess)
    tail = (1.0 - CONFIDENCE) / 2.0
    low = 3.0 * np.sqrt(variance * effective / chdtri(effective, tail))
    high = 3.0 * np.sqrt(variance * effective / chdtri(effective, 1.0 - tail))
    floor = 3.0 * np.sqrt(noise) * _mean_root(nu * share(noise * noise, noise * noise + excess))
    left = np.maximum(variance - noise, 0.0)
    replicas = variance[..., None] * _chi_square_means(tuple(np.ravel(nu)))[:, None, :]
    expected = np.sqrt(np.maximum(replicas - noise[..., None], 0.0)).mean(axis=-1)
    unsubtracted = np.sqrt(replicas).mean(axis=-1)
    corrected = 3.0 * left * share(unsubtracted, expected * np.sqrt(variance))
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
    subtracted, plain = subtracted_scatter(covariance, noise, cycles)
    # With M = 0 the ratios are 1, and the reading stands.
    corrected = reading * share(subtracted.found, plain.found) * share(plain.gain, subtracted.gain)
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
    return share(rp_of_moments(m, total), long_run_rp(spectrum))


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
    return 1.0 + (cycles - 1.0) * share(variance * variance, variance * variance + excess)


def _mean_root(nu: Float[np.ndarray, "*k"]) -> Float[np.ndarray, "*k"]:
    """Return E √(χ²_ν / ν), the mean of S over σ (c₄ of quality control, n = ν + 1)."""
    return np.asarray(np.sqrt(2.0 / nu) * np.exp(gammaln((nu + 1.0) / 2.0) - gammaln(nu / 2.0)))
