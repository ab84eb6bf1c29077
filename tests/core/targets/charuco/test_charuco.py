"""ChArUco boards: named by their markers, refined by their corners, whatever is misread or out of view."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest

from core.errors import TargetMirrored, TargetMismatch, TargetNotFound
from core.geometry.camera import project
from core.geometry.se3 import transform_points
from core.simulation import Scene
from core.targets import detect
from core.targets.charuco.isolated_markers import consistent_markers
from core.targets.charuco.layout import charuco_layout
from core.targets.specification import TargetSpec
from tests.support.image.tilted_sheets import Shot, errors, take, truth_px
from tests.support.targets.board_markers import detect_markers

BOARD = TargetSpec("charuco", 7, 5, 22.0, 15.4, "DICT_5X5_100")
MARKED = charuco_layout(BOARD).marker_squares.tolist()


@pytest.fixture(scope="module")
def shot() -> Shot:
    return take(BOARD)


@pytest.mark.parametrize(
    ("columns", "rows", "legacy", "turn"),
    [(7, 5, False, 0.3), (7, 5, True, 2.0), (6, 5, False, -1.4), (6, 5, True, 3.1), (4, 4, False, 1.5)],
)
def test_every_corner_is_found_and_named_whichever_way_the_board_lies(
    columns: int, rows: int, legacy: bool, turn: float
) -> None:
    """Boards that look the same when turned (4 x 4) are identified by their markers, old layout and new."""
    target = TargetSpec("charuco", columns, rows, 22.0, 15.4, "DICT_5X5_100", legacy)
    count, rms, stated = errors(*take(target, turn=turn))
    assert count == target.size
    assert rms < 0.012
    assert 0.6 < stated < 1.5


def test_markers_of_every_other_row_leave_the_layout_open(shot: Shot) -> None:
    """They are the same in both layouts, one column displaced: only an end shows which is printed."""
    taken, image = shot
    half = covered(taken, image, [(i - 0.85, j - 0.85, i - 0.15, j - 0.15) for i, j in MARKED if j % 2])
    assert len(detect(half, BOARD)) == BOARD.size
    legacy = dataclasses.replace(BOARD, legacy_layout=True)
    with pytest.raises(TargetMismatch):
        detect(half, legacy)
    middle = covered(taken, half, [(-1.2, -1.2, 0.5, 5.2), (5.5, -1.2, 7.2, 5.2)])
    for stated in (BOARD, legacy):
        with pytest.raises(TargetNotFound, match="legacy_layout") as refused:
            detect(middle, stated)
        assert "which of the two layouts" in refused.value.advice
    right = covered(taken, half, [(-1.2, -1.2, 0.5, 5.2)])
    assert len(detect(right, BOARD)) == 30
    with pytest.raises((TargetMismatch, TargetNotFound)):
        detect(right, legacy)
    both = covered(taken, image, [(-1.2, -1.2, 0.5, 5.2), (5.5, -1.2, 7.2, 5.2)])
    found = detect(both, BOARD)
    assert len(found) == 25
    assert np.abs(found.points_px - truth_px(taken, found)).max() < 0.1


def covered(taken: Scene, image: np.ndarray, boxes: list[tuple[float, float, float, float]]) -> np.ndarray:
    """The image with grey boxes on the board, given in squares from its first grid point."""
    image = image.copy()
    for x0, y0, x1, y1 in boxes:
        corners = np.array([[x0, y0, 0], [x1, y0, 0], [x1, y1, 0], [x0, y1, 0]]) * taken.target.pitch_mm
        places = project(transform_points(taken.T_camera_target, corners), taken.camera)
        cv2.fillConvexPoly(image, np.rint(places).astype(np.int32), 128)
    return image


def test_depth_makes_no_difference(shot: Shot) -> None:
    _, image = shot
    found = detect(image, BOARD)
    deep = detect(image.astype(np.uint16) * 257, BOARD)
    np.testing.assert_array_equal(found.column, deep.column)
    np.testing.assert_allclose(found.points_px, deep.points_px, atol=2e-3)


def test_the_markers_come_along(shot: Shot) -> None:
    """Refined as OpenCV's detector refines its own, which stops within a tenth of a px of the start or so."""
    _, image = shot
    found = detect(image, BOARD)
    assert found.markers_px is not None
    assert sorted(found.markers_px) == list(range(24))
    same = detect_markers(image, BOARD)
    off = np.array([corners - same[marker] for marker, corners in found.markers_px.items()])
    assert np.sqrt(np.mean(off**2)) < 0.05
    assert np.abs(off).max() < 0.3


def test_what_is_hidden_costs_points_and_is_said(shot: Shot) -> None:
    taken, image = shot
    hidden = image.copy()
    hidden[:, 820:] = 120
    found = detect(hidden, BOARD)
    assert 18 <= len(found) < 35
    assert np.abs(found.points_px - truth_px(taken, found)).max() < 0.1
    assert [w.code for w in found.warnings] == ["points_missing"]
    hidden[:, 480:] = 120
    with pytest.raises(TargetNotFound):
        detect(hidden, BOARD)


def test_a_board_partly_out_of_the_image_keeps_its_names() -> None:
    taken, image = take(BOARD, offset_mm=95.0)
    found = detect(image, BOARD)
    assert 18 <= len(found) < 35
    assert np.abs(found.points_px - truth_px(taken, found)).max() < 0.1


def test_no_board_and_the_mirrored_one(shot: Shot) -> None:
    _, image = shot
    with pytest.raises(TargetNotFound, match="No ChArUco board"):
        detect(np.full((400, 300), 128, np.uint8), BOARD)
    with pytest.raises(TargetMirrored, match="24 of"):
        detect(np.ascontiguousarray(image[:, ::-1]), BOARD)


def test_another_board_is_not_taken_for_it(shot: Shot) -> None:
    """Same dictionary, other size: the ids stand elsewhere, so that no two markers fit together."""
    _, image = shot
    with pytest.raises(TargetMismatch, match="24 markers of DICT_5X5_100 are in view, but only 8"):
        detect(image, TargetSpec("charuco", 8, 6, 22.0, 15.4, "DICT_5X5_100"))
    with pytest.raises(TargetNotFound, match="DICT_4X4_100"):
        detect(image, TargetSpec("charuco", 7, 5, 22.0, 15.4, "DICT_4X4_100"))


def test_two_boards_with_the_same_markers_are_a_mismatch(shot: Shot) -> None:
    _, image = shot
    with pytest.raises(TargetMismatch, match="more than once"):
        detect(np.hstack([image, image]), BOARD)


def test_misread_markers_do_not_fit(shot: Shot) -> None:
    _, image = shot
    layout = charuco_layout(BOARD)
    markers = detect_markers(image, BOARD)
    assert consistent_markers(markers, layout) == markers
    swapped = {**markers, 3: markers[20], 20: markers[3]}
    swapped[11] = markers[11] + [200.0, 0.0]
    assert sorted(consistent_markers(swapped, layout)) == sorted(set(markers) - {3, 20, 11})
    assert consistent_markers({5: markers[5]}, layout) == {}
    assert consistent_markers({}, layout) == {}
