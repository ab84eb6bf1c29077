"""Corners astray are seen by their neighbours, and no lens makes a corner look astray."""

from __future__ import annotations

import math

import numpy as np
import pytest

from core.geometry.camera import Camera, project
from core.geometry.se3 import so3_exp, transform, transform_points
from core.targets.specification import TargetSpec
from core.targets.subpixel.neighbour_outliers import is_well_distributed, neighbour_inliers

KINDS = {
    "charuco": TargetSpec("charuco", 11, 8, 30.0, 22.0, "DICT_5X5_1000"),
    "aprilgrid": TargetSpec("aprilgrid", 5, 4, 40.0, 30.0),
    "small": TargetSpec("charuco", 4, 4, 60.0, 40.0, "DICT_5X5_1000"),
}
NOISE_PX = 0.05


def seen(
    target: TargetSpec, tilt_deg: float, k1: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Places on the print (mm), and in an image with noise that the board fills about."""
    axis = rng.uniform(0.0, 2.0 * math.pi)
    R = so3_exp(math.radians(tilt_deg) * np.array([math.cos(axis), math.sin(axis), 0.0]))
    points = target.points_target()
    T = transform(
        R, np.array([0.0, 0.0, 1.1 * float(np.ptp(points, axis=0).max())]) - R @ points.mean(axis=0)
    )
    camera = Camera(900.0, 900.0, 612.0, 512.0, k1=k1, k2=0.05 if k1 else 0.0)
    pixels = project(transform_points(T, points), camera)
    return points[:, :2], pixels + NOISE_PX * rng.standard_normal(pixels.shape)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("tilt_deg", "k1"), [(0.0, 0.0), (0.0, -0.3), (60.0, 0.0), (60.0, -0.3), (40.0, -0.3)]
)
def test_nothing_is_dropped_of_a_board_before_any_lens(kind: str, tilt_deg: float, k1: float) -> None:
    rng = np.random.default_rng(41)
    for _ in range(4):
        places, points = seen(KINDS[kind], tilt_deg, k1, rng)
        given = rng.random(len(points)) < 0.8
        kept = neighbour_inliers(places, points, np.full(len(points), NOISE_PX), given)
        np.testing.assert_array_equal(kept, given)


@pytest.mark.parametrize("kind", KINDS)
def test_the_one_astray_is_dropped_and_its_neighbours_are_not(kind: str) -> None:
    """By a fifth of the way to its neighbours, anywhere on the board; their predictions lean on it."""
    rng = np.random.default_rng(42)
    target = KINDS[kind]
    for _ in range(12):
        places, points = seen(target, 30.0, -0.1, rng)
        astray = int(rng.integers(len(points)))
        apart = np.sort(np.linalg.norm(points - points[astray], axis=1))[2]
        turn = rng.uniform(0.0, 2.0 * math.pi)
        points[astray] += 0.2 * apart * np.array([math.cos(turn), math.sin(turn)])
        kept = neighbour_inliers(
            places, points, np.full(len(points), NOISE_PX), np.ones(len(points), dtype=np.bool_)
        )
        assert np.flatnonzero(~kept).tolist() == [astray]


def test_a_corner_far_less_sure_than_the_others_is_dropped() -> None:
    places, points = seen(KINDS["small"], 20.0, 0.0, np.random.default_rng(43))
    uncertainty = np.full(len(points), NOISE_PX)
    uncertainty[[3, 5]] = 7.0 * NOISE_PX, 9.0 * NOISE_PX
    kept = neighbour_inliers(places, points, uncertainty, np.ones(len(points), dtype=np.bool_))
    assert np.flatnonzero(~kept).tolist() == [5]


@pytest.mark.parametrize("count", [0, 1, 6, 11])
def test_too_few_corners_or_one_row_say_nothing(count: int) -> None:
    places, points = seen(KINDS["charuco"], 20.0, 0.0, np.random.default_rng(44))
    given = np.arange(len(points)) < count
    kept = neighbour_inliers(places, points, np.full(len(points), NOISE_PX), given)
    np.testing.assert_array_equal(kept, given)


def test_a_row_and_one_corner_next_to_it_determine_no_plane() -> None:
    row = np.array([[column, 3.0] for column in range(6)])
    assert not is_well_distributed(row)
    assert not is_well_distributed(np.vstack([row, [[2.0, 4.0]]]))
    assert not is_well_distributed(np.array([[0.0, 0.0], [1.0, 1.0], [2.0, 2.0], [3.0, 3.0]]))
    assert is_well_distributed(np.vstack([row, [[2.0, 4.0], [5.0, 4.0]]]))
