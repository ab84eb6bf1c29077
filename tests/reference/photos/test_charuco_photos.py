"""ChArUco photographs that nobody here took: eight of robot_cal_tools, of 1600 x 1200 px, and OpenCV's choriginal.jpg.

OpenCV's own detector finds from 4 to 24 of the 24 corners in the eight, and from what it finds in all a focal length of
1361 px. choriginal.jpg has jagged edges without any blur, of which the refiner does not trust all corners.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from core import calibrate_points
from core.calibration import estimate_group
from core.comparison import compare_methods
from core.errors import FocalNotObservable
from core.targets import TargetSpec, detect
from core.targets.charuco.detector import find_by_lattice, find_by_markers
from core.targets.charuco.layout import charuco_layout
from core.targets.markers.dictionary import marker_codes

BOARD = TargetSpec("charuco", 4, 6, 36.195, 18.256, "DICT_6X6_250")
OPENCVS = TargetSpec("charuco", 4, 6, 40.0, 20.0, "DICT_6X6_250")
PHOTOS = [(f"robot_cal_tools/charuco/images/{k}.png", BOARD) for k in range(8)]
PHOTOS.append(("opencv_samples/choriginal.jpg", OPENCVS))


def photo(data_folder: Path, name: str) -> np.ndarray:
    image = cv2.imread(str(data_folder / name), cv2.IMREAD_GRAYSCALE)
    assert image is not None
    return image


def opencvs_corners(image: np.ndarray, target: TargetSpec) -> dict[int, np.ndarray]:
    """What cv2.aruco.CharucoDetector finds, by row * columns + column."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_6X6_250)
    board = cv2.aruco.CharucoBoard((5, 7), target.pitch_mm, float(target.marker_mm or 0.0), dictionary)
    corners, ids, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(image)
    return dict(zip(np.ravel(ids).tolist(), np.reshape(corners, (-1, 2)), strict=True))


@pytest.mark.parametrize(("name", "target"), PHOTOS)
def test_corners_are_opencvs_with_the_same_names(data_folder: Path, name: str, target: TargetSpec) -> None:
    """At least 19 of the 24, most often all, and never fewer than OpenCV by more than the five that its jagged or
    smeared images cost; where both have one it is the same within what cornerSubPix leaves open on these images."""
    image = photo(data_folder, name)
    found, theirs = detect(image, target), opencvs_corners(image, target)
    assert len(found) >= 19
    off = [
        np.linalg.norm(theirs[k] - point)
        for k, point in zip((found.row * 4 + found.column).tolist(), found.points_px, strict=True)
        if k in theirs
    ]
    assert len(off) >= min(len(theirs), len(found)) - 3
    assert np.median(off) < 0.4
    assert np.max(off) < 1.0


@pytest.mark.parametrize(("name", "target"), PHOTOS)
def test_both_ways_of_finding_agree(data_folder: Path, name: str, target: TargetSpec) -> None:
    """The lattice shows all 24 corners in every photograph; OpenCV's markers place as many as have one next to them."""
    image = np.require(photo(data_folder, name), requirements=["C", "W", "A"])
    layout, codes = charuco_layout(target), marker_codes("DICT_6X6_250")
    by_lattice = find_by_lattice(image, layout, codes).part
    by_markers = find_by_markers(image, layout, codes)
    assert by_lattice is not None
    assert by_markers is not None
    assert len(by_lattice) == 24
    assert len(by_lattice.markers) >= 12  # of 17; OpenCV's detector reads 6 to 17
    at = by_markers.row * 4 + by_markers.column
    assert len(at) >= 11
    off = np.linalg.norm(by_lattice.points_px[at] - by_markers.points_px, axis=1)
    assert np.median(off) < 2.5
    assert off.max() < 12.0  # of squares of 50 px and more, from markers half as wide


def test_all_eight_are_measured_and_determine_the_focal_length(data_folder: Path) -> None:
    """Half of the corners at least are asked for; .8 % is what its print and eight views leave open."""
    views = []
    for file in sorted((data_folder / "robot_cal_tools" / "charuco" / "images").glob("*.png")):
        views.append(detect(cv2.imread(str(file), cv2.IMREAD_GRAYSCALE), BOARD))
    assert len(views) == 8
    assert sum(len(points) for points in views) > 150
    (pooled,) = compare_methods(views, estimate_group(views, "pooled"), methods=["pooled"])
    assert pooled.failures == ()
    assert pooled.camera is not None
    np.testing.assert_allclose(pooled.camera.mean[:2], 1361.0, rtol=0.012)
    assert pooled.reprojection is not None
    assert pooled.reprojection.rms_px < 0.6


def test_single_photographs_are_better_than_the_naive_recipe_or_refused(data_folder: Path) -> None:
    """One-image cv2.calibrateCamera is off by 4.6 % in f (median over the eight, as the data's table has it)."""
    reference_px, naive = 1360.8, 0.046
    errors = []
    for name, target in PHOTOS[:8]:
        try:
            calibration = calibrate_points(detect(photo(data_folder, name), target))
        except FocalNotObservable:
            continue
        error = calibration.camera.fx_px - reference_px
        # 1 % in addition to the stated uncertainty, as for chessboards: the reference is no better.
        assert abs(error) < 4.0 * calibration.camera_standard_uncertainty[0] + 0.01 * reference_px
        errors.append(abs(error) / reference_px)
    assert len(errors) >= 3
    assert np.median(errors) < naive
