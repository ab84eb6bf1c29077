"""Chessboards: detection, orientation, fiducial dots and partial views."""

from core.targets.chessboard.detector import Step, boards_in_view, detect_chessboard, trace_detection
from core.targets.chessboard.fiducial_dots import mark_diameter_mm, marked_squares

__all__ = [
    "Step",
    "boards_in_view",
    "detect_chessboard",
    "mark_diameter_mm",
    "marked_squares",
    "trace_detection",
]
