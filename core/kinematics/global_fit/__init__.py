"""The fit of an arm to all poses at once: residuals, identifiability, robust fit, cross-validation."""

from core.kinematics.global_fit.blocks import Blocking, blocks_of
from core.kinematics.global_fit.fit import DEFAULT_SCATTER, FitResult, fit_unweighted, information_of, refine
from core.kinematics.global_fit.identifiability import Gauge, fix_gauge
from core.kinematics.global_fit.joint_configurations import SAME_CONFIGURATION, configurations
from core.kinematics.global_fit.nominal_frames import fit_frames
from core.kinematics.global_fit.null_space import Unidentifiable, held_by_axes, unidentifiable
from core.kinematics.global_fit.observability import Conditioning, conditioning, conditioning_of_chain, scaled
from core.kinematics.global_fit.placement import placed
from core.kinematics.global_fit.residuals import (
    Observations,
    linearised,
    observations_of,
    whitened,
    whitener,
)
from core.kinematics.global_fit.validation import (
    FOLDS,
    BlockErrors,
    HoldOutError,
    Validation,
    assign_folds,
    cross_validate,
    frame_errors,
    rms,
    validate,
)

__all__ = [
    "DEFAULT_SCATTER",
    "FOLDS",
    "SAME_CONFIGURATION",
    "BlockErrors",
    "Blocking",
    "Conditioning",
    "FitResult",
    "Gauge",
    "HoldOutError",
    "Observations",
    "Unidentifiable",
    "Validation",
    "assign_folds",
    "blocks_of",
    "conditioning",
    "conditioning_of_chain",
    "configurations",
    "cross_validate",
    "fit_frames",
    "fit_unweighted",
    "fix_gauge",
    "frame_errors",
    "held_by_axes",
    "information_of",
    "linearised",
    "observations_of",
    "placed",
    "refine",
    "rms",
    "scaled",
    "unidentifiable",
    "validate",
    "whitened",
    "whitener",
]
