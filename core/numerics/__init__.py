"""Estimation in general: least squares, normal equations with shared unknowns, variance components, quantiles."""

from core.numerics.covariance_mixture import (
    SampleCovariance,
    estimate_components,
    first_component_alone,
    log_likelihood,
)
from core.numerics.least_median import best_subset
from core.numerics.least_squares import (
    CAUCHY_C,
    EXPECTED_SCALE,
    MEDIAN_LENGTH,
    NEGLIGIBLE_STEP,
    OBSERVATIONS_PER_PARAMETER,
    PLAIN_ITERATIONS,
    REJECTION,
    ROBUST_STEP_TOLERANCE,
    STEP_TOLERANCE,
    Evaluate,
    Fit,
    Prior,
    fit,
)
from core.numerics.normal_equations import covariance_of, damped_step, scaled_inverse
from core.numerics.order_statistics import NORMAL_95, median, quantiles
from core.numerics.schur import (
    KNOWN,
    SHARED_CAMERA,
    ArrowheadEquations,
    Sharing,
    arrow,
    free_focal,
    shared_camera,
)
from core.numerics.variance_components import (
    SMALLEST,
    LinearResiduals,
    Variances,
    estimate_variances,
    weights,
)

__all__ = [
    "CAUCHY_C",
    "EXPECTED_SCALE",
    "KNOWN",
    "MEDIAN_LENGTH",
    "NEGLIGIBLE_STEP",
    "NORMAL_95",
    "OBSERVATIONS_PER_PARAMETER",
    "PLAIN_ITERATIONS",
    "REJECTION",
    "ROBUST_STEP_TOLERANCE",
    "SHARED_CAMERA",
    "SMALLEST",
    "STEP_TOLERANCE",
    "ArrowheadEquations",
    "Evaluate",
    "Fit",
    "LinearResiduals",
    "Prior",
    "SampleCovariance",
    "Sharing",
    "Variances",
    "arrow",
    "best_subset",
    "covariance_of",
    "damped_step",
    "estimate_components",
    "estimate_variances",
    "first_component_alone",
    "fit",
    "free_focal",
    "log_likelihood",
    "median",
    "quantiles",
    "scaled_inverse",
    "shared_camera",
    "weights",
]
