"""Draws of the long-run RP_l of one pose: the figure over draws of figure / long-run figure, by the process of the
cycles and the pose's own shape of scatter.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from core.metrology.cycle_process.interval_shift import ratio_draws
from core.metrology.cycle_process.process import CycleProcess, main_axes

_SEED = 5


def long_run_draws(
    process: CycleProcess, deviations: Float[np.ndarray, "n 3"], reading_mm: float, trials: int
) -> Float[np.ndarray, " t"]:
    """Return draws, mm, for n ≥ 2 cycles that scatter.

    Parameters
    ----------
    deviations
        Of the cycles from their mean, mm, scaled to equal variance where the instrument's noise differs.
    """
    ratios = ratio_draws(process, main_axes(deviations), trials)
    if len(ratios) < trials:
        ratios = np.random.default_rng([_SEED, trials]).choice(ratios, trials)
    return np.asarray(reading_mm / ratios)
