"""Shape of a printed target: estimation from many views, deformation measures, inspection of the print."""

from core.calibration.target_shape.deformation import Deformation, Measure, TargetShape
from core.calibration.target_shape.departures import LENS, PRINT_SCALE, PRINT_SHAPE, ShapePrior
from core.calibration.target_shape.estimation import estimate_target_shape
from core.calibration.target_shape.marginal_poses import MarginalPoses, marginalise_shape
from core.calibration.target_shape.print_inspection import (
    MIN_CHECK_DIRECTIONS,
    PrintCheck,
    PrintedShape,
    PrintFinding,
    check_print,
)
from core.calibration.target_shape.rule_readings import RuleReading, check_asked

__all__ = [
    "LENS",
    "MIN_CHECK_DIRECTIONS",
    "PRINT_SCALE",
    "PRINT_SHAPE",
    "Deformation",
    "MarginalPoses",
    "Measure",
    "PrintCheck",
    "PrintFinding",
    "PrintedShape",
    "RuleReading",
    "ShapePrior",
    "TargetShape",
    "check_asked",
    "check_print",
    "estimate_target_shape",
    "marginalise_shape",
]
