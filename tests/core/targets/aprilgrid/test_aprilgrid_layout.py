"""AprilGrids as Kalibr prints them: which tag stands where, which way up, and where the target frame begins."""

from __future__ import annotations

import math
import re

import cv2
import numpy as np
import pytest

from core.errors import InvalidTarget
from core.targets.aprilgrid.layout import DICTIONARY, aprilgrid_layout
from core.targets.markers.dictionary import marker_bits
from core.targets.printed_pattern import RectilinearPattern, pattern_of
from core.targets.specification import TargetSpec

GRID = TargetSpec("aprilgrid", 4, 3, 26.0, 20.0)

# The family's first and last codes as its authors publish them: cells row by row, upright, white where a bit is 1.
FIRST, SECOND, LAST = 0xD5D628584, 0xD97F18B49, 0xE83BE4B73


def white_at(target: TargetSpec, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    pattern = pattern_of(target, 1.0)
    assert isinstance(pattern, RectilinearPattern)
    return pattern.white[np.searchsorted(pattern.y_edges, y), np.searchsorted(pattern.x_edges, x)]


@pytest.mark.parametrize(("number", "code"), [(0, FIRST), (1, SECOND), (586, LAST)])
def test_codes_are_the_family_s_own(number: int, code: int) -> None:
    upright = [code >> (35 - k) & 1 for k in range(36)]
    np.testing.assert_array_equal(marker_bits(DICTIONARY)[number].ravel(), upright[::-1])


def test_ids_begin_at_kalibr_s_origin_the_upper_right_of_the_sheet_upside_down() -> None:
    """Kalibr has x along the ids, y along their rows, and z toward the eye; turned about y, z goes into the board."""
    layout = aprilgrid_layout(GRID)
    assert layout.tag_places[0].tolist() == [3, 0]
    assert layout.tag_places[3].tolist() == [0, 0]
    assert layout.tag_places[4].tolist() == [3, 1]
    assert layout.tag_places[11].tolist() == [0, 2]
    # the corners of tag 5 (Kalibr's second of the second row), from its upper left clockwise
    np.testing.assert_allclose(
        layout.tag_corners(5), [[52, 26, 0], [72, 26, 0], [72, 46, 0], [52, 46, 0]], atol=1e-12
    )
    # Kalibr's lower left corner of tag k, as its documentation numbers the points
    width = 3 * 26.0 + 20.0
    for tag in range(12):
        kalibr = np.array([26.0 * (tag % 4), 26.0 * (tag // 4), 0.0])
        x, y, z = layout.tag_corners(tag)[1]
        np.testing.assert_allclose([width - x, y, -z], kalibr, atol=1e-12)
    with pytest.raises(InvalidTarget):
        layout.tag_corners(12)


def test_places_do_not_depend_on_how_many_rows_a_sheet_is_said_to_have() -> None:
    higher = aprilgrid_layout(TargetSpec("aprilgrid", 4, 7, 26.0, 20.0))
    np.testing.assert_array_equal(higher.tag_places[:12], aprilgrid_layout(GRID).tag_places)


def test_grid_points_are_the_tags_corners() -> None:
    assert (GRID.grid_columns, GRID.grid_rows, GRID.size) == (8, 6, 48)
    points = GRID.points_target().reshape(6, 8, 3)
    np.testing.assert_allclose(points[0, :, 0], [0, 20, 26, 46, 52, 72, 78, 98])
    np.testing.assert_allclose(points[:, 0, 1], [0, 20, 26, 46, 52, 72])
    assert not points[:, :, 2].any()
    layout = aprilgrid_layout(GRID)
    for tag, (i, j) in enumerate(layout.tag_places):
        column, row = 2 * i + np.array([0, 1, 1, 0]), 2 * j + np.array([0, 0, 1, 1])
        np.testing.assert_allclose(layout.tag_corners(tag), points[row, column])
        np.testing.assert_allclose(layout.tag_corners(tag), GRID.points_target(column, row))


def test_the_sheet_by_hand() -> None:
    """Every tag's cells, its border of two, the white gaps, and the black squares also beyond the outermost tags."""
    layout = aprilgrid_layout(GRID)
    middles = np.arange(10) * 2.0 + 1.0
    for tag, (i, j) in enumerate(layout.tag_places):
        seen = white_at(GRID, *np.meshgrid(26.0 * i + middles, 26.0 * j + middles))
        expected = np.pad(marker_bits(DICTIONARY)[tag], 2)
        np.testing.assert_array_equal(seen > 0.5, expected)
    crossings = 26.0 * np.arange(5) - 3.0, 26.0 * np.arange(4) - 3.0
    assert not white_at(GRID, *np.meshgrid(*crossings)).any()
    assert white_at(GRID, *np.meshgrid(crossings[0], 26.0 * np.arange(3) + 10.0)).all()
    assert white_at(GRID, *np.meshgrid(26.0 * np.arange(4) + 10.0, crossings[1])).all()


def test_opencv_reads_the_sheet() -> None:
    """OpenCV's images of this family stand on their heads, as the sheet does in the target frame."""
    step = 8  # px for a mm
    x = (np.arange(-10 * step, 108 * step) + 0.5) / step
    y = (np.arange(-10 * step, 82 * step) + 0.5) / step
    sheet = (255 * white_at(GRID, *np.meshgrid(x, y))).astype(np.uint8)
    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = 2
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    sheet = cv2.GaussianBlur(sheet, (0, 0), 2.0)  # corners that touch are one thing to it otherwise
    corners, ids, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(sheet)
    assert sorted(ids.ravel().tolist()) == list(range(12))
    layout = aprilgrid_layout(GRID)
    for number, four in zip(ids.ravel(), corners, strict=True):
        seen_mm = (four.reshape(4, 2) + 0.5) / step - 10.0
        assert np.abs(seen_mm - layout.tag_corners(int(number))[:, :2]).max() < 0.5


@pytest.mark.parametrize(
    ("target", "message"),
    [
        (TargetSpec("chessboard", 4, 3, 26.0, 20.0), "no AprilTags"),
        (TargetSpec("aprilgrid", 4, 3, 26.0), "marker_mm is required"),
        (TargetSpec("aprilgrid", 4, 3, 26.0, 26.0), "marker_mm must be less than its pitch_mm of 26, got 26"),
        (TargetSpec("aprilgrid", 4, 3, 26.0, 30.0), "marker_mm must be less than its pitch_mm of 26, got 30"),
        (TargetSpec("aprilgrid", 4, 3, 26.0, -1.0), "marker_mm must be a positive length"),
        (TargetSpec("aprilgrid", 4, 3, 26.0, math.nan), "marker_mm must be a positive length"),
        (TargetSpec("aprilgrid", 4, 3, 26.0, math.inf), "marker_mm must be a positive length"),
        (TargetSpec("aprilgrid", 4, 3, 26.0, 25.5), "gaps"),
        (TargetSpec("aprilgrid", 4, 3, 26.0, 10.0), "gaps"),
        (TargetSpec("aprilgrid", 4, 3, 26.0, 20.0, "DICT_6X6_250"), "36h11"),
        (TargetSpec("aprilgrid", 4, 3, 26.0, 20.0, "DICT_APRILTAG_16h5"), "36h11"),
        (TargetSpec("aprilgrid", 4, 3, 26.0, 20.0, "DICT_9X9_50"), "Unknown marker dictionary"),
        (TargetSpec("aprilgrid", 4, 3, 26.0, 20.0, "tag36h11"), "Unknown marker dictionary"),
        (TargetSpec("aprilgrid", 49, 12, 26.0, 20.0), "588 tags"),
    ],
)
def test_what_cannot_be_printed_is_refused(target: TargetSpec, message: str) -> None:
    with pytest.raises(InvalidTarget, match=message) as refused:
        aprilgrid_layout(target)
    assert refused.value.advice


@pytest.mark.parametrize("tag_mm", [20.0, 24.23, 7.77, 0.111])
def test_the_pitches_advised_are_taken_and_none_beyond(tag_mm: float) -> None:
    with pytest.raises(InvalidTarget) as refused:
        aprilgrid_layout(TargetSpec("aprilgrid", 4, 3, 1.01 * tag_mm, tag_mm))
    advised = re.search(r"it is ([\d.]+) to ([\d.]+) mm", refused.value.advice or "")
    assert advised is not None
    least, most = (float(figure) for figure in advised.groups())
    for pitch_mm in (least, most):
        aprilgrid_layout(TargetSpec("aprilgrid", 4, 3, pitch_mm, tag_mm))
    for pitch_mm in (0.999 * least, 1.001 * most):
        with pytest.raises(InvalidTarget):
            aprilgrid_layout(TargetSpec("aprilgrid", 4, 3, pitch_mm, tag_mm))


@pytest.mark.parametrize("dictionary", ["DICT_APRILTAG_36h11", "DICT_APRILTAG_36H11"])
def test_the_family_s_own_dictionary_may_be_named(dictionary: str) -> None:
    layout = aprilgrid_layout(TargetSpec("aprilgrid", 4, 3, 26.0, 20.0, dictionary))
    assert layout.gap_mm == pytest.approx(6.0)
