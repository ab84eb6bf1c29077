"""Whether a board of dots is distinguished from a piece of a larger one."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from core.errors import TargetMismatch, TargetNotFound
from core.geometry import project, transform_points
from core.geometry.camera import Camera
from core.pipeline import _assign_points
from core.simulation import Light, Scene, random_pose
from core.targets import GridPoints, detect
from core.targets.circles.board_ends import cut_by_border, extends_beyond
from core.targets.circles.centres import FittedDots
from core.targets.specification import TargetSpec
from tests.support.simulation.renders import render

CAMERA = Camera(1000.0, 1000.0, 503.0, 396.0, k1=-0.15, k2=0.05)
DARK, BRIGHT = Light(), Light(black_level=205.0, white_level=30.0)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("light", [DARK, BRIGHT])
@pytest.mark.parametrize(
    ("board", "asked"),
    [
        (TargetSpec("circles", 11, 8, 20.0), TargetSpec("circles", 9, 8, 20.0)),
        (TargetSpec("circles", 11, 8, 20.0), TargetSpec("circles", 11, 5, 20.0)),
        (TargetSpec("asymmetric_circles", 5, 11, 12.0), TargetSpec("asymmetric_circles", 4, 11, 12.0)),
        (TargetSpec("asymmetric_circles", 5, 11, 12.0), TargetSpec("asymmetric_circles", 5, 7, 12.0)),
    ],
)
def test_pieces_of_larger_boards_go_on(board: TargetSpec, asked: TargetSpec, light: Light, seed: int) -> None:
    rng = np.random.default_rng([seed, 11])
    tilt = math.radians(rng.uniform(0.0, 45.0))
    T = random_pose(board, CAMERA, (1000, 800), tilt, math.pi, rng)
    scene = Scene(board, CAMERA, T, 1000, 800, noise_levels=3.0, clutter=1.0, light=light, seed=seed)
    image = render(scene)
    contrast = light.white_level - light.black_level
    grid = scene.points_px.reshape(board.rows, board.columns, 2)
    for target, is_piece in ((asked, True), (board, False)):
        row, column = (a.ravel() for a in np.mgrid[0 : target.rows, 0 : target.columns])
        few = rng.random(len(row)) < 0.7  # some were not found
        found = grid[row[few], column[few]]
        assert extends_beyond(image, target, column[few], row[few], found, contrast) is is_piece


def test_what_lies_next_to_the_sheet_is_no_dot() -> None:
    """A table as dark as the dots begins half a pitch from them."""
    board = TargetSpec("circles", 9, 6, 20.0)
    rng = np.random.default_rng(3)
    T = random_pose(board, CAMERA, (1000, 800), 0.4, math.pi, rng)
    scene = Scene(board, CAMERA, T, 1000, 800, quiet_zone=0.6, clutter=1.0, seed=3)
    grid = scene.grid_points
    for image in (render(scene), render(replace(scene, clutter=0.0))):
        assert not extends_beyond(image, board, grid.column, grid.row, scene.points_px, 175.0)


@pytest.mark.parametrize("light", [DARK, BRIGHT])
@pytest.mark.parametrize(
    ("board", "asked", "hidden"),
    [
        (TargetSpec("circles", 10, 8, 20.0), TargetSpec("circles", 10, 6, 20.0), 6),
        (TargetSpec("circles", 10, 8, 20.0), TargetSpec("circles", 10, 5, 20.0), 5),
        (TargetSpec("asymmetric_circles", 4, 11, 14.0), TargetSpec("asymmetric_circles", 4, 7, 14.0), 7),
        (TargetSpec("asymmetric_circles", 4, 11, 14.0), TargetSpec("asymmetric_circles", 4, 9, 14.0), 9),
    ],
)
def test_what_a_cable_over_a_row_leaves_is_no_smaller_board(
    board: TargetSpec, asked: TargetSpec, hidden: int, light: Light
) -> None:
    rng = np.random.default_rng(5)
    T = random_pose(board, CAMERA, (1000, 800), 0.4, math.pi, rng)
    image = render(Scene(board, CAMERA, T, 1000, 800, noise_levels=2.0, origin_dot=1.5, light=light))
    low, high = (hidden - 0.4) * board.pitch_mm, (hidden + 0.4) * board.pitch_mm
    strip = np.array([[-60, low, 0], [260, low, 0], [260, high, 0], [-60, high, 0]])
    mask = np.zeros(image.shape, np.float32)
    cv2.fillPoly(mask, [np.rint(project(transform_points(T, strip), CAMERA)).astype(np.int32)], 1.0)
    mask = cv2.GaussianBlur(mask, (0, 0), 1.0)
    covered = np.rint(image * (1 - mask) + 120 * mask).astype(np.uint8)
    with pytest.raises(TargetNotFound):
        detect(covered, asked)
    found = detect(covered, board)
    truth = project(transform_points(T, found.points_target), CAMERA)
    assert 0.8 * board.size <= len(found) <= board.size - board.columns
    assert float(np.max(np.abs(found.points_px - truth))) < 0.3


def test_of_two_boards_the_one_with_clearly_more_points_is_in_view() -> None:
    """All dots of the smaller one are found, and some of the larger one's are missing."""
    large, small = TargetSpec("circles", 10, 8, 20.0), TargetSpec("circles", 10, 6, 20.0)
    row, column = (a.ravel() for a in np.mgrid[0:8, 0:10])

    def found(target: TargetSpec, which: np.ndarray) -> GridPoints:
        points = 30.0 * np.stack([column[which], row[which]], axis=1) + 50.0
        return GridPoints(
            target, 500, 400, column[which], row[which], points, np.full(int(which.sum()), 0.02)
        )

    whole, most, as_many = found(small, row < 6), found(large, row != 6), found(large, row < 6)
    for finds in ([whole, most], [most, whole]):
        assigned = _assign_points(finds)
        assert [isinstance(find, TargetMismatch) for find in assigned] == [find is whole for find in finds]
    assert isinstance(_assign_points([whole, as_many])[1], TargetMismatch)


@pytest.mark.parametrize("turn_deg", [0.0, 35.0, 90.0, 200.0])
@pytest.mark.parametrize("small", [1.0, 0.6])
def test_dots_are_cut_whose_outlines_reach_the_border(turn_deg: float, small: float) -> None:
    """Ellipses that fill five by five places of a tilted, turned plane, the image's borders through some of them. A dot
    is fitted `small` where the border cuts it, and counts as large as the others."""
    a = math.radians(turn_deg)
    A = np.array([[math.cos(a), -math.sin(a)], [math.sin(a), math.cos(a)]]) @ np.diag([60.0, 25.0])
    y, x = (axis.ravel() for axis in np.mgrid[0:5, 0:5].astype(np.float64))
    ideal, radius, blur_px = np.column_stack([x, y]), 0.3, 1.5
    places = (ideal - 2.0) @ A.T
    half = radius * np.linalg.norm(A, axis=1)  # of the outlines' extents
    low = places.min(axis=0) + 0.7 * half
    height, width = (math.ceil(c) for c in (places.max(axis=0) - low + [0.5, 1.2] * half)[::-1])
    places = places - low
    far = np.array([width - 1.0, height - 1.0])
    reach = np.minimum(places, far - places) - half
    assert np.all(np.abs(reach - blur_px) > 0.1)  # clearly either
    cut = np.any(reach < blur_px, axis=1)
    assert 0 < np.count_nonzero(cut) < 25
    M = np.linalg.inv(radius**2 * A @ A.T)
    shapes = np.column_stack([places, np.tile([M[0, 0], M[0, 1], M[1, 1], blur_px], (25, 1))])
    shapes[cut, 2:5] /= small**2
    ones = np.ones(25)
    fitted = FittedDots(shapes, ones, np.tile(np.eye(2), (25, 1, 1)), ones, ones > 0.0)
    np.testing.assert_array_equal(cut_by_border(ideal, fitted, (height, width)), cut)
