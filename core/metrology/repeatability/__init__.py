"""Repeatability at one pose: RP, its interval and noise floor, outliers, and the verdict about what the scatter is."""

from core.metrology.repeatability.assessment import PoseRepeatability, assess_repeatability
from core.metrology.repeatability.intervals import (
    IntervalEstimate,
    assess_radial,
    assess_three_sigma,
    noise_only_lengths,
)
from core.metrology.repeatability.label_shifts import find_label_shifts
from core.metrology.repeatability.misplaced_visits import find_misplaced_visits
from core.metrology.repeatability.outliers import CLUSTERS
from core.metrology.repeatability.statistics import cycle_statistics
from core.metrology.repeatability.verdict import FEW_CYCLES, MAX_INSTRUMENT_SHARE, Verdict

__all__ = [
    "CLUSTERS",
    "FEW_CYCLES",
    "MAX_INSTRUMENT_SHARE",
    "IntervalEstimate",
    "PoseRepeatability",
    "Verdict",
    "assess_radial",
    "assess_repeatability",
    "assess_three_sigma",
    "cycle_statistics",
    "find_label_shifts",
    "find_misplaced_visits",
    "noise_only_lengths",
]
