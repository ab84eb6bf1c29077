"""Steadiness of cycles: whether they are independent and identically distributed, and what moved where they are not."""

from core.metrology.steadiness.assessment import (
    MIN_CYCLES,
    NOT_STEADY,
    Attribution,
    PoseMotion,
    Steadiness,
    assess_steadiness,
)
from core.metrology.steadiness.cycle_grid import CycleGrid, PoseSeries, equal_scale
from core.metrology.steadiness.displaced_cycles import DisplacedCycle
from core.metrology.steadiness.local_level import SlowMotion, slow_motion
from core.metrology.steadiness.motion import ChangePoint, Trend
from core.metrology.steadiness.two_points import TwoPoints

__all__ = [
    "MIN_CYCLES",
    "NOT_STEADY",
    "Attribution",
    "ChangePoint",
    "CycleGrid",
    "DisplacedCycle",
    "PoseMotion",
    "PoseSeries",
    "SlowMotion",
    "Steadiness",
    "Trend",
    "TwoPoints",
    "assess_steadiness",
    "equal_scale",
    "slow_motion",
]
