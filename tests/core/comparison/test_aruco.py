"""Poses from markers: exact on exact corners, never the mirrored pose, and far noisier than the board's."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from core.comparison import (
    aruco_board,
    aruco_marker,
    central_marker,
    pose_of_points,
)
from core.errors import DegenerateGeometry, InvalidArgument, InvalidTarget
from core.geometry.camera import Camera, project
from core.geometry.se3 import so3_exp, transform, transform_points
from core.simulation import Scene
from core.targets.charuco.layout import charuco_layout
from core.targets.specification import GridPoints, TargetSpec
from tests.support.sessions.comparisons import reprojection_of
from tests.support.simulation.renders import render
from tests.support.targets.board_markers import detect_markers

CAMERA = Camera(1800.0, 1810.0, 802.0, 595.0, k1=-0.1, k2=0.04, p1=2e-4)
TARGET = TargetSpec("charuco", 7, 5, 25.0, 18.0, "DICT_5X5_100")
LAYOUT = charuco_layout(TARGET)


def pose(tilt_deg: float, depth_mm: float = 420.0) -> np.ndarray:
    R = so3_exp(math.radians(tilt_deg) * np.array([0.8, 0.6, 0.0])) @ so3_exp(np.array([0.0, 0.0, 0.3]))
    return transform(R, np.array([5.0, -4.0, depth_mm]) - R @ TARGET.points_target().mean(axis=0))


def board_points(T: np.ndarray) -> GridPoints:
    row, column = (a.ravel() for a in np.mgrid[0:5, 0:7])
    px = project(transform_points(T, TARGET.points_target()), CAMERA)
    return GridPoints(TARGET, 1600, 1200, column, row, px, np.full(35, 0.05))


def board_markers(T: np.ndarray) -> dict[int, np.ndarray]:
    return {
        marker: project(transform_points(T, LAYOUT.marker_corners(marker)), CAMERA)
        for marker in range(len(LAYOUT.marker_squares))
    }


def test_the_central_marker_is_in_the_middle() -> None:
    corners = LAYOUT.marker_corners(central_marker(LAYOUT))
    middle = TARGET.points_target().mean(axis=0)
    assert np.linalg.norm(corners.mean(axis=0) - middle) < 1.5 * TARGET.pitch_mm


@pytest.mark.parametrize("tilt", [20.0, 50.0])
def test_exact_corners_give_the_pose(tilt: float) -> None:
    T = pose(tilt)
    for marker in (0, central_marker(LAYOUT), len(LAYOUT.marker_squares) - 1):
        corners = LAYOUT.marker_corners(marker)
        found = aruco_marker(project(transform_points(T, corners), CAMERA), corners, CAMERA)
        # OpenCV undoes distortion by five fixed steps: 1e-3 px, which a small marker turns into hundredths of a mm.
        np.testing.assert_allclose(found.T_camera_target[0][:3, :3], T[:3, :3], atol=1e-3)
        np.testing.assert_allclose(found.T_camera_target[0][:3, 3], T[:3, 3], atol=0.2)
        assert reprojection_of(found).max_px < 0.01
        assert found.method == "aruco_marker"
    board = aruco_board(board_markers(T), LAYOUT, CAMERA)
    np.testing.assert_allclose(board.T_camera_target[0], T, atol=1e-3)
    points = pose_of_points("zhang", TARGET.points_target(), board_points(T).points_px, CAMERA)
    np.testing.assert_allclose(points.T_camera_target[0], T, atol=1e-3)
    assert (board.method, points.method) == ("aruco_board", "zhang")


def test_a_marker_seen_from_afar_may_be_its_mirror_image_and_says_so() -> None:
    corners = LAYOUT.marker_corners(central_marker(LAYOUT))
    rng = np.random.default_rng(1)
    exact = project(transform_points(pose(8.0, 3000.0), corners), CAMERA)
    codes = [
        [w.code for w in aruco_marker(exact + rng.normal(0.0, 0.1, (4, 2)), corners, CAMERA).warnings]
        for _ in range(20)
    ]
    assert codes.count(["pose_ambiguous"]) > 10


def test_a_marker_is_far_noisier_than_the_board() -> None:
    """Depth and tilt of a marker a tenth of the board's size; the theory is in the ratio of the two covariances."""
    T, sigma, rng = pose(30.0), 0.05, np.random.default_rng(2)
    corners = LAYOUT.marker_corners(central_marker(LAYOUT))
    exact_marker, exact_board = project(transform_points(T, corners), CAMERA), board_markers(T)
    marker, board = [], []
    for _ in range(100):
        markers = {k: px + rng.normal(0.0, sigma, (4, 2)) for k, px in exact_board.items()}
        board.append(aruco_board(markers, LAYOUT, CAMERA).T_camera_target[0])
        noisy = exact_marker + rng.normal(0.0, sigma, (4, 2))
        marker.append(aruco_marker(noisy, corners, CAMERA).T_camera_target[0])
    spread_marker, spread_board = (np.std(np.array(Ts)[:, 2, 3]) for Ts in (marker, board))
    # √24 in number and more than three in extent, of which depth takes the product at least.
    assert spread_marker > 8.0 * spread_board


def test_markers_of_a_rendered_board_are_found_where_they_are() -> None:
    T = pose(25.0)
    image = render(Scene(TARGET, CAMERA, T, 1600, 1200, noise_levels=2.0))
    for view in (image, image.astype(np.uint16) * 257):
        found = detect_markers(view, TARGET)
        assert sorted(found) == list(range(len(LAYOUT.marker_squares)))
        truth = [project(transform_points(T, LAYOUT.marker_corners(k)), CAMERA) for k in found]
        assert np.abs(np.array(list(found.values())) - truth).max() < 0.5
    marker = central_marker(LAYOUT)
    posed = aruco_marker(found[marker], LAYOUT.marker_corners(marker), CAMERA)
    assert np.linalg.norm(posed.T_camera_target[0][:3, 3] - T[:3, 3]) < 10.0
    assert detect_markers(np.full((400, 300), 128, np.uint8), TARGET) == {}


def test_what_cannot_be_used_is_refused() -> None:
    corners = LAYOUT.marker_corners(3)
    px = project(transform_points(pose(20.0), corners), CAMERA)
    with pytest.raises(InvalidArgument, match="finite"):
        aruco_marker(np.full((4, 2), np.nan), corners, CAMERA)
    for wrong in (corners[[0, 2, 1, 3]], corners * [1.0, 2.0, 1.0], np.zeros((4, 3))):
        with pytest.raises(InvalidArgument, match="square"):
            aruco_marker(px, wrong, CAMERA)
    with pytest.raises(InvalidTarget):
        detect_markers(np.zeros((10, 10), np.uint8), TargetSpec("chessboard", 7, 5, 25.0))
    board = board_markers(pose(20.0))
    with pytest.raises(DegenerateGeometry, match="two markers"):
        aruco_board({3: board[3]}, LAYOUT, CAMERA)
    with pytest.raises(InvalidTarget, match="markers 0 to 23"):
        aruco_board({**board, 24: board[3]}, LAYOUT, CAMERA)
    with pytest.raises(InvalidArgument):
        aruco_board({**board, 3: np.full((4, 2), np.nan)}, LAYOUT, CAMERA)
    with pytest.raises(InvalidArgument):
        aruco_board(board, LAYOUT, dataclasses.replace(CAMERA, fx_px=math.nan))
    points = board_points(pose(20.0))
    with pytest.raises(DegenerateGeometry, match="at least 6"):
        pose_of_points("zhang", points.points_target[:5], points.points_px[:5], CAMERA)
