"""Trials of one pose: Gaussian scatter of known covariance, seen through Gaussian measurement noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from core.metrology.repeatability.intervals import (
    IntervalEstimate,
    assess_radial,
    assess_three_sigma,
    noise_only_lengths,
)
from core.metrology.rp_distribution import long_run_rp

SHAPES = {
    "sphere": (1.0, 1.0, 1.0),
    "egg": (1.0, 0.5, 0.2),
    "flat": (1.0, 1.0, 1e-4),
    "lens": (1.0, 1.0, 0.09),
    "cigar": (1.0, 0.09, 0.09),
    "strip": (1.0, 0.09, 0.0081),
    "needle": (1.0, 1e-4, 1e-4),
}


def of_reading(shape: str, reading: float, turned: bool = False) -> np.ndarray:
    """Return the variances along x, y, z of a scatter with this long-run RP_l."""
    spectrum = np.array(SHAPES[shape])
    variances = spectrum * (reading / float(long_run_rp(spectrum))) ** 2
    return variances[::-1] if turned else variances


@dataclass(frozen=True)
class Trials:
    """Readings of true and measured cycles, and what is said of them."""

    true_reading: np.ndarray
    true_sigma: np.ndarray
    reading: np.ndarray
    sigma: np.ndarray
    radial: IntervalEstimate
    three_sigma: IntervalEstimate


def run(
    n: int,
    robot: np.ndarray,
    noise: np.ndarray,
    trials: int,
    seed: int,
    weights: np.ndarray | None = None,
    radial_of: int | None = None,
) -> Trials:
    """Simulate; `weights` scale the noise variance of each cycle.

    Only the first `radial_of` trials have their RP_l assessed, which takes nearly all of the time: the floor is that of
    the noise stated, one for all trials.
    """
    rng = np.random.default_rng([seed, n])
    each = noise * (np.ones(n) if weights is None else weights)[:, None]
    true = rng.standard_normal((trials, n, 3)) * np.sqrt(robot)
    measured = true + rng.standard_normal((trials, n, 3)) * np.sqrt(each)

    def read(positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        d = positions - positions.mean(axis=1, keepdims=True)
        lengths = np.linalg.norm(d, axis=2)
        reading = lengths.mean(axis=1) + 3.0 * lengths.std(axis=1, ddof=1)
        return reading, d.transpose(0, 2, 1) @ d / (n - 1)

    true_reading, true_covariance = read(true)
    reading, covariance = read(measured)
    matrices = np.zeros((n, 3, 3))
    matrices[:, range(3), range(3)] = each
    cycles = np.full(trials, float(n))
    some = trials if radial_of is None else radial_of
    radial = assess_radial(
        reading[:some],
        covariance[:some],
        np.repeat(matrices.mean(axis=0)[None], some, axis=0),
        np.full(some, each.sum(axis=1).var()),
        np.tile(noise_only_lengths(matrices), (some, 1)),
        cycles[:some],
    )
    variance = np.einsum("tii->ti", covariance)
    three = assess_three_sigma(
        variance,
        np.tile(each.mean(axis=0), (trials, 1)),
        np.tile((each**2).mean(axis=0), (trials, 1)),
        cycles,
    )
    true_variance = np.einsum("tii->ti", true_covariance)
    return Trials(true_reading, 3.0 * np.sqrt(true_variance), reading, 3.0 * np.sqrt(variance), radial, three)


def covered(low: np.ndarray, high: np.ndarray, truth: float | np.ndarray) -> float:
    return float(np.mean((low <= truth) & (truth <= high)))
