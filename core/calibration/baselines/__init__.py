"""The methods ours are compared with: Zhang, OpenCV on one image, Tsai, DLT, and ArUco's marker and board; and the
paper's two variants.

Each takes grid points and returns a `Baseline`, or raises a named failure of `core.errors`, which is its row's failure.
`compare_methods` makes the rows of all, ours among them; `core.metrology.methods` their repeatability.
"""

from core.calibration.baselines.aruco import aruco_board, aruco_marker, central_marker, pose_of_points
from core.calibration.baselines.comparison import METHODS, compare_methods
from core.calibration.baselines.dlt import dlt, dlt_spatial
from core.calibration.baselines.opencv import opencv_single_image, zhang
from core.calibration.baselines.proposed import proposed
from core.calibration.baselines.result import Baseline
from core.calibration.baselines.rows import CameraFigures, Failure, MethodRow
from core.calibration.baselines.tsai import tsai
from core.targets.charuco_markers import detect_markers

__all__ = [
    "METHODS",
    "Baseline",
    "CameraFigures",
    "Failure",
    "MethodRow",
    "aruco_board",
    "aruco_marker",
    "central_marker",
    "compare_methods",
    "detect_markers",
    "dlt",
    "dlt_spatial",
    "opencv_single_image",
    "pose_of_points",
    "proposed",
    "tsai",
    "zhang",
]
