"""Chessboards whose squares of one colour run together at the corners: spread ink, and white that is cut off."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from core.errors import TargetNotFound
from core.geometry import so3_exp, transform, transform_points
from core.geometry.camera import Camera, project
from core.targets import TargetSpec, detect

BOARD = TargetSpec("chessboard", 9, 6, 20.0)
CAMERA = Camera(900.0, 900.0, 481.0, 357.0)
SIZE_PX = (960, 720)
FINE_PX = 40
"""Of the drawing, a square."""


def drawn(tilt_deg: float, turn: float, gain: float) -> tuple[np.ndarray, np.ndarray]:
    """Return a board in levels of its white, float, whose black grew by `gain` of the pitch, and its corners in px."""
    squares = np.indices((BOARD.rows + 1, BOARD.columns + 1)).sum(axis=0) % 2
    sheet = np.kron(squares, np.ones((FINE_PX, FINE_PX))).astype(np.uint8)
    sheet = np.pad(sheet, FINE_PX, constant_values=1)
    width = 2 * round(gain * FINE_PX) + 1
    sheet = cv2.erode(sheet, np.ones((width, width), np.uint8))
    mm = BOARD.pitch_mm / FINE_PX
    origin_mm = (0.5 - 2 * FINE_PX) * mm
    rotation = so3_exp(np.array([math.radians(tilt_deg), 0.0, 0.0])) @ so3_exp(np.array([0.0, 0.0, turn]))
    T = transform(rotation, np.array([0.0, 0.0, 330.0]) - rotation @ BOARD.points_target().mean(axis=0))
    over = 4
    finer = np.array([[over, 0.0, (over - 1) / 2], [0.0, over, (over - 1) / 2], [0.0, 0.0, 1.0]])
    H = finer @ CAMERA.matrix @ T[:3, [0, 1, 3]]
    H = H @ np.array([[mm, 0.0, origin_mm], [0.0, mm, origin_mm], [0.0, 0.0, 1.0]])
    large = cv2.warpPerspective(
        sheet.astype(np.float32), H, (over * SIZE_PX[0], over * SIZE_PX[1]), borderValue=1.0
    )
    image = cv2.resize(large, SIZE_PX, interpolation=cv2.INTER_AREA)
    return 0.1 + 0.9 * image, project(transform_points(T, BOARD.points_target()), CAMERA)


def photographed(light: np.ndarray, white_level: float, blur_px: float, seed: int) -> np.ndarray:
    levels = white_level * cv2.GaussianBlur(light, (0, 0), blur_px)
    levels += np.random.default_rng(seed).normal(0.0, 2.0, light.shape)
    return np.clip(np.rint(levels), 0, 255).astype(np.uint8)


def errors_px(image: np.ndarray, corners_px: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the error of each corner, and the uncertainty stated of it; the board may be read from either end."""
    points = detect(image, BOARD)
    index = points.row * BOARD.columns + points.column
    errors = [points.points_px - corners_px[i] for i in (index, BOARD.size - 1 - index)]
    return min(errors, key=lambda e: float(np.abs(e).max())), points.standard_uncertainty_px


@pytest.mark.parametrize("exposure", [2.0, 3.0, 4.0])
@pytest.mark.parametrize("blur_px", [0.8, 1.5])
def test_white_that_is_cut_off(exposure: float, blur_px: float) -> None:
    light, corners_px = drawn(25.0, 0.4, 0.0)
    errors, uncertainty = errors_px(photographed(light, 180.0 * exposure, blur_px, 1), corners_px)
    assert len(errors) == BOARD.size
    assert np.sqrt(np.mean(errors**2)) < 0.05
    assert np.sqrt(np.mean((errors / uncertainty[:, None]) ** 2)) < 1.5


@pytest.mark.parametrize(("gain", "blur_px"), [(0.025, 0.8), (0.025, 1.5), (0.05, 0.8)])
def test_ink_that_has_spread(gain: float, blur_px: float) -> None:
    light, corners_px = drawn(25.0, 0.4, gain)
    errors, uncertainty = errors_px(photographed(light, 180.0, blur_px, 2), corners_px)
    assert len(errors) == BOARD.size
    assert np.sqrt(np.mean(errors**2)) < 0.06
    assert np.sqrt(np.mean((errors / uncertainty[:, None]) ** 2)) < 1.5


@pytest.mark.parametrize("gain", [0.05, 0.075, 0.1, 0.15])
def test_ink_that_has_spread_too_far_is_refused_or_measured_rightly(gain: float) -> None:
    light, corners_px = drawn(25.0, 0.4, gain)
    try:
        errors, uncertainty = errors_px(photographed(light, 180.0, 0.8, 3), corners_px)
    except TargetNotFound:
        return
    assert np.sqrt(np.mean((errors / uncertainty[:, None]) ** 2)) < 2.0


@pytest.mark.parametrize("pixels", [1.0, 0.5])
@pytest.mark.parametrize(("gain", "threshold"), [(0.0, 60), (0.025, 110)])
def test_squares_that_a_threshold_makes_larger(gain: float, threshold: int, pixels: float) -> None:
    """They spread by a pixel or two, far in units of a blur that is not there, and little in squares."""
    light, corners_px = drawn(25.0, 0.4, gain)
    light = cv2.resize(light, None, fx=pixels, fy=pixels, interpolation=cv2.INTER_AREA)
    levels = photographed(light, 180.0, 1.5, 3)
    image = np.where(levels > threshold, 255, 0).astype(np.uint8)
    errors, uncertainty = errors_px(image, (corners_px + 0.5) * pixels - 0.5)
    assert len(errors) >= 0.9 * BOARD.size
    assert np.sqrt(np.mean(errors**2)) < 0.08
    assert np.sqrt(np.mean((errors / uncertainty[:, None]) ** 2)) < 1.5
