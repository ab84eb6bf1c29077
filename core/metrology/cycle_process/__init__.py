"""How cycles scatter over time and in their tails, and what that does to the interval of a figure."""

from core.metrology.cycle_process.interval_shift import shift_of_rp, shift_of_three_sigma
from core.metrology.cycle_process.long_run import long_run_draws
from core.metrology.cycle_process.mean_of_cycles import MeanOfCycles, mean_of_cycles
from core.metrology.cycle_process.process import CORRELATED, CycleProcess, estimate_process

__all__ = [
    "CORRELATED",
    "CycleProcess",
    "MeanOfCycles",
    "estimate_process",
    "long_run_draws",
    "mean_of_cycles",
    "shift_of_rp",
    "shift_of_three_sigma",
]
