"""Boards are OpenCV's, whatever size, layout and dictionary; impossible ones are refused."""

from __future__ import annotations

import numpy as np
import pytest

from core.errors import InvalidTarget
from core.targets.charuco.layout import charuco_layout
from core.targets.charuco.marker_agreement import has_enough_markers
from core.targets.markers import marker_codes
from core.targets.specification import TargetSpec
from tests.support.image.opencv_boards import opencv_board

BOARDS = [
    (columns, rows, legacy, dictionary)
    for columns, rows in ((4, 6), (5, 3), (6, 5), (7, 7))
    for legacy in (False, True)
    for dictionary in ("DICT_4X4_50", "DICT_6X6_250", "DICT_APRILTAG_36h11")
]


DICTIONARY = "DICT_5X5_250"


@pytest.mark.parametrize(("columns", "rows", "legacy", "dictionary"), BOARDS)
def test_markers_stand_where_opencv_puts_them(columns: int, rows: int, legacy: bool, dictionary: str) -> None:
    target = TargetSpec("charuco", columns, rows, 20.0, 12.0, dictionary, legacy)
    layout, board = charuco_layout(target), opencv_board(target)
    assert len(layout.marker_squares) == len(board.getIds())
    # OpenCV counts from the board's corner, we from grid point (0, 0), one square further in both ways.
    for marker, corners in zip(np.ravel(board.getIds()), board.getObjPoints(), strict=True):
        np.testing.assert_allclose(layout.marker_corners(int(marker)), corners - [20.0, 20.0, 0.0], atol=1e-5)


def test_a_marker_that_is_not_there() -> None:
    layout = charuco_layout(TargetSpec("charuco", 4, 6, 20.0, 12.0, "DICT_4X4_50"))
    for marker in (-1, 17):
        with pytest.raises(InvalidTarget, match="markers 0 to 16"):
            layout.marker_corners(marker)


@pytest.mark.parametrize(
    ("target", "words"),
    [
        (TargetSpec("chessboard", 4, 6, 20.0, 12.0, "DICT_4X4_50"), "no ChArUco"),
        (TargetSpec("charuco", 4, 6, 20.0, 12.0), "dictionary is required for ChArUco boards"),
        (TargetSpec("charuco", 4, 6, 20.0, 12.0, "4X4_50"), "Unknown marker dictionary"),
        (TargetSpec("charuco", 4, 6, 20.0, 12.0, "DICT_9X9_50"), "Unknown marker dictionary"),
        (TargetSpec("charuco", 4, 6, 20.0, None, "DICT_4X4_50"), "marker_mm"),
        (TargetSpec("charuco", 4, 6, 20.0, 20.0, "DICT_4X4_50"), "marker_mm"),
        (TargetSpec("charuco", 4, 6, 20.0, float("nan"), "DICT_4X4_50"), "marker_mm"),
        (TargetSpec("charuco", 14, 10, 20.0, 12.0, "DICT_4X4_50"), "82 markers"),
    ],
)
def test_impossible_boards_are_refused(target: TargetSpec, words: str) -> None:
    with pytest.raises(InvalidTarget, match=words):
        charuco_layout(target)


@pytest.mark.parametrize("legacy", [False, True])
@pytest.mark.parametrize("columns", [4, 5, 7, 8, 11])
def test_markers_place_a_board_where_no_wider_or_narrower_one_has_them(columns: int, legacy: bool) -> None:
    def squares_of(width: int, rows: int, is_legacy: bool) -> np.ndarray:
        target = TargetSpec("charuco", width, rows, 30.0, 20.0, DICTIONARY, legacy_layout=is_legacy)
        return charuco_layout(target).marker_squares

    layout = charuco_layout(TargetSpec("charuco", columns, 6, 30.0, 20.0, DICTIONARY, legacy_layout=legacy))
    others = [
        squares_of(width, rows, is_legacy)
        for width in range(3, 15)
        for rows in (9, 10)
        for is_legacy in (False, True)
        if width != columns
    ]
    rng, seen = np.random.default_rng(columns), set()
    for _ in range(300):
        first = rng.integers(0, 6)
        near = np.flatnonzero(np.isin(layout.marker_squares[:, 1], first + np.arange(rng.integers(1, 4))))
        markers = sorted(rng.choice(near, min(4, len(near)), replace=False).tolist())
        squares = layout.marker_squares[markers]
        fits = any(
            len(other) > markers[-1] and len(np.unique(other[markers] - squares, axis=0)) == 1
            for other in others
        )
        one_row = np.ptp(squares[:, 1]) == 0
        assert has_enough_markers(markers, layout, marker_codes(DICTIONARY)) == (
            len(markers) >= marker_codes(DICTIONARY).least_agreeing and not fits and not one_row
        )
        seen.add((int(np.ptp(squares[:, 1])), fits))
    assert {(0, True), (1, True), (1, False), (2, False)} <= seen
