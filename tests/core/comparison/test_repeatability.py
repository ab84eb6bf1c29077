"""Table III: every method's own poses by the same rules, and what stands where there are too few."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from core.comparison import METHODS, MethodRepeatability, compare_methods, compare_repeatability
from core.geometry.camera import Camera, project
from core.geometry.se3 import invert, transform_points
from core.metrology import PoseCycles, assess_repeatability
from core.targets.charuco.layout import charuco_layout
from core.targets.specification import GridPoints, TargetSpec
from tests.support.sessions.comparisons import NOT_POOLED, pooled
from tests.support.simulation.simulated_views import draw_pose

CAMERA = Camera(1160.0, 1160.3, 605.0, 515.0, -0.1, 0.05, 1e-4, -2e-4)
BOARD = TargetSpec("charuco", 9, 6, 12.0, 8.4, "DICT_5X5_100")
LAYOUT = charuco_layout(BOARD)
POSES, CYCLES, SIGMA_PX = 3, 10, 0.02


def visits() -> tuple[list[GridPoints], list[str]]:
    """A robot that stands still: all scatter is the instrument's."""
    rng = np.random.default_rng(8)
    row, column = (a.ravel() for a in np.mgrid[0:6, 0:9])
    views, labels = [], []
    for pose in range(POSES):
        T = draw_pose(rng, BOARD, CAMERA, 1224, math.radians(30.0))
        grid = project(transform_points(T, BOARD.points_target()), CAMERA)
        corners = [project(transform_points(T, LAYOUT.marker_corners(k)), CAMERA) for k in range(35)]
        for _ in range(CYCLES):
            markers = {k: px + rng.normal(0.0, SIGMA_PX, (4, 2)) for k, px in enumerate(corners)}
            px = grid + rng.normal(0.0, SIGMA_PX, grid.shape)
            views.append(
                GridPoints(BOARD, 1224, 1024, column, row, px, np.full(54, SIGMA_PX), markers_px=markers)
            )
            labels.append(f"P{pose + 1}")
    return views, labels


def by_method(rows: tuple[MethodRepeatability, ...]) -> dict[str, MethodRepeatability]:
    return {row.method: row for row in rows}


def test_one_marker_is_many_times_worse_than_all_points_together() -> None:
    views, labels = visits()
    table = by_method(compare_repeatability(compare_methods(views, pooled(views, labels)), labels))
    assert tuple(table) == METHODS
    reading = {}
    for method, row in table.items():
        assert row.failure is None
        assert [pose.label for pose in row.poses] == ["P1", "P2", "P3"]
        values = [pose.repeatability.position_mm for pose in row.poses]
        assert all(value is not None and value > 0.0 for value in values)
        reading[method] = float(np.mean([value for value in values if value is not None]))
        for pose in row.poses:
            assert (pose.noise_floor is not None) == (method == "pooled")
            assert len(pose.images) + len(pose.failures) == CYCLES
    # equal noise: METHOD has 20 for a 14 x 10 board of 300 mm
    assert reading["aruco_marker"] > 8.0 * reading["pooled"]
    assert reading["aruco_board"] < 2.0 * reading["pooled"]
    assert reading["zhang"] == pytest.approx(reading["pooled"], rel=0.1)
    assert reading["proposed_vanishing_point"] > 5.0 * reading["pooled"]
    for pose in table["pooled"].poses:  # motionless: the reading is the floor, give or take of ten cycles
        assert pose.noise_floor is not None
        assert pose.noise_floor.position_mm is not None
        assert pose.repeatability.position_mm == pytest.approx(pose.noise_floor.position_mm, rel=0.6)


def test_figures_are_those_of_the_engine_on_the_methods_own_poses() -> None:
    views, labels = visits()
    (row,) = compare_methods(views, NOT_POOLED, methods=["opencv_single_image"])
    T = np.array([invert(row.poses[i]) for i in range(CYCLES, 2 * CYCLES)])
    (expected,) = assess_repeatability([PoseCycles(T[:, :3, 3], T[:, :3, :3])])
    (table,) = compare_repeatability([row], labels)
    assert table.poses[1].repeatability == expected.repeatability
    assert table.poses[1].images == tuple(range(CYCLES, 2 * CYCLES))


def test_too_few_images_say_so_and_have_no_figures() -> None:
    views, _ = visits()
    chosen = [views[0], views[CYCLES], views[CYCLES + 1]]
    flat = dataclasses.replace(views[1], points_px=views[1].points_target[:, :2] * 5.0 + 300.0)
    (row,) = compare_repeatability(
        compare_methods([*chosen, flat], NOT_POOLED, methods=["tsai"]), ["P1", "P2", "P2", "P3"]
    )
    first, second, third = row.poses
    assert second.failure is None
    assert len(second.images) == 2
    for pose, count in ((first, 1), (third, 0)):
        assert pose.failure is not None
        assert pose.failure.code == "too_few_images"
        assert len(pose.images) == count
        assert all(value is None for _, value in pose.repeatability.items())
    assert [failure.image for failure in third.failures] == [3]


def test_a_method_that_fails_as_a_whole_says_why_at_every_pose() -> None:
    views, _ = visits()
    (row,) = compare_repeatability(compare_methods(views[:1], NOT_POOLED, methods=["zhang"]), ["P1"])
    assert row.failure is not None
    assert row.failure.code == "degenerate_geometry"
    assert row.poses[0].failure == row.failure


def test_poses_that_the_engine_refuses_are_named_and_the_others_stand() -> None:
    views, labels = visits()
    (row,) = compare_methods(views, pooled(views, labels), methods=["pooled"])
    assert row.scatter is not None
    wrong = dataclasses.replace(row, scatter={**row.scatter, 0: -np.eye(6)})
    (table,) = compare_repeatability([wrong], labels)
    first, second, third = table.poses
    assert first.failure is not None
    assert first.failure.code == "invalid_argument"
    assert first.repeatability.position_mm is None
    assert second.failure is third.failure is None


def test_images_without_a_pose_count_nowhere() -> None:
    views, _ = visits()
    rows = compare_methods(views[:4], NOT_POOLED, methods=["dlt"])
    (row,) = compare_repeatability(rows, ["P1", "P1", None, "P1"])
    assert row.poses[0].images == (0, 1, 3)
