"""One weight for a point in all images of a pose: a robot at rest reads its floor, however the weights scatter."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from core.calibration.multi_view.estimators import estimate_group
from core.calibration.multi_view.repeat_consistency import MAX_POOLED_RATIO, with_pooled_variances
from core.calibration.multi_view.view_stack import stack_views
from core.geometry.camera import project
from core.geometry.se3 import transform_points
from core.metrology import PoseCycles, assess_repeatability
from core.targets.specification import GridPoints, TargetSpec
from tests.support.simulation.scenes import standard_camera
from tests.support.simulation.simulated_views import draw_pose

BOARD = TargetSpec("chessboard", 9, 6, 30.0)
SIGMA_PX = 0.005


def images(poses: int, cycles: int, scatter_of_weights: float) -> tuple[list[GridPoints], list[int]]:
    """A robot at rest before a bowed board, each corner's uncertainty estimated anew in each image."""
    rng = np.random.default_rng(0)
    camera = standard_camera()
    row, column = (a.ravel() for a in np.mgrid[0 : BOARD.rows, 0 : BOARD.columns])
    places = BOARD.points_target()
    places[:, 2] += 0.5 * ((places[:, 0] - 120.0) / 120.0) ** 2
    views, labels = [], []
    for pose in range(poses):
        T = draw_pose(rng, BOARD, camera, 2448, math.radians(30.0))
        exact = project(transform_points(T, places), camera)
        for _ in range(cycles):
            noisy = exact + rng.normal(0.0, SIGMA_PX, exact.shape)
            u = SIGMA_PX * np.exp(rng.normal(0.0, scatter_of_weights, len(exact)))
            views.append(GridPoints(BOARD, 2448, 2050, column, row, noisy, u))
            labels.append(pose)
    return views, labels


@pytest.mark.parametrize("estimator", ["pooled", "per_image_fixed_pp"])
def test_a_robot_at_rest_reads_its_floor_though_weights_scatter(estimator: str) -> None:
    views, labels = images(5, 30, 0.03)
    found = estimate_group(views, estimator, repeats=labels)
    pose_of = np.array(labels)[found.images]
    figures = assess_repeatability(
        [
            PoseCycles(
                found.positions_mm[pose_of == p], found.rotations[pose_of == p], found.scatter[pose_of == p]
            )
            for p in range(5)
        ]
    )
    ratio = [
        float(f.repeatability.position_mm or 0.0) / float(f.noise_floor.position_mm or 1.0) for f in figures
    ]
    # 150 images of at least one direction each: 1 / √(2 · 145) is 6 %. With weights of their own it reads 1.5 to 5.
    assert np.mean(ratio) == pytest.approx(1.0, abs=0.2)


def test_the_pattern_is_common_and_the_level_each_image_s_own() -> None:
    views, labels = images(2, 10, 0.03)
    views[3] = dataclasses.replace(views[3], standard_uncertainty_px=3.0 * views[3].standard_uncertainty_px)
    stack = stack_views(views)
    common = with_pooled_variances(stack, np.array(labels)).standard_uncertainty_px.reshape(20, -1)
    before = stack.standard_uncertainty_px.reshape(20, -1)
    np.testing.assert_allclose(np.exp(np.log(common).mean(axis=1)), np.exp(np.log(before).mean(axis=1)))
    shape = common / common.mean(axis=1, keepdims=True)
    np.testing.assert_allclose(shape[:10], np.tile(shape[0], (10, 1)), rtol=1e-12)
    assert not np.allclose(shape[0], shape[10], rtol=1e-3)


def test_what_one_image_says_of_a_point_alone_is_kept() -> None:
    views, labels = images(1, 10, 0.0)
    u = views[4].standard_uncertainty_px.copy()
    u[7] = 20.0 * SIGMA_PX
    views[4] = dataclasses.replace(views[4], standard_uncertainty_px=u)
    common = with_pooled_variances(stack_views(views), np.array(labels)).standard_uncertainty_px.reshape(
        10, -1
    )
    assert common[4, 7] == 20.0 * SIGMA_PX
    # A tenth of its logarithm reaches the same point in the others.
    assert np.all(common[np.arange(10) != 4, 7] < MAX_POOLED_RATIO * SIGMA_PX)


def test_images_by_themselves_and_unsound_uncertainties_stay() -> None:
    views, labels = images(1, 4, 0.03)
    stack = stack_views(views)
    assert with_pooled_variances(stack, np.arange(4)) is stack
    bad = stack.standard_uncertainty_px.copy()
    bad[[0, 60, 120]] = [np.nan, 0.0, np.inf]
    found = with_pooled_variances(dataclasses.replace(stack, standard_uncertainty_px=bad), np.array(labels))
    np.testing.assert_array_equal(found.standard_uncertainty_px[[0, 60, 120]], [np.nan, 0.0, np.inf])
    rest = np.delete(found.standard_uncertainty_px, [0, 60, 120])
    assert np.all((rest > 0.0) & np.isfinite(rest))


def test_the_compiled_loop_is_the_formula() -> None:
    views, labels = images(3, 4, 0.3)
    views += [dataclasses.replace(v, target=TargetSpec("chessboard", 9, 6, 31.0)) for v in views[:2]]
    stack, numbers = stack_views(views), np.array([*labels, 0, 0])
    u = stack.standard_uncertainty_px
    expected = u.copy()
    for pose in {
        (label, target) for label, target in zip(numbers.tolist(), stack.target.tolist(), strict=True)
    }:
        members = np.flatnonzero((numbers == pose[0]) & (stack.target == pose[1]))
        logs = np.log(np.array([u[stack.part(int(i))] for i in members]))
        level = logs.mean(axis=1, keepdims=True)
        common = np.exp(level + (logs - level).mean(axis=0))
        for i, pattern in zip(members, common, strict=True):
            part = stack.part(int(i))
            expected[part] = np.where(u[part] <= MAX_POOLED_RATIO * pattern, pattern, u[part])
    found = with_pooled_variances(stack, numbers).standard_uncertainty_px
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    assert 0 < np.count_nonzero(found == u) < 0.5 * len(u)
