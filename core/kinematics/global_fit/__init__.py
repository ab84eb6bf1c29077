"""The fit of an arm to all poses at once: residuals, identifiability, robust fit, cross-validation, images."""

from core.kinematics.global_fit.fit import DEFAULT_SCATTER, FitResult, fit_unweighted, information_of, refine
from core.kinematics.global_fit.identifiability import (
    Conditioning,
    Gauge,
    conditioning,
    conditioning_of_chain,
    fix_gauge,
    scaled,
)
from core.kinematics.global_fit.image_linearisation import ImageObservations, linearise_images
from core.kinematics.global_fit.null_space import Unidentifiable, held_by_axes, unidentifiable
from core.kinematics.global_fit.residuals import Observations, linearised, observations_of, placed
from core.kinematics.global_fit.validation import (
    FOLDS,
    SAME_CONFIGURATION,
    HoldOutError,
    Validation,
    assign_folds,
    cross_validate,
    rms,
    validate,
)

__all__ = [
    "DEFAULT_SCATTER",
    "FOLDS",
    "SAME_CONFIGURATION",
    "Conditioning",
    "FitResult",
    "Gauge",
    "HoldOutError",
    "ImageObservations",
    "Observations",
    "Unidentifiable",
    "Validation",
    "assign_folds",
    "conditioning",
    "conditioning_of_chain",
    "cross_validate",
    "fit_unweighted",
    "fix_gauge",
    "held_by_axes",
    "information_of",
    "linearise_images",
    "linearised",
    "observations_of",
    "placed",
    "refine",
    "rms",
    "scaled",
    "unidentifiable",
    "validate",
]
