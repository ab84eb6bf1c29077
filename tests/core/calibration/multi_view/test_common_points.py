"""Images of one pose that show different points: what is systematic in these does not read as the robot's scatter."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from core.calibration.multi_view.estimators import estimate_group
from core.calibration.multi_view.group_estimate import GroupEstimate
from core.calibration.multi_view.repeat_consistency import (
    is_same_scene,
    sums_of_squared_deviations,
    with_common_points,
)
from core.calibration.multi_view.view_stack import number_labels, stack_views
from core.geometry.camera import Camera, project
from core.geometry.se3 import transform_points
from core.metrology import PoseCycles, Verdict, assess_repeatability
from core.targets.specification import GridPoints, TargetSpec
from tests.support.simulation.simulated_views import draw_pose

CAMERA = Camera(1160.0, 1160.3, 605.0, 515.0, -0.1, 0.05, 1e-4, -2e-4)
BOARD = TargetSpec("chessboard", 14, 10, 8.0)
SIGMA = 0.02
BOW_MM = 0.3
POSES, CYCLES = 4, 12


def bowed() -> np.ndarray:
    """The grid of a print that is bowed across its columns, highest in the middle."""
    points = BOARD.points_target()
    x = points[:, 0] / points[:, 0].max()
    points[:, 2] = 4.0 * BOW_MM * x * (1.0 - x)
    return points


def session(seed: int, hide: str) -> tuple[list[GridPoints], list[int]]:
    """Images of a motionless robot before a bowed print, and their poses; some points of some images `hide`d."""
    rng = np.random.default_rng(seed)
    poses = [draw_pose(rng, BOARD, CAMERA, 1224, math.radians(30.0)) for _ in range(POSES)]
    exact = [project(transform_points(T, bowed()), CAMERA) for T in poses]
    row, column = (a.ravel() for a in np.mgrid[0 : BOARD.rows, 0 : BOARD.columns])
    views, labels = [], []
    for cycle in range(CYCLES):
        for pose in range(POSES):
            keep = np.ones(BOARD.size, dtype=np.bool_)
            if hide == "half" and cycle % 2:
                keep = column < BOARD.columns // 2
            elif hide == "random":
                keep = rng.random(BOARD.size) > 0.03
            elif hide == "either":  # nothing in common
                keep = (column < BOARD.columns // 2) == bool(cycle % 2)
            px = exact[pose] + rng.normal(0.0, SIGMA, (BOARD.size, 2))
            uncertainty = np.full(int(keep.sum()), SIGMA)
            views.append(GridPoints(BOARD, 1224, 1024, column[keep], row[keep], px[keep], uncertainty))
            labels.append(pose)
    return views, labels


def ratios(found: GroupEstimate, labels: list[int]) -> list[float]:
    """Of each pose of the motionless robot, what was read over the floor."""
    of_pose = np.array(labels)[found.images]
    cycles = [
        PoseCycles(
            found.positions_mm[of_pose == p], found.rotations[of_pose == p], found.scatter[of_pose == p]
        )
        for p in range(POSES)
    ]
    figures = assess_repeatability(cycles)
    assert all(one.verdict != Verdict.ROBOT for one in figures)
    return [one.repeatability.position_mm / one.noise_floor.position_mm for one in figures]


@pytest.mark.parametrize("estimator", ["pooled", "given"])
@pytest.mark.parametrize("hide", ["none", "half", "random"])
def test_a_motionless_robot_reads_as_its_floor(hide: str, estimator: str) -> None:
    views, labels = session(1, hide)
    found = estimate_group(views, estimator, intrinsics=CAMERA, repeats=labels)
    assert len(found.images) == len(views)
    assert not found.differing.any()
    # RP_l of twelve cycles scatters by some 18 %: the mean of four poses by 9 %, and each within 2.3 times that of it.
    read = ratios(found, labels)
    assert 0.7 < np.mean(read) < 1.3, read
    assert max(read) < 1.7


def test_the_floor_is_that_of_the_noise_not_of_the_bow() -> None:
    """Points are missing at random: no two images show the same ones, yet each cell's noise is determined."""
    floors = []
    for hide in ("none", "random"):
        views, labels = session(2, hide)
        found = estimate_group(views, "pooled", repeats=labels)
        floors.append(float(np.mean(np.sqrt(np.trace(found.scatter[:, :3, :3], axis1=1, axis2=2)))))
    assert floors[1] / floors[0] == pytest.approx(1.0, abs=0.35)  # of up to half of the points


def test_poses_whose_images_have_too_little_in_common_are_named() -> None:
    views, labels = session(3, "either")
    whole, _ = session(3, "none")
    mixed = [one if label else other for label, one, other in zip(labels, views, whole, strict=True)]
    found = estimate_group(mixed, "pooled", repeats=labels)
    named = {labels[i] for i, one in zip(found.images.tolist(), found.differing.tolist(), strict=True) if one}
    assert named == {1, 2, 3}


def test_only_what_all_show_is_kept_and_the_rest_stays_as_it_is() -> None:
    views, labels = session(4, "random")
    alone = replace(views[0], target=replace(BOARD, pitch_mm=9.0))
    stack = stack_views([*views, alone])
    kept, differing = with_common_points(stack, number_labels([*labels, 0]))
    assert not differing.any()
    assert len(kept) == len(stack)
    for pose in range(POSES):
        members = np.flatnonzero(np.array(labels) == pose)
        assert is_same_scene(kept, members)
        common = set.intersection(
            *({(c, r) for c, r in zip(views[i].column, views[i].row, strict=True)} for i in members)
        )
        one = kept.view(int(members[0]))
        assert {(c, r) for c, r in zip(one.column, one.row, strict=True)} == common
        assert one.points_px.tolist() == [
            px
            for c, r, px in zip(
                views[members[0]].column,
                views[members[0]].row,
                views[members[0]].points_px.tolist(),
                strict=True,
            )
            if (c, r) in common
        ]
    assert len(kept.view(len(stack) - 1)) == len(alone)  # the only image of its target
    again, _ = with_common_points(kept, number_labels([*labels, 0]))
    assert again is kept


def test_squares_about_each_cells_mean() -> None:
    rng = np.random.default_rng(5)
    cell = np.array([0, 1, 2, 0, 1, 0, 2, 2, 7])
    residuals = rng.normal(size=(2, 9)) + 100.0 * cell  # whatever a cell's images share does not count
    total, freedom = sums_of_squared_deviations(cell, residuals, np.full(9, 2.0))
    expected = sum(
        float(np.sum((component[cell == c] - component[cell == c].mean()) ** 2)) / 4.0
        for component in residuals
        for c in (0, 1, 2, 7)
    )
    assert total == pytest.approx(expected)
    assert freedom == 2 * (9 - 4)
