"""Larger chessboards that something lies across: what is left on one side of it is no smaller board."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from core.errors import OriginUnknown, TargetMismatch, TargetNotFound
from core.geometry import project, transform_points
from core.simulation import Scene
from core.targets import TargetSpec, detect

Take = Callable[..., tuple[Scene, np.ndarray]]
STRIPS = {"cable": (0.3, 0.75), "ruler": (0.1, 0.9), "wide": (-0.1, 1.1), "two squares": (-0.7, 1.3)}
BLUR_PX = 1.0


def in_image(scene: Scene, squares: np.ndarray) -> np.ndarray:
    """The image of places on the board's plane, in squares from its first inner corner on."""
    places = np.column_stack([squares * scene.target.pitch_mm, np.zeros(len(squares))])
    return np.asarray(project(transform_points(scene.T_camera_target, places), scene.camera))


def crossed(scene: Scene, image: np.ndarray, quad: np.ndarray, level: int) -> np.ndarray:
    """The image with something plain in front of a quadrangle of the board's plane, in squares."""
    mask = np.zeros(image.shape, np.float32)
    corners = np.rint(in_image(scene, quad) * 16).astype(np.int32)
    cv2.fillPoly(mask, [corners], 1.0, shift=4)
    mask = cv2.GaussianBlur(mask, (0, 0), BLUR_PX)
    return np.rint(image * (1 - mask) + level * mask).astype(np.uint8)


def across_rows(low: float, high: float, columns: int) -> np.ndarray:
    return np.array([[-4, low], [columns + 3, low], [columns + 3, high], [-4, high]])


@pytest.mark.parametrize("level", [8, 120, 215])
@pytest.mark.parametrize(
    ("shown", "asked", "strip"),
    [
        *(((9, 8), (9, 6), strip) for strip in ("cable", "ruler", "wide")),
        *(((7, 7), (7, 5), strip) for strip in ("cable", "ruler", "wide")),
        *(((9, 9), (9, 6), strip) for strip in STRIPS),
    ],
)
def test_what_is_left_of_a_larger_board_is_no_smaller_one(
    take: Take, shown: tuple[int, int], asked: tuple[int, int], strip: str, level: int
) -> None:
    scene, image = take(*shown, seed=3)
    first = shown[1] - asked[1] - 1  # the strip hides the squares after this line
    low, high = STRIPS[strip]
    hidden = crossed(scene, image, across_rows(first - 1 + low, first - 1 + high, shown[0]), level)
    for rows in range(asked[1] - 1, shown[1]):
        with pytest.raises((TargetMismatch, TargetNotFound, OriginUnknown)):
            detect(hidden, TargetSpec("chessboard", shown[0], rows, 20.0))


@pytest.mark.parametrize(("pitch", "phase"), [(1.0, 0.5), (1.0, 0.3), (2.0, 0.0), (0.5, 0.0), (1.4, 0.2)])
def test_boards_on_tiles_of_another_pitch_or_phase_end_where_they_end(
    take: Take, pitch: float, phase: float
) -> None:
    """The tiles are in the board's plane and parallel to it; its margin is a square wide."""
    scene, image = take(9, 6, seed=2)
    columns, rows = 9, 6
    outside = np.array([[-2, -2], [columns + 1, -2], [columns + 1, rows + 1], [-2, rows + 1]])
    v, u = (a.ravel().astype(np.float64) for a in np.mgrid[: image.shape[0], : image.shape[1]])
    places = scene.target.points_target()[:, :2] / scene.target.pitch_mm
    plane, _ = cv2.findHomography(scene.points_px, places)
    x, y = cv2.perspectiveTransform(np.stack([u, v], axis=1)[None], plane)[0].T
    is_bright = (np.floor(x / pitch - phase) + np.floor(y / pitch - phase)) % 2 == 0
    tiles = cv2.GaussianBlur(np.where(is_bright, 200.0, 40.0).reshape(image.shape), (0, 0), BLUR_PX)
    board = np.zeros(image.shape, np.uint8)
    cv2.fillPoly(board, [np.rint(in_image(scene, outside)).astype(np.int32)], 1)
    found = detect(np.where(board, image, np.rint(tiles).astype(np.uint8)), scene.target)
    assert len(found) == scene.target.size
