"""Draws of the long-run RP_l of one pose, of which 95 % lie within the interval of the figure.

Their shape is that of draws of figure / long-run figure, by the process of the cycles and the pose's own shape of
scatter; their ends are the interval's, which knows more: where tails may be heavy, a figure of few cycles says less of
the long-run figure than the cycles do.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from core.metrology.cycle_process.interval_shift import ratio_draws
from core.metrology.cycle_process.process import CycleProcess, main_axes
from core.metrology.rp_distribution import CONFIDENCE

_SEED = 5
_LEAST = 1e-6
"""Of the upper end: what a lower end of 0 counts as."""


def long_run_draws(
    process: CycleProcess,
    deviations: Float[np.ndarray, "n 3"],
    interval_mm: tuple[float, float],
    trials: int,
) -> Float[np.ndarray, " t"]:
    """Return draws, mm, for n ≥ 2 cycles that scatter.

    Parameters
    ----------
    deviations
        Of the cycles from their mean, mm, scaled to equal variance where the instrument's noise differs.
    interval_mm
        Of the figure, above 0, at `CONFIDENCE`.
    """
    logs = -np.log(ratio_draws(process, main_axes(deviations), trials))
    if len(logs) < trials:
        logs = np.random.default_rng([_SEED, trials]).choice(logs, trials)
    tail = (1.0 - CONFIDENCE) / 2.0
    low, high = np.quantile(logs, [tail, 1.0 - tail])
    first, last = np.log(np.maximum(interval_mm, _LEAST * interval_mm[1]))
    return np.asarray(np.exp(first + (last - first) * (logs - low) / max(high - low, np.finfo(float).tiny)))
