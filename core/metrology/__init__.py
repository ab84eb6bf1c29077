"""Robot performance by ISO 9283:1998, from poses alone, each figure with its interval and its noise floor."""

from core.metrology.acceptance import RULE, Acceptance, Decision, Reading, decide, repeatability_reading
from core.metrology.accuracy import (
    EstimatedDeviation,
    HeldOutDeviation,
    PoseAccuracy,
    TiedDeviations,
    estimate_deviations,
    tied_accuracy,
)
from core.metrology.cycle_process import CORRELATED, CycleProcess, estimate_process
from core.metrology.distances import ApproachVariation, DistanceAssessment, assess_approaches, assess_distance
from core.metrology.intervals import IntervalEstimate, assess_radial, assess_three_sigma, noise_only_lengths
from core.metrology.iso9283 import (
    DistancePerformance,
    Drift,
    direction_variation,
    distance_performance,
    drift,
    pose_accuracy,
    position_repeatability,
)
from core.metrology.outliers import Outlier
from core.metrology.pose_cycles import COMPONENTS, PerComponent, PoseCycles, angles_from_vectors
from core.metrology.qualification import KnownLength, LengthError, Qualification, qualify
from core.metrology.repeatability import PoseRepeatability, assess_repeatability
from core.metrology.rp_distribution import (
    CONFIDENCE,
    eigenvalues,
    long_run_rp,
    mean_length,
    rp_sampling_distribution,
)
from core.metrology.steadiness import (
    MIN_CYCLES,
    NOT_STEADY,
    Attribution,
    ChangePoint,
    CycleGrid,
    PoseMotion,
    PoseSeries,
    Steadiness,
    Trend,
    TwoPoints,
    assess_steadiness,
    equal_scale,
)
from core.metrology.test_cube import CYCLES, TEST_PLANES, VISITS, TestCube
from core.metrology.verdict import Verdict, VerdictLimits

__all__ = [
    "COMPONENTS",
    "CONFIDENCE",
    "CORRELATED",
    "CYCLES",
    "MIN_CYCLES",
    "NOT_STEADY",
    "RULE",
    "TEST_PLANES",
    "VISITS",
    "Acceptance",
    "ApproachVariation",
    "Attribution",
    "ChangePoint",
    "CycleGrid",
    "CycleProcess",
    "Decision",
    "DistanceAssessment",
    "DistancePerformance",
    "Drift",
    "EstimatedDeviation",
    "HeldOutDeviation",
    "IntervalEstimate",
    "KnownLength",
    "LengthError",
    "Outlier",
    "PerComponent",
    "PoseAccuracy",
    "PoseCycles",
    "PoseMotion",
    "PoseRepeatability",
    "PoseSeries",
    "Qualification",
    "Reading",
    "Steadiness",
    "TestCube",
    "TiedDeviations",
    "Trend",
    "TwoPoints",
    "Verdict",
    "VerdictLimits",
    "angles_from_vectors",
    "assess_approaches",
    "assess_distance",
    "assess_radial",
    "assess_repeatability",
    "assess_steadiness",
    "assess_three_sigma",
    "decide",
    "direction_variation",
    "distance_performance",
    "drift",
    "eigenvalues",
    "equal_scale",
    "estimate_deviations",
    "estimate_process",
    "long_run_rp",
    "mean_length",
    "noise_only_lengths",
    "pose_accuracy",
    "position_repeatability",
    "qualify",
    "repeatability_reading",
    "rp_sampling_distribution",
    "tied_accuracy",
]
