"""Rendered ChArUco boards are OpenCV's own: cell by cell as printed, and as its detector reads them."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from core.errors import InvalidTarget
from core.geometry.camera import Camera, undistort_points
from core.geometry.se3 import invert
from core.simulation import Light, Scene, random_pose, render
from core.simulation.renderer import render_levels
from core.targets.charuco.layout import charuco_layout
from core.targets.printed_pattern import pattern_of
from core.targets.specification import TargetSpec
from tests.support.image.opencv_boards import opencv_board

CAMERA = Camera(1800.0, 1820.0, 802.0, 595.0, k1=-0.2, k2=0.06, p1=5e-4)
SIZE = (1600, 1200)


def charuco(columns: int, rows: int, *, legacy: bool = False, dictionary: str = "DICT_6X6_250") -> TargetSpec:
    return TargetSpec("charuco", columns, rows, 20.0, 10.0, dictionary, legacy)


def white_at(target: TargetSpec, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    pattern = pattern_of(target, 1.0)
    return pattern.white[np.searchsorted(pattern.y_edges, y), np.searchsorted(pattern.x_edges, x)]


@pytest.mark.parametrize("legacy", [False, True])
@pytest.mark.parametrize(("columns", "rows"), [(4, 6), (5, 3), (6, 5)])
@pytest.mark.parametrize("dictionary", ["DICT_4X4_50", "DICT_6X6_250"])
def test_every_cell_is_as_opencv_prints_it(columns: int, rows: int, legacy: bool, dictionary: str) -> None:
    target = charuco(columns, rows, legacy=legacy, dictionary=dictionary)
    step = 96  # pixels a square: a whole number for the margins and for the cells of either dictionary
    image = opencv_board(target).generateImage(((columns + 1) * step, (rows + 1) * step))
    middles = (np.arange(0, max(image.shape), 2) + 1.0) / step * 20.0 - 20.0  # between pixels, off every line
    x, y = np.meshgrid(middles[: image.shape[1] // 2], middles[: image.shape[0] // 2])
    printed = cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_NEAREST) > 127
    np.testing.assert_array_equal(white_at(target, x, y) > 0.5, printed)


@pytest.mark.parametrize("legacy", [False, True])
@pytest.mark.parametrize("tilt", [pytest.param(0.0, marks=pytest.mark.slow), 40.0])
def test_opencv_reads_the_rendered_board(legacy: bool, tilt: float) -> None:
    target = charuco(6, 5, legacy=legacy)
    rng = np.random.default_rng(5)
    T = random_pose(target, CAMERA, SIZE, math.radians(tilt), 0.6, rng)
    scene = Scene(target, CAMERA, T, *SIZE, noise_levels=2.0, clutter=0.5, seed=3)
    detector = cv2.aruco.CharucoDetector(opencv_board(target))
    corners, ids, marker_corners, marker_ids = detector.detectBoard(render(scene))
    assert len(ids) == target.size
    assert len(marker_ids) == len(charuco_layout(target).marker_squares)
    # OpenCV's corners stand .03 to .1 px off; a board off by a cell's width would be 5 px off.
    assert np.abs(corners.reshape(-1, 2) - scene.points_px[ids.ravel()]).max() < 0.3
    assert len(marker_corners) == len(marker_ids)


def test_levels_of_markers_equal_supersampling() -> None:
    """Rays through 12 x 12 places a pixel, blurred and averaged: the way without any closed form."""
    target = charuco(4, 3)
    rng = np.random.default_rng(2)
    T = random_pose(target, CAMERA, SIZE, math.radians(35.0), 0.6, rng)
    scene = Scene(target, CAMERA, T, *SIZE, light=Light(0.0, 1.0))
    middle = np.rint(scene.points_px[5]).astype(int)
    window, halo, factor = 24, 7, 12
    places = (np.arange((2 * window + 2 * halo) * factor) + 0.5) / factor - window - halo - 0.5
    u, v = np.meshgrid(middle[0] + places, middle[1] + places)
    rays = np.column_stack(
        [undistort_points(np.column_stack([u.ravel(), v.ravel()]), CAMERA), np.ones(u.size)]
    )
    T_target_camera = invert(T)
    rays, origin = rays @ T_target_camera[:3, :3].T, T_target_camera[:3, 3]
    x, y = (origin - rays * (origin[2] / rays[:, 2])[:, None])[:, :2].T
    ink = white_at(target, x, y).reshape(u.shape)
    ink = cv2.GaussianBlur(ink, (0, 0), factor, borderType=cv2.BORDER_REPLICATE)
    size = len(places) // factor
    truth = ink.reshape(size, factor, size, factor).mean(axis=(1, 3))[halo:-halo, halo:-halo]
    found = render_levels(scene)[
        middle[1] - window : middle[1] + window, middle[0] - window : middle[0] + window
    ]
    assert truth.max() - truth.min() > 0.9
    # Rays fall on one side of an edge or the other: 1/12 px of an edge of slope .4 a pixel, at most.
    assert np.abs(found - truth).max() < 0.03
    assert abs(float(np.mean(found - truth))) < 1e-3


def test_what_cannot_be_printed_is_refused() -> None:
    for target in (TargetSpec("charuco", 4, 3, 20.0), TargetSpec("aprilgrid", 4, 3, 20.0)):
        with pytest.raises(InvalidTarget):
            pattern_of(target, 1.0)
