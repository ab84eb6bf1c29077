"""The process that a session's cycles follow: independent and Gaussian, of heavy tails, or correlated in time.

One process holds for all poses of a session, whose scatter differs in size and shape. Its alternatives to independent
Gaussian cycles are a Student t of ν degrees of freedom (`heavy_tails`) and an autoregression of lag-one correlation φ
(`lag_correlation`), each known as a posterior on a grid. Correlation is considered where the permutation test of
lag-one products has p ≤ .02, tails elsewhere: correlated cycles are not exchangeable, which the likelihood of tails
takes them for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from core.metrology.cycle_process.heavy_tails import TAIL_DEGREES, tail_weights
from core.metrology.cycle_process.lag_correlation import CORRELATIONS, correlation_weights

CORRELATED = 0.02
"""Largest p of the lag-one products at which cycles are taken as correlated."""
_LARGEST = 1e-10
"""Axes of less than this share of the largest variance hold rounding alone."""


@dataclass(frozen=True, slots=True)
class CycleProcess:
    """Probabilities of the alternatives, which with that of independent Gaussian cycles add up to one.

    `tails` belong to Student's ν in `TAIL_DEGREES`, `correlations` to φ in `CORRELATIONS`.
    """

    tails: Float[np.ndarray, " t"]
    correlations: Float[np.ndarray, " c"]

    @property
    def independent_gaussian(self) -> float:
        """The probability that cycles are independent and Gaussian."""
        return max(1.0 - float(self.tails.sum() + self.correlations.sum()), 0.0)

    @property
    def lag_correlation(self) -> float:
        """The posterior mean of φ."""
        return float(self.correlations @ CORRELATIONS)

    def effective_cycles(self, cycles: float) -> float:
        """Return how many independent cycles determine the scatter as well: n (1 - φ²) / (1 + φ²), averaged over φ.

        References: M. S. Bartlett, J. R. Stat. Soc. 98 (1935) 536-543, doi:10.2307/2342284.
        """
        square = CORRELATIONS**2
        ratio = (1.0 - self.correlations.sum()) + self.correlations @ ((1.0 - square) / (1.0 + square))
        return float(min(max(cycles * float(ratio), 1.0), cycles))


def estimate_process(
    deviations: Sequence[Float[np.ndarray, "_ 3"]],
    cycles: Sequence[Int[np.ndarray, " _"] | None],
    correlated: bool,
) -> CycleProcess:
    """Return the process of a session's cycles.

    Parameters
    ----------
    deviations
        Of each pose's cycles from their mean, mm, scaled to equal variance where the instrument's noise differs.
    cycles
        The cycles' numbers, in order; None where the order is not known.
    correlated
        Whether correlation in time is considered, instead of tails.
    """
    tails, correlations = np.zeros(len(TAIL_DEGREES)), np.zeros(len(CORRELATIONS))
    axes = [main_axes(one) for one in deviations]
    if correlated:
        ordered = [(one, c) for one, c in zip(axes, cycles, strict=True) if c is not None]
        correlations = correlation_weights(ordered)
    else:
        tails = tail_weights(axes)
    return CycleProcess(tails, correlations)


def main_axes(deviations: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n d"]:
    """Return the components along the axes in which there is scatter."""
    values, vectors = np.linalg.eigh(deviations.T @ deviations)
    return np.asarray(deviations @ vectors[:, values > _LARGEST * values[-1]])
