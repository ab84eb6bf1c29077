"""Printed targets: what they are, and finding them in an image."""

from core.targets.certificate import Certificate, CertificateUncertainty
from core.targets.charuco import (
    CharucoLayout,
    Markers,
    charuco_layout,
    find_by_lattice,
    marker_dictionary,
)
from core.targets.chessboard import Step, mark_diameter_mm, marked_squares, trace_detection
from core.targets.circles import ODD
from core.targets.detection import check_detectable, detect
from core.targets.failure_diagnosis import look_for
from core.targets.image_quality import assess_capture, with_tilt
from core.targets.markers import marker_codes
from core.targets.point_candidates import candidate_points
from core.targets.printed_pattern import DotPattern, RectilinearPattern, pattern_of
from core.targets.quality_result import CaptureQuality
from core.targets.shape_uncertainty import PRINT_KINDS, ShapeUncertainty
from core.targets.specification import GridPoints, Labelling, TargetSpec, target_of
from core.targets.target_fields import check_fields, spacing_mm

__all__ = [
    "ODD",
    "PRINT_KINDS",
    "CaptureQuality",
    "Certificate",
    "CertificateUncertainty",
    "CharucoLayout",
    "DotPattern",
    "GridPoints",
    "Labelling",
    "Markers",
    "RectilinearPattern",
    "ShapeUncertainty",
    "Step",
    "TargetSpec",
    "assess_capture",
    "candidate_points",
    "charuco_layout",
    "check_detectable",
    "check_fields",
    "detect",
    "find_by_lattice",
    "look_for",
    "mark_diameter_mm",
    "marked_squares",
    "marker_codes",
    "marker_dictionary",
    "pattern_of",
    "spacing_mm",
    "target_of",
    "trace_detection",
    "with_tilt",
]
