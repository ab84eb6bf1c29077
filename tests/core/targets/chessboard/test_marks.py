"""Marks that name a chessboard's origin: where they are, how they are read, and that they move no corner."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import cv2
import numpy as np
import pytest

from core.errors import InvalidTarget
from core.simulation import Scene
from core.targets import TargetSpec, detect
from core.targets.chessboard.fiducial_dots import dot_scores, marked_squares
from tests.support.simulation.renders import render
from tests.support.simulation.scenes import standard_scene, standard_target
from tests.support.targets.corner_errors import errors

Take = Callable[..., tuple[Scene, np.ndarray]]


@pytest.mark.parametrize("size", [(3, 3), (4, 3), (3, 9), (5, 3), (4, 4), (8, 6), (9, 6), (14, 10), (25, 18)])
def test_marks_are_an_l_with_a_white_elbow_near_the_middle(size: tuple[int, int]) -> None:
    columns, rows = size
    marks = marked_squares(TargetSpec("chessboard", columns, rows, 20.0))
    if columns < 4 or (columns, rows) == (4, 3):
        assert marks == ()
        with pytest.raises(InvalidTarget, match="no room"):
            render(dataclasses.replace(standard_scene(standard_target(*size), 1), marks=True))
        return
    (a, b), *others = marks
    assert (a + b) % 2 == 1
    assert others == [(a + 1, b), (a + 2, b), (a, b + 1)]
    assert all(0 <= i < columns - 1 and 0 <= j < rows - 1 for i, j in marks)
    middle = np.mean(marks, axis=0) + 0.5
    assert np.all(np.abs(middle - np.array([columns - 1, rows - 1]) / 2.0) <= 1.5)
    assert marked_squares(TargetSpec("circles", columns, rows, 20.0)) == ()


def test_marks_are_rendered_where_they_belong(take: Take) -> None:
    scene, plain = take(9, 6, seed=1, noise_levels=0.0)
    marked = render(dataclasses.replace(scene, marks=True))
    grid = scene.points_px.reshape(6, 9, 2)
    changed = np.abs(marked.astype(int) - plain) > 100
    places = {(2, 1): False, (3, 1): True, (4, 1): False, (2, 2): True}
    assert tuple(places) == marked_squares(scene.target)
    for j in range(5):
        for i in range(8):
            u, v = np.rint(grid[j : j + 2, i : i + 2].mean(axis=(0, 1))).astype(int)
            assert changed[v, u] == ((i, j) in places)
            if (i, j) in places:
                assert (marked[v, u] > 110) == places[i, j]
    # each a circle of .34 pitches: its share of the square
    square = cv2.contourArea(grid[[1, 1, 2, 2], [2, 5, 5, 2]].astype(np.float32)) / 3.0
    assert changed.sum() == pytest.approx(4.0 * np.pi * 0.17**2 * square, rel=0.15)


@pytest.mark.parametrize("size", [(9, 6), (8, 6), (6, 6), (14, 10)])
@pytest.mark.parametrize("seed", range(3))
def test_marks_identify_the_origin_of_any_board(take: Take, size: tuple[int, int], seed: int) -> None:
    scene, image = take(*size, seed=seed, max_roll_deg=180.0, marks=True)
    found = detect(image, scene.target)
    assert (found.labelling, found.warnings, len(found)) == ("absolute", (), scene.target.size)
    assert np.abs(errors(found, scene)).max() < 0.3


@pytest.mark.slow
def test_marks_move_no_corner(take: Take) -> None:
    """Errors on marked boards are those on plain ones, the corners of marked squares included."""
    squares: dict[bool, list[np.ndarray]] = {False: [], True: []}
    near: list[np.ndarray] = []
    for seed in range(6):
        scene, _ = take(25, 18, seed=seed, tilt_deg=10.0, clutter=0.0)
        for marks in (False, True):
            found = detect(render(dataclasses.replace(scene, marks=marks)), scene.target)
            error = errors(found, scene)
            squares[marks].append(np.mean(error**2))
            if marks:
                marked_corners = {
                    (i + a, j + b) for i, j in marked_squares(scene.target) for a in (0, 1) for b in (0, 1)
                }
                at = [(i, j) in marked_corners for i, j in zip(found.column, found.row, strict=True)]
                near.append(error[at])
    assert np.sqrt(np.mean(squares[True])) < 1.02 * np.sqrt(np.mean(squares[False]))
    corners = np.concatenate(near)
    usual = np.sqrt(np.mean(squares[False]))
    # 10 corners of 6 boards: their mean scatters by 1 / sqrt(60) of the noise
    assert len(corners) == 60
    assert np.all(np.abs(corners.mean(axis=0)) < 3.5 * usual / np.sqrt(60.0))
    assert np.sqrt(np.mean(corners**2)) < 1.35 * usual


@pytest.mark.parametrize("seed", range(3))
def test_scores_are_those_of_plain_numpy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    image = cv2.GaussianBlur(rng.integers(0, 256, (90, 110), dtype=np.uint8), (0, 0), 2.0)
    y, x = np.mgrid[0:5, 0:6].astype(float)
    grid = np.stack([12 + 15 * x + 2 * y, 8 + 14 * y - x], axis=2) + rng.normal(0.0, 0.4, (5, 6, 2))
    gap = rng.uniform(20.0, 60.0, (5, 6))
    grid[2, 3], gap[2, 3] = np.nan, np.nan
    scores = dot_scores(image, grid, gap, True)
    assert np.isnan(scores[1:3, 2:4]).all()

    def level(j: int, i: int, x: float, y: float) -> float:
        top = (1 - x) * grid[j, i] + x * grid[j, i + 1]
        low = (1 - x) * grid[j + 1, i] + x * grid[j + 1, i + 1]
        u, v = (1 - y) * top + y * low
        patch = cv2.remap(
            image.astype(np.float32),
            np.full((1, 1), u, np.float32),
            np.full((1, 1), v, np.float32),
            cv2.INTER_LINEAR,
        )
        return float(patch[0, 0])

    for j in range(4):
        for i in range(5):
            if np.isnan(scores[j, i]):
                continue
            steps = [(a, b) for b in (-1, 0, 1) for a in (-1, 0, 1)]
            middle = np.mean([level(j, i, 0.5 + 0.08 * a, 0.5 + 0.08 * b) for a, b in steps])
            ring = np.mean(
                [level(j, i, 0.5 + 0.31 * a, 0.5 + 0.31 * b) for a, b in steps if (a, b) != (0, 0)]
            )
            sign = 1.0 if (i + j) % 2 == 0 else -1.0
            contrast = gap[j : j + 2, i : i + 2].mean()
            corners = [level(j, i, 0.5 + a, 0.5 + b) for a in (-0.31, 0.31) for b in (-0.31, 0.31)]
            at_once = sign * (np.mean(corners) - level(j, i, 0.5, 0.5)) / contrast
            if at_once < 0.08:
                assert scores[j, i] == pytest.approx(at_once, abs=0.05)
                continue
            # cv2 interpolates in 32nds of a pixel
            assert scores[j, i] == pytest.approx(sign * (ring - middle) / contrast, abs=0.03)
