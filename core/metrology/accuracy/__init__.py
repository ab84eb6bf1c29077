"""What a robot is off at its poses: deviations in tied frames, AP with intervals, and AP over blocks of cycles."""

from core.metrology.accuracy.deviation_parts import DeviationParts, DeviationSpread
from core.metrology.accuracy.deviations import (
    EstimatedDeviation,
    MeanNoise,
    PosesOfStations,
    TiedDeviations,
    estimate_deviations,
)
from core.metrology.accuracy.frame_tie import FrameTie, poses_that_decide
from core.metrology.accuracy.over_cycles import AccuracyDrift, accuracy_drift
from core.metrology.accuracy.pose_accuracy import (
    CommandedPoint,
    HeldOutDeviation,
    PoseAccuracy,
    tied_accuracy,
)

__all__ = [
    "AccuracyDrift",
    "CommandedPoint",
    "DeviationParts",
    "DeviationSpread",
    "EstimatedDeviation",
    "FrameTie",
    "HeldOutDeviation",
    "MeanNoise",
    "PoseAccuracy",
    "PosesOfStations",
    "TiedDeviations",
    "accuracy_drift",
    "estimate_deviations",
    "poses_that_decide",
    "tied_accuracy",
]
