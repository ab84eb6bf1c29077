"""Boards of dots that are refused: by what is in view instead, and next to their own reflection."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from core.errors import TargetMirrored, TargetMismatch, TargetNotFound
from core.geometry import project, transform_points
from core.geometry.camera import Camera
from core.simulation import Scene, random_pose
from core.targets import TargetSpec, detect
from tests.support.simulation.renders import render

CAMERA = Camera(1000.0, 1000.0, 503.0, 396.0, k1=-0.1)
SIZE = (1000, 800)
DOTS, STAGGERED = TargetSpec("circles", 10, 8, 20.0), TargetSpec("asymmetric_circles", 4, 11, 14.0)
EVEN = TargetSpec("asymmetric_circles", 4, 10, 14.0)


def taken(target: TargetSpec, seed: int) -> tuple[Scene, np.ndarray]:
    T = random_pose(target, CAMERA, SIZE, 0.4, math.pi, np.random.default_rng(seed))
    dot = 1.5 if target.kind == "circles" else 1.0
    scene = Scene(target, CAMERA, T, *SIZE, noise_levels=2.0, origin_dot=dot, seed=seed)
    return scene, render(scene)


def smaller(image: np.ndarray, scale: float) -> np.ndarray:
    """The image smaller, on as high a canvas."""
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    canvas = np.full((image.shape[0], small.shape[1]), 90, np.uint8)
    canvas[: small.shape[0]] = small
    return canvas


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("scale", [0.6, 1.0])
@pytest.mark.parametrize("target", [DOTS, EVEN], ids=["circles", "asymmetric"])
def test_a_board_next_to_its_reflection_is_found(target: TargetSpec, scale: float, seed: int) -> None:
    scene, image = taken(target, seed)
    reflection = (0.4 * smaller(image[:, ::-1], scale) + 60).astype(np.uint8)
    found = detect(np.hstack([image, reflection]), target)
    assert len(found) >= target.size - 2
    distance = np.linalg.norm(found.points_px[:, None] - scene.points_px, axis=2).min(axis=1)
    assert float(distance.max()) < 0.2


def test_a_mirrored_board_is_refused_and_next_to_its_small_reflection_too() -> None:
    _, image = taken(DOTS, 1)
    mirrored = np.ascontiguousarray(image[:, ::-1])
    with pytest.raises(TargetMirrored):
        detect(mirrored, DOTS)
    with pytest.raises(TargetMismatch, match="twice, once mirrored"):
        detect(np.hstack([mirrored, smaller(image, 0.6)]), DOTS)


@pytest.mark.parametrize(
    ("shown", "asked", "named"),
    [
        (STAGGERED, (5, 11), "4 x 11"),
        (STAGGERED, (4, 13), "4 x 11"),
        (STAGGERED, (3, 11), "4 x 11"),
        (STAGGERED, (4, 9), "4 x 11"),
        (STAGGERED, (11, 4), "4 x 11"),
        (EVEN, (4, 11), "5 x 8 or 4 x 10"),
        (DOTS, (10, 9), "10 x 8"),
        (DOTS, (9, 8), "10 x 8"),
    ],
)
def test_a_grid_of_another_size_is_named(shown: TargetSpec, asked: tuple[int, int], named: str) -> None:
    _, image = taken(shown, 2)
    with pytest.raises(TargetMismatch, match=f"A grid of {named} dots"):
        detect(image, TargetSpec(shown.kind, *asked, shown.pitch_mm))


def test_a_grid_with_a_hidden_line_is_not_said_to_be_smaller_than_itself() -> None:
    scene, image = taken(DOTS, 4)
    strip = np.array([[-1.4, -0.6, 0], [5.6, -0.6, 0], [5.6, 0.6, 0], [-1.4, 0.6, 0]]) * DOTS.pitch_mm
    corners = project(transform_points(scene.T_camera_target, strip), CAMERA)
    cv2.fillPoly(image, [np.rint(corners).astype(np.int32)], 120)
    with pytest.raises(TargetNotFound) as refused:
        detect(image, DOTS)
    assert "Only" not in refused.value.detail


@pytest.mark.parametrize("target", [DOTS, STAGGERED], ids=["circles", "asymmetric"])
def test_a_white_thread_along_the_last_line_is_not_said_to_spoil_the_whole_board(target: TargetSpec) -> None:
    """Nine in ten dots can be measured, but hardly one of that line."""
    scene, image = taken(target, 4)
    last = scene.points_px.reshape(target.rows, target.columns, 2)[-1]
    across = (last[1] - last[0]) / np.linalg.norm(last[1] - last[0])
    ends = np.rint([last[0] - 60.0 * across, last[-1] + 60.0 * across]).astype(int).tolist()
    cv2.line(image, ends[0], ends[1], 200, 4)
    with pytest.raises(TargetNotFound, match="dots of its outermost lines are hidden") as refused:
        detect(image, target)
    assert "in front of them" in str(refused.value.advice)
