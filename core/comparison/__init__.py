"""Methods for comparison: Zhang, OpenCV on one image, Tsai, DLT, five points, lines, ArUco's marker and board, and the
paper's two variants.

Each takes grid points and returns a `MethodResult`, or raises an error of `core.errors`, which is its row's failure.
`compare_methods` returns the rows of all methods, ours among them; `compare_repeatability` their repeatability.
"""

from core.comparison.aruco import aruco_board, aruco_marker, central_marker, pose_of_points
from core.comparison.boby_saha import proposed
from core.comparison.dlt import dlt
from core.comparison.five_points import five_points
from core.comparison.lines import lines
from core.comparison.literal_variant import eight_solutions, literal_variant
from core.comparison.opencv import opencv_single_image, zhang
from core.comparison.repeatability import MethodPose, MethodRepeatability, compare_repeatability
from core.comparison.results import Failure, MethodResult, MethodRow
from core.comparison.runner import METHODS, compare_methods
from core.comparison.tsai import tsai

__all__ = [
    "METHODS",
    "Failure",
    "MethodPose",
    "MethodRepeatability",
    "MethodResult",
    "MethodRow",
    "aruco_board",
    "aruco_marker",
    "central_marker",
    "compare_methods",
    "compare_repeatability",
    "dlt",
    "eight_solutions",
    "five_points",
    "lines",
    "literal_variant",
    "opencv_single_image",
    "pose_of_points",
    "proposed",
    "tsai",
    "zhang",
]
