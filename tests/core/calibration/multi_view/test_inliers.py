"""Points of one pose are judged together: a robot that stands still reads its floor, whatever the residuals hold."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from core.calibration.multi_view.estimators import estimate_group
from core.calibration.multi_view.group_estimate import GroupEstimate
from core.calibration.multi_view.repeat_consistency import find_repeats, inliers_of
from core.calibration.multi_view.view_stack import stack_views
from core.geometry.camera import project
from core.geometry.se3 import transform_points
from core.metrology import PoseCycles, assess_repeatability
from core.targets.specification import GridPoints, TargetSpec
from tests.support.simulation.simulated_views import draw_camera, draw_pose

BOARD = TargetSpec("chessboard", 14, 10, 10.0)
CYCLES, POSES = 30, 5


def resting(seed: int, estimator: str, bow_mm: float, off_px: float, sigma_px: float) -> list[PoseCycles]:
    """Poses of a robot that stands still, seen with a bowed print and a principal point that is wrong."""
    rng = np.random.default_rng(seed)
    camera = draw_camera(rng)
    row, column = (a.ravel() for a in np.mgrid[0:10, 0:14])
    printed = BOARD.points_target()
    along = 2.0 * printed[:, 0] / 130.0 - 1.0
    printed = printed + np.column_stack([np.zeros((len(printed), 2)), bow_mm * (1.0 - along**2)])
    views, labels = [], []
    for pose in range(POSES):
        exact = project(
            transform_points(draw_pose(rng, BOARD, camera, 2448, math.radians(30)), printed), camera
        )
        for _ in range(CYCLES):
            seen = exact + rng.normal(0.0, sigma_px, exact.shape)
            views.append(GridPoints(BOARD, 2448, 2050, column, row, seen, np.full(len(seen), sigma_px)))
            labels.append(pose)
    wrong = dataclasses.replace(camera, cx_px=camera.cx_px + off_px, cy_px=camera.cy_px - off_px)
    return _cycles(estimate_group(views, estimator, intrinsics=wrong, repeats=labels), np.array(labels))


def _cycles(found: GroupEstimate, labels: np.ndarray) -> list[PoseCycles]:
    of = labels[found.images]
    return [
        PoseCycles(found.positions_mm[of == p], found.rotations[of == p], found.scatter[of == p])
        for p in range(POSES)
        if np.count_nonzero(of == p) > 25
    ]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("estimator", "bow_mm", "off_px", "sigma_px"),
    [
        ("pooled", 0.3, 40.0, 0.01),
        ("pooled_free_focal", 0.3, 40.0, 0.01),
        ("given", 0.3, 40.0, 0.01),
        ("per_image_fixed_pp", 0.3, 40.0, 0.01),
        ("per_image", 0.02, 0.0, 0.01),  # which refuses views of a worse print
    ],
)
def test_a_robot_at_rest_reads_its_floor_through_a_bowed_print(
    estimator: str, bow_mm: float, off_px: float, sigma_px: float
) -> None:
    rows = assess_repeatability(
        [pose for seed in range(500, 504) for pose in resting(seed, estimator, bow_mm, off_px, sigma_px)]
    )
    assert len(rows) >= 10
    ratios = np.array([row.repeatability.position_mm / row.noise_floor.position_mm for row in rows])
    # Of 30 cycles on a needle, the worst shape, a reading has a standard deviation of .16 of its mean.
    assert abs(float(ratios.mean()) - 1.0) < 4.0 * 0.16 / math.sqrt(len(ratios)), ratios
    assert ratios.max() < 1.0 + 3.5 * 0.16, ratios
    assert all(row.verdict != "robot" for row in rows)


def decide(
    residuals: np.ndarray, labels: list[int] | None, columns: list[np.ndarray] | None = None
) -> list[np.ndarray]:
    views = []
    for k in range(len(residuals)):
        cells = np.arange(140) if columns is None else columns[k]
        views.append(
            GridPoints(
                BOARD,
                2448,
                2050,
                cells % 14,
                cells // 14,
                np.zeros((len(cells), 2)),
                np.full(len(cells), 0.05),
            )
        )
    parts = [r[:, : len(v)] for r, v in zip(residuals, views, strict=True)]
    stack = stack_views(views)
    everyone = np.ones(len(views), dtype=np.bool_)
    used = inliers_of(
        stack,
        find_repeats(stack, None if labels is None else np.array(labels)),
        np.concatenate(parts, axis=1),
        everyone,
    )
    return [used[stack.part(i)] for i in range(len(stack))]


def noise(images: int) -> np.ndarray:
    return np.random.default_rng(3).normal(0.0, 0.05, (images, 2, 140))


def test_a_point_near_the_limit_counts_in_all_images_or_in_none() -> None:
    residuals = noise(30)
    residuals[:, 0, 7] += 0.35  # 4 MAD of two components are 7 σ
    alone = np.array(decide(residuals, None))
    together = np.array(decide(residuals, [0] * 30))
    assert 3 < np.count_nonzero(alone[:, 7]) < 27
    assert len(set(together[:, 7].tolist())) == 1
    assert together[:, np.arange(140) != 7].all()


def test_a_gross_error_of_one_image_is_rejected_in_that_image() -> None:
    residuals = noise(30)
    residuals[4, :, 9] += 2.0
    residuals[:, 1, 50] += 3.0  # and a dent in the print out of all
    used = np.array(decide(residuals, [0] * 30))
    expected = np.ones((30, 140), dtype=np.bool_)
    expected[4, 9] = expected[:, 50] = False
    np.testing.assert_array_equal(used, expected)


def test_two_images_do_not_identify_which_of_them_is_wrong() -> None:
    residuals = noise(2)
    residuals[0, 0, 9] += 0.6
    used = np.array(decide(residuals, [0, 0]))
    assert not used[:, 9].any()
    assert np.count_nonzero(~used) == 2


def test_a_point_stays_where_leaving_it_out_would_move_the_pose_more() -> None:
    residuals = noise(30)
    residuals[:, 0] += 0.8 * np.where(np.arange(140) % 2, 1.0, -1.0)
    residuals[4, 1, 9] += 0.6
    assert np.array(decide(residuals, [0] * 30)).all()


def test_images_that_show_parts_of_the_grid_are_judged_together() -> None:
    residuals = noise(30)
    columns = [np.delete(np.arange(140), k) for k in range(30)]  # each lacks another point
    for k, cells in enumerate(columns):
        residuals[k, 0, : len(cells)] += np.where(cells == 100, 0.35, 0.0)
    used = decide(residuals, [0] * 30, columns)
    assert len({bool(u[c == 100][0]) for u, c in zip(used, columns, strict=True)}) == 1


def test_a_view_by_itself_is_judged_by_its_own_residuals() -> None:
    residuals = noise(1)
    residuals[0, 0, 9] += 2.0
    (used,) = decide(residuals, None)
    assert np.flatnonzero(~used).tolist() == [9]
