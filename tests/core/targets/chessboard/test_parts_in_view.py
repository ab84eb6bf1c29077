"""Chessboards of which a part is in view, marked and plain ones; mirrored prints, things in front, several at once."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from core.errors import OriginUnknown, TargetMirrored, TargetMismatch, TargetNotFound
from core.simulation import Scene
from core.targets import TargetSpec, detect
from tests.support.targets.corner_errors import errors

Take = Callable[..., tuple[Scene, np.ndarray]]
Window = tuple[int, int, int, int]


def window(scene: Scene, left: float, top: float, right: float, bottom: float) -> Window:
    """A part of the image, its borders given as shares of the grid points' bounding box."""
    low, high = scene.points_px.min(axis=0), scene.points_px.max(axis=0)
    x0, y0 = np.rint(low + np.array([left, top]) * (high - low)).astype(int)
    x1, y1 = np.rint(low + np.array([right, bottom]) * (high - low)).astype(int)
    return max(int(x0), 0), max(int(y0), 0), min(int(x1), scene.width_px), min(int(y1), scene.height_px)


def cut(image: np.ndarray, part: Window) -> np.ndarray:
    x0, y0, x1, y1 = part
    return np.ascontiguousarray(image[y0:y1, x0:x1])


WINDOWS = {
    "right": (-9.0, -9.0, 0.8, 9.0),
    "left": (0.2, -9.0, 9.0, 9.0),
    "bottom": (-9.0, -9.0, 9.0, 0.8),
    "top and left": (0.15, 0.15, 9.0, 9.0),
    "all round": (0.15, 0.15, 0.85, 0.85),
}


@pytest.mark.parametrize("where", WINDOWS)
@pytest.mark.parametrize("size", [(9, 6), (14, 10)])
@pytest.mark.parametrize("seed", range(2))
def test_marks_name_a_part(take: Take, where: str, size: tuple[int, int], seed: int) -> None:
    scene, image = take(*size, seed=seed, max_roll_deg=180.0, tilt_deg=20.0, marks=True)
    part = window(scene, *WINDOWS[where])
    found = detect(cut(image, part), scene.target)
    assert found.labelling == "absolute"
    assert [w.code for w in found.warnings] == ["points_missing"]
    assert 12 <= len(found) < scene.target.size
    assert np.abs(errors(found, scene, part[:2])).max() < 0.3


def test_marks_name_what_is_left_next_to_a_hand(take: Take) -> None:
    """A whole side hidden, though the image goes on: without marks it is refused."""
    for marks in (True, False):
        scene, image = take(14, 10, seed=3, marks=marks)
        grid = scene.points_px.reshape(10, 14, 2)
        beyond = grid[:, -1] + 3.0 * (grid[:, -1] - grid[:, -2])
        hand = np.concatenate([grid[:, -3] - np.linspace(0.0, 25.0, 10)[:, None], beyond[::-1]])
        image = image.copy()
        cv2.fillPoly(image, [np.rint(hand).astype(np.int32)], 120)
        if marks:
            found = detect(image, scene.target)
            assert found.labelling == "absolute"
            assert found.column.max() in (9, 10)
            assert np.abs(errors(found, scene)).max() < 0.5
        else:
            with pytest.raises(OriginUnknown):
                detect(image, scene.target)


@pytest.mark.parametrize("where", WINDOWS)
@pytest.mark.parametrize("size", [(9, 6), (8, 6), (14, 10)])
def test_a_part_without_marks_is_rejected(take: Take, where: str, size: tuple[int, int]) -> None:
    scene, image = take(*size, seed=4, max_roll_deg=180.0, tilt_deg=15.0)
    # where corners of every line are left, it is the outermost squares that are missing
    with pytest.raises((OriginUnknown, TargetNotFound)) as refusal:
        detect(cut(image, window(scene, *WINDOWS[where])), scene.target)
    assert refusal.value.advice


@pytest.mark.parametrize("size", [(9, 6), (8, 6), (7, 7)])
def test_a_mirrored_print_is_recognised_by_its_marks(take: Take, size: tuple[int, int]) -> None:
    scene, image = take(*size, seed=2, max_roll_deg=180.0, marks=True)
    mirrored = np.ascontiguousarray(image[:, ::-1])
    part = window(scene, -9.0, -9.0, 0.85, 9.0)
    for seen in (mirrored, np.ascontiguousarray(cut(image, part)[::-1])):
        with pytest.raises(TargetMirrored):
            detect(seen, scene.target)


@pytest.mark.parametrize(
    ("asked", "reason"),
    [((14, 10), "not of one of 14 x 10"), ((10, 6), "not of one of 10 x 6"), ((8, 6), "not of one")],
)
def test_a_part_of_another_marked_board_is_named(take: Take, asked: tuple[int, int], reason: str) -> None:
    scene, image = take(9, 6, seed=5, max_roll_deg=0.0, tilt_deg=10.0, marks=True)
    with pytest.raises(TargetMismatch, match=reason):
        detect(cut(image, window(scene, 0.12, -9.0, 9.0, 9.0)), TargetSpec("chessboard", *asked, 20.0))


def test_a_smaller_board_seen_whole_is_no_part(take: Take) -> None:
    for marks in (False, True):
        _, image = take(9, 6, seed=5, marks=marks)
        with pytest.raises(TargetMismatch, match=r"A 9 x 6 grid is in view, 14 x 10"):
            detect(image, TargetSpec("chessboard", 14, 10, 20.0))


def test_a_part_with_two_ends_too_near_is_rejected(take: Take) -> None:
    """Top and bottom of a 9 x 6 are seen: no part of a 14 x 10, nor of a 9 x 7."""
    scene, image = take(9, 6, seed=1, max_roll_deg=0.0, tilt_deg=10.0)
    part = cut(image, window(scene, 0.2, -9.0, 9.0, 9.0))
    with pytest.raises(OriginUnknown):
        detect(part, scene.target)
    for asked in ((14, 10), (9, 7)):
        with pytest.raises(TargetNotFound, match="points of a grid are wholly in view"):
            detect(part, TargetSpec("chessboard", *asked, 20.0))


def test_few_corners_are_no_part(take: Take) -> None:
    scene, image = take(14, 10, seed=0, tilt_deg=10.0, max_roll_deg=5.0)
    with pytest.raises(TargetNotFound):
        detect(cut(image, window(scene, 0.4, 0.4, 0.62, 0.62)), scene.target)


def test_the_whole_board_is_taken_before_a_part_of_its_like(take: Take) -> None:
    scene, whole = take(9, 6, seed=1)
    other, image = take(9, 6, seed=4)
    part = image[:, : round(float(other.points_px[:, 0].mean()))]
    found = detect(np.ascontiguousarray(np.concatenate([whole, part], axis=1)), scene.target)
    assert found.labelling == "absolute"
    assert np.abs(errors(found, scene)).max() < 0.3


def test_of_two_parts_without_marks_none_is_taken(take: Take) -> None:
    (one, first), (other, second) = take(9, 6, seed=1), take(9, 6, seed=4)
    left = second[:, round(float(other.points_px[:, 0].mean())) :]
    right = first[:, : round(float(one.points_px[:, 0].mean()))]
    with pytest.raises(OriginUnknown):
        detect(np.ascontiguousarray(np.concatenate([left, right], axis=1)), one.target)


def occluded(image: np.ndarray, scene: Scene, kind: str, rng: np.random.Generator) -> np.ndarray:
    """The image with something drawn over a part of the board."""
    grid = scene.points_px.reshape(scene.target.rows, scene.target.columns, 2)
    pitch = float(np.linalg.norm(grid[1, 1] - grid[0, 0])) / np.sqrt(2.0)
    middle = grid[
        scene.target.rows // 2 + rng.integers(-1, 2), scene.target.columns // 2 + rng.integers(-2, 3)
    ]
    drawn = image.copy()
    if kind == "hand":
        palm = (middle + rng.uniform(-1.0, 1.0, 2) * pitch).astype(int).tolist()
        cv2.ellipse(drawn, palm, (int(2.2 * pitch), int(1.5 * pitch)), 30, 0, 360, 150, -1, cv2.LINE_AA)
        for angle in np.linspace(-0.5, 0.5, 4):
            tip = palm + 3.5 * pitch * np.array([np.cos(angle), np.sin(angle)])
            cv2.line(drawn, palm, tip.astype(int).tolist(), 150, int(0.5 * pitch), cv2.LINE_AA)
    elif kind == "cable":
        ends = grid[0, rng.integers(2, 5)], grid[-1, -rng.integers(2, 5)]
        path = np.linspace(*ends, 40) + 0.4 * pitch * np.sin(np.linspace(0.0, 9.0, 40))[:, None]
        cv2.polylines(drawn, [np.rint(path).astype(np.int32)], False, 15, int(0.35 * pitch), cv2.LINE_AA)
    else:
        v, u = np.mgrid[0 : image.shape[0], 0 : image.shape[1]]
        away = ((u - middle[0]) ** 2 + (v - middle[1]) ** 2) / (2.0 * (1.3 * pitch) ** 2)
        drawn = np.clip(image + 500.0 * np.exp(-away), 0, 255).astype(np.uint8)
    return cv2.GaussianBlur(drawn, (0, 0), 0.6) if kind != "highlight" else drawn


@pytest.mark.parametrize("kind", ["hand", "cable", "highlight"])
@pytest.mark.parametrize("seed", range(3))
def test_what_lies_on_the_board_costs_corners_not_correctness(take: Take, kind: str, seed: int) -> None:
    scene, image = take(14, 10, seed=seed, tilt_deg=20.0)
    found = detect(occluded(image, scene, kind, np.random.default_rng(seed)), scene.target)
    assert 0.5 * 140 <= len(found) < 140
    off = np.abs(errors(found, scene)).max(axis=1)
    clear = np.abs(errors(detect(image, scene.target), scene)).max(axis=1)
    if kind == "highlight":  # at its rim light changes faster than the model of a corner has it
        assert np.median(off) < 2.0 * np.median(clear)
    else:
        assert np.median(off) < 1.2 * np.median(clear)
        assert np.quantile(off, 0.95) < 1.5 * np.quantile(clear, 0.95)
    assert off.max() < 0.5


@pytest.mark.parametrize("marks", [False, True])
def test_boards_of_two_sizes_in_one_image_are_each_found(take: Take, marks: bool) -> None:
    (small, first), (large, second) = take(9, 6, seed=1, marks=marks), take(14, 10, seed=2, marks=marks)
    both = np.concatenate([first, second], axis=1)
    assert np.abs(errors(detect(both, small.target), small)).max() < 0.3
    shift = (-float(first.shape[1]), 0.0)
    assert np.abs(errors(detect(both, large.target), large, shift)).max() < 0.3
