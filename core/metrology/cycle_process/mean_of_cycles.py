"""How uncertain the mean of n cycles is that follow a process, against S / √n of independent ones.

The mean of cycles that correlate by φ scatters √((1 + φ) / (1 - φ)) times as much for large n, while their S is too
small: both are simulated, with the process drawn from its posterior. The mean's standard uncertainty is S / √n times

    √(n E x̄² / E S²),

and it has the degrees of freedom at which t times that is the 95 % quantile of |x̄| √n / S.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtri, stdtrit

from core.metrology.cycle_process.heavy_tails import TAIL_DEGREES
from core.metrology.cycle_process.interval_shift import unit_series
from core.metrology.cycle_process.process import CycleProcess
from core.metrology.rp_distribution import CONFIDENCE

_DRAWS = 4000
_MOST_CYCLES = 500
"""Of longer runs: there the mean's uncertainty has come to its limit."""
_LEAST_FREEDOM, _MOST_FREEDOM = 1.0, 1e4


@dataclass(frozen=True, slots=True)
class MeanOfCycles:
    """The standard uncertainty of a mean over S / √n, and its degrees of freedom."""

    inflation: float
    degrees_of_freedom: float


def mean_of_cycles(process: CycleProcess | None, cycles: int) -> MeanOfCycles:
    """Return how uncertain the mean of n ≥ 2 cycles is; tails do not matter to it, correlation does."""
    if process is None or not process.correlations.any():
        return MeanOfCycles(1.0, cycles - 1.0)
    return _of_correlated(tuple(process.correlations.tolist()), min(cycles, _MOST_CYCLES))


@lru_cache(maxsize=256)
def _of_correlated(correlations: tuple[float, ...], cycles: int) -> MeanOfCycles:
    process = CycleProcess(np.zeros(len(TAIL_DEGREES)), np.array(correlations))
    series = unit_series(process, cycles, _DRAWS)
    means, variances = series.mean(axis=1).ravel(), series.var(axis=1, ddof=1).ravel()
    inflation = float(np.sqrt(cycles * np.mean(means**2) / np.mean(variances)))
    quantile = float(np.quantile(np.abs(means) * np.sqrt(cycles / variances), CONFIDENCE)) / inflation
    return MeanOfCycles(inflation, _freedom(quantile))


def _freedom(quantile: float) -> float:
    """Return the degrees of freedom whose t has this two-sided quantile at `CONFIDENCE`."""
    confident = 0.5 + 0.5 * CONFIDENCE

    def excess(freedom: float) -> float:
        return float(stdtrit(freedom, confident)) - quantile

    if quantile <= float(ndtri(confident)) or excess(_MOST_FREEDOM) > 0.0:
        return _MOST_FREEDOM
    return (
        _LEAST_FREEDOM
        if excess(_LEAST_FREEDOM) < 0.0
        else float(brentq(excess, _LEAST_FREEDOM, _MOST_FREEDOM))
    )
