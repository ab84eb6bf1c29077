"""The methods ours are compared with: Zhang, OpenCV on one image, Tsai, DLT, and ArUco's marker and board; and the
paper's two variants.

Each takes grid points and returns a `Baseline`, or raises a named failure of `core.errors`, which is its row's failure.
`compare_calibrations` makes the rows of all that calibrate.
"""

from core.calibration.baselines.aruco import aruco_board, aruco_marker, central_marker, detect_markers
from core.calibration.baselines.comparison import (
    CALIBRATION_METHODS,
    Failure,
    MethodRow,
    compare_calibrations,
)
from core.calibration.baselines.dlt import dlt, dlt_spatial
from core.calibration.baselines.opencv import opencv_single_image, zhang
from core.calibration.baselines.proposed import proposed
from core.calibration.baselines.result import Baseline
from core.calibration.baselines.tsai import tsai

__all__ = [
    "CALIBRATION_METHODS",
    "Baseline",
    "Failure",
    "MethodRow",
    "aruco_board",
    "aruco_marker",
    "central_marker",
    "compare_calibrations",
    "detect_markers",
    "dlt",
    "dlt_spatial",
    "opencv_single_image",
    "proposed",
    "tsai",
    "zhang",
]
