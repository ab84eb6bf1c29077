"""Calibration from many views: estimators of a focus group, common fits, consistency of repeats, board symmetry."""

from core.calibration.multi_view.board_symmetry import (
    nearest_turn,
    quarter_turns,
    resolve_symmetry,
    symmetry_rotations,
    turned_cells,
)
from core.calibration.multi_view.bundle_adjustment import BundleAdjustment, bundle_adjust
from core.calibration.multi_view.correlated_residuals import VarianceInflation
from core.calibration.multi_view.covariance import error_factors
from core.calibration.multi_view.estimators import SEPARATE_CAMERAS, estimate_group
from core.calibration.multi_view.fitting import calibrate_views
from core.calibration.multi_view.group_estimate import CommonFit, GroupEstimate
from core.calibration.multi_view.linearisation import linearise
from core.calibration.multi_view.schur_blocks import in_target_frame, transformed
from core.calibration.multi_view.view_stack import (
    Placements,
    ViewStack,
    coordinates,
    evenly,
    moved,
    number_labels,
    stack_states,
    stack_views,
)

__all__ = [
    "SEPARATE_CAMERAS",
    "BundleAdjustment",
    "CommonFit",
    "GroupEstimate",
    "Placements",
    "VarianceInflation",
    "ViewStack",
    "bundle_adjust",
    "calibrate_views",
    "coordinates",
    "error_factors",
    "estimate_group",
    "evenly",
    "in_target_frame",
    "linearise",
    "moved",
    "nearest_turn",
    "number_labels",
    "quarter_turns",
    "resolve_symmetry",
    "stack_states",
    "stack_views",
    "symmetry_rotations",
    "transformed",
    "turned_cells",
]
