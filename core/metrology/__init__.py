"""Robot performance by ISO 9283:1998, from poses alone, each figure with its interval and its noise floor."""

from core.metrology.distances import (
    ApproachVariation,
    DistanceAssessment,
    assess_approaches,
    assess_distance,
)
from core.metrology.exclusions import Exclusion
from core.metrology.figures import FIGURE_NAMES, Figures
from core.metrology.iso9283 import (
    DistancePerformance,
    Drift,
    direction_variation,
    distance_performance,
    drift,
    pose_accuracy,
)
from core.metrology.poses import PoseCycles
from core.metrology.repeatability import PoseRepeatability, assess_repeatability
from core.metrology.uncertainty import Limits, Verdict

__all__ = [
    "FIGURE_NAMES",
    "ApproachVariation",
    "DistanceAssessment",
    "DistancePerformance",
    "Drift",
    "Exclusion",
    "Figures",
    "Limits",
    "PoseCycles",
    "PoseRepeatability",
    "Verdict",
    "assess_approaches",
    "assess_distance",
    "assess_repeatability",
    "direction_variation",
    "distance_performance",
    "drift",
    "pose_accuracy",
]
