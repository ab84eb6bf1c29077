"""ChArUco boards partly hidden: points are lost, not correctness; and boards that are not the one asked for."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import cv2
import numpy as np
import pytest

from core import calibrate_points
from core.errors import TargetMirrored, TargetMismatch, TargetNotFound
from core.geometry.se3 import invert
from core.simulation import Scene
from core.targets import detect
from core.targets.charuco.detector import find_by_lattice, find_by_markers
from core.targets.charuco.layout import charuco_layout
from core.targets.markers.dictionary import marker_codes
from core.targets.specification import TargetSpec
from tests.support.image.tilted_sheets import CAMERA, Shot, take

BOARD = TargetSpec("charuco", 11, 7, 15.0, 11.0, "DICT_5X5_100")


@pytest.fixture(scope="module")
def shot() -> Shot:
    return take(BOARD, tilt_deg=32.0, seed=4, camera=dataclasses.replace(CAMERA, k1=-0.12))


def off(taken: Scene, image: np.ndarray) -> np.ndarray:
    """Errors (px) of all grid points, NaN where not found, and (last) their stated uncertainties."""
    found = detect(image, taken.target)
    off = np.full((taken.target.size, 3), np.nan)
    index = found.row * taken.target.columns + found.column
    off[index, :2] = found.points_px - taken.points_px[index]
    off[index, 2] = found.standard_uncertainty_px
    return off


def hand(image: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Four fingers and a palm, from the left."""
    covered, height = image.copy(), points[:, 1].mean()
    for finger in range(4):
        tip = (int(points[:, 0].mean() - 10 * finger), int(height - 60 + 45 * finger))
        cv2.line(covered, (0, int(height)), tip, 150, 38, cv2.LINE_AA)
    cv2.circle(covered, (int(points[:, 0].min() + 30), int(height)), 100, 140, -1, cv2.LINE_AA)
    return cv2.GaussianBlur(covered, (0, 0), 1.0) * (covered != image) + image * (covered == image)


def cable(image: np.ndarray, points: np.ndarray) -> np.ndarray:
    """A thick dark cable right across, so that the board falls into two."""
    covered = image.copy()
    u, v = points.mean(axis=0)
    path = np.array([[u - 260, 0], [u - 40, v - 60], [u + 40, v + 60], [u + 200, 960]]).astype(np.int32)
    cv2.polylines(covered, [path], False, 35, 46, cv2.LINE_AA)
    return covered


def reflection(image: np.ndarray, points: np.ndarray) -> np.ndarray:
    """A lamp's image that saturates a third of the board, with an edge some 20 px wide."""
    u, v = np.meshgrid(np.arange(1280), np.arange(960))
    middle, reach = points.mean(axis=0) + np.array([80.0, -20.0]), 0.2 * np.ptp(points[:, 0])
    beyond = np.hypot(u - middle[0], v - middle[1]) - reach
    return np.clip(image + 400.0 / (1.0 + np.exp(np.clip(beyond / 5.0, -50.0, 50.0))), 0, 255).astype(
        np.uint8
    )


def sheet(image: np.ndarray, points: np.ndarray) -> np.ndarray:
    """White paper over a third of the board, askew."""
    covered = image.copy()
    low, high = points.min(axis=0), points.max(axis=0)
    box = np.array([[0.66, -0.3], [1.4, -0.3], [1.4, 1.3], [0.6, 1.3]]) * (high - low) + low
    cv2.fillConvexPoly(covered, np.rint(box).astype(np.int32), 205)
    return covered


@pytest.mark.parametrize("cover", [hand, cable, reflection, sheet])
def test_what_is_in_front_costs_points_not_correctness(
    shot: Shot, cover: Callable[[np.ndarray, np.ndarray], np.ndarray]
) -> None:
    """Corners are lost, and said to be; the others are where they were, within their noise."""
    taken, image = shot
    before, after = off(taken, image), off(taken, cover(image, taken.points_px))
    assert np.isfinite(before).all()
    left = np.isfinite(after[:, 0])
    assert 0.4 * BOARD.size < left.sum() < 0.97 * BOARD.size
    stated = after[left, :2] / after[left, 2:]
    assert np.abs(stated).max() < 6.0
    assert np.sqrt(np.mean(stated**2)) < 1.5
    clear = left & (np.abs(after[:, :2] - before[:, :2]).max(axis=1) < 0.02)
    assert clear.sum() > 0.95 * left.sum()
    rms = np.sqrt(np.nanmean(after[left, :2] ** 2))
    assert rms < 1.25 * np.sqrt(np.mean(before[left, :2] ** 2))


def test_both_sides_of_a_cable_are_joined(shot: Shot) -> None:
    taken, image = shot
    columns = np.flatnonzero(np.isfinite(off(taken, cable(image, taken.points_px))[:, 0])) % BOARD.columns
    assert columns.min() == 0
    assert columns.max() == BOARD.columns - 1


def window(taken: Scene, image: np.ndarray, columns: slice, rows: slice, margin_px: int = 22) -> np.ndarray:
    """Hide all but some of the board's corners, the squares between them, and so much next to them."""
    grid = taken.points_px.reshape(BOARD.rows, BOARD.columns, 2)[rows, columns]
    outline = np.concatenate([grid[0], grid[:, -1], grid[-1, ::-1], grid[::-1, 0]])
    mask = np.zeros(image.shape, np.uint8)
    cv2.fillPoly(mask, [np.rint(outline).astype(np.int32)], 255)
    mask = cv2.dilate(mask, np.ones((2 * margin_px + 1, 2 * margin_px + 1), np.uint8))
    return np.where(mask > 0, image, 128).astype(np.uint8)


def test_the_least_part_that_is_measured(shot: Shot) -> None:
    """Three by three corners with the squares around them will do, for a pose with a known lens; with two markers and
    little else they might be anything's."""
    taken, image = shot
    found = detect(window(taken, image, slice(4, 7), slice(2, 5), 70), BOARD)
    assert 8 <= len(found) <= 25
    truth = taken.points_px[found.row * BOARD.columns + found.column]
    assert np.abs(found.points_px - truth).max() < 0.1
    assert [w.code for w in found.warnings] == ["points_missing"]
    calibration = calibrate_points(found)
    off_mm = invert(taken.T_camera_target)[:3, 3] - calibration.pose.position_mm
    assert np.all(np.abs(off_mm) < 5.0 * np.sqrt(np.diag(calibration.pose.covariance))[:3])
    with pytest.raises(TargetNotFound, match="2 of the ChArUco board's markers"):
        detect(window(taken, image, slice(4, 7), slice(2, 5)), BOARD)


def test_markers_of_one_row_do_not_name_corners(shot: Shot) -> None:
    """They are arranged in the same way on boards of other widths."""
    taken, image = shot
    with pytest.raises(TargetNotFound):
        detect(window(taken, image, slice(0, 11), slice(2, 4)), BOARD)


def test_both_ways_find_the_same_board(shot: Shot) -> None:
    taken, image = shot
    layout, codes = charuco_layout(BOARD), marker_codes("DICT_5X5_100")
    by_lattice = find_by_lattice(image, layout, codes).part
    by_markers = find_by_markers(image, layout, codes)
    assert by_lattice is not None
    assert by_markers is not None
    assert len(by_lattice) == len(by_markers) == BOARD.size
    for part in (by_lattice, by_markers):
        np.testing.assert_array_equal(part.row * BOARD.columns + part.column, np.arange(BOARD.size))
        assert np.abs(part.points_px - taken.points_px).max() < 1.5
        assert sorted(part.markers) == list(range(len(layout.marker_squares)))


@pytest.mark.parametrize(("columns", "rows"), [(10, 7), (12, 7), (9, 7), (11, 6), (11, 5), (11, 8), (11, 9)])
def test_a_board_of_another_size_is_named(shot: Shot, columns: int, rows: int) -> None:
    """More columns or fewer: the ids stand elsewhere. More rows or fewer: the ids are the same, the ends are not."""
    _, image = shot
    asked = dataclasses.replace(BOARD, columns=columns, rows=rows)
    with pytest.raises(TargetMismatch, match=f"{columns} x {rows}") as error:
        detect(image, asked)
    assert "columns and rows" in str(error.value.advice)


def test_a_board_of_the_other_layout_is_named(shot: Shot) -> None:
    _, image = shot
    with pytest.raises(TargetMismatch) as error:
        detect(image, dataclasses.replace(BOARD, legacy_layout=True))
    assert "legacy_layout" in str(error.value.advice)


def test_a_mirrored_part_is_named_as_such(shot: Shot) -> None:
    taken, image = shot
    with pytest.raises(TargetMirrored) as error:
        detect(np.ascontiguousarray(sheet(image, taken.points_px)[::-1]), BOARD)
    assert "mirror" in str(error.value.advice)


def test_a_small_image_of_the_board_next_to_it_does_not_count(shot: Shot) -> None:
    taken, image = shot
    both = image.copy()
    small = cv2.resize(image[100:860, 200:1080], None, fx=0.2, fy=0.2, interpolation=cv2.INTER_AREA)
    both[: small.shape[0], : small.shape[1]] = small
    assert np.nanmax(np.abs(off(taken, both)[:, :2])) < 0.1
