"""Several views with one camera: the arrow-shaped solver against the same fit written out densely."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from core.calibration import closed_form
from core.calibration.multi_view.bundle_adjustment import bundle_adjust
from core.calibration.multi_view.estimators import estimate_group
from core.calibration.multi_view.fitting.pooled import PooledCalibration, calibrate_views
from core.calibration.multi_view.view_stack import stack_states, stack_views
from core.calibration.priors import camera_prior
from core.calibration.residuals import View
from core.calibration.state import SMALLEST_NOISE_PX, image_centre, view_of, view_residuals
from core.errors import InvalidArgument
from core.geometry.camera import Camera, project
from core.geometry.homography import estimate_homography
from core.geometry.se3 import so3_exp, so3_log, transform_points
from core.numerics.least_squares import Fit, fit
from core.numerics.schur import SHARED_CAMERA
from core.targets.specification import GridPoints, TargetSpec
from tests.support.simulation.simulated_views import draw_camera, draw_pose, draw_view

State = tuple[View, ...]


def drawn(
    seed: int, count: int, camera: Camera | None = None, sigma_px: float = 0.05
) -> tuple[Camera, list[GridPoints]]:
    """Views of one camera, each with a tenth of its points missing."""
    rng = np.random.default_rng(seed)
    camera = camera or draw_camera(rng)
    views = []
    for _ in range(count):
        points = draw_view(rng, tilt_deg=rng.uniform(5.0, 45.0), camera=camera, sigma_px=sigma_px).points
        there = np.flatnonzero(rng.random(len(points)) > 0.1)
        views.append(points.take(there))
    return camera, views


def start(views: list[GridPoints], focal: float) -> State:
    camera = Camera(focal, focal, *image_centre(views[0]))
    return tuple(
        view_of(closed_form.nominal(estimate_homography(v.points_target[:, :2], v.points_px), v, camera), v)
        for v in views
    )


def dense(views: list[GridPoints], begin: State) -> Fit[State]:
    """All parameters in one state, all derivatives in one array."""
    residual_functions = [view_residuals(v, free=True) for v in views]
    size = 8 + 6 * len(views)
    of_camera = camera_prior(views[0].image_width_px, views[0].image_height_px, None, size)

    def evaluate(state: State) -> tuple[np.ndarray, np.ndarray]:
        parts = [f(view) for f, view in zip(residual_functions, state, strict=True)]
        residuals = np.concatenate([r for r, _ in parts], axis=1)
        jacobian = np.zeros((size, 2, residuals.shape[1]))
        first = 0
        for index, (r, J) in enumerate(parts):
            columns = slice(first, first + r.shape[1])
            jacobian[:8, :, columns] = J[:8]
            jacobian[8 + 6 * index : 14 + 6 * index, :, columns] = J[8:]
            first += r.shape[1]
        return residuals, jacobian

    def retract(state: State, step: np.ndarray) -> State:
        parameters = state[0].parameters.copy()
        parameters[:8] += step[:8]
        return tuple(
            View(parameters, so3_exp(d[:3]) @ view.rotation, view.translation_mm + d[3:])
            for view, d in zip(state, step[8:].reshape(-1, 6), strict=True)
        )

    return fit(
        evaluate,
        retract,
        begin,
        np.concatenate([v.standard_uncertainty_px for v in views]),
        prior=lambda state: of_camera(state[0].parameters),
        smallest_scale=SMALLEST_NOISE_PX,
        iteration_limit=100,
    )


def assert_same(found: PooledCalibration, expected: Fit[State]) -> None:
    assert expected.converged
    sigma = np.sqrt(np.diag(expected.covariance))
    difference = (found.camera.as_array() - expected.state[0].parameters)[:8]
    np.testing.assert_allclose(difference / sigma[:8], 0.0, atol=0.01)
    for index, (T, view) in enumerate(zip(found.T_camera_target, expected.state, strict=True)):
        w = so3_log(T[:3, :3] @ view.rotation.T)
        np.testing.assert_allclose(w / sigma[8 + 6 * index : 11 + 6 * index], 0.0, atol=0.01)
    # The dense fit knows the priors' part of the degrees of freedom, some of 8 among thousands.
    stated = np.sqrt(np.diag(found.covariance))[:8] / found.inflation
    np.testing.assert_allclose(stated, sigma[:8], rtol=0.01)
    np.testing.assert_array_equal(np.concatenate(found.used), expected.used)
    np.testing.assert_allclose(np.concatenate(found.residuals_px).T, expected.residuals, atol=1e-3)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_it_is_the_dense_fit(seed: int) -> None:
    camera, views = drawn(seed, 8)
    found = calibrate_views(views)
    assert_same(found, dense(views, start(views, 2320.0)))
    z = (found.camera.as_array() - camera.as_array())[:8] / np.sqrt(np.diag(found.covariance))[:8]
    assert np.max(np.abs(z)) < 4.0


def test_gross_errors_are_rejected_as_by_the_dense_fit() -> None:
    rng = np.random.default_rng(4)
    _, views = drawn(4, 8)
    spoiled, wrong = [], []
    for points in views:
        px, bad = points.points_px.copy(), rng.permutation(len(points))[: len(points) // 5]
        px[bad] += 20.0 * rng.choice([-1.0, 1.0], (len(bad), 2))
        spoiled.append(dataclasses.replace(points, points_px=px))
        wrong.append(np.isin(np.arange(len(points)), bad))
    found = calibrate_views(spoiled)
    np.testing.assert_array_equal(np.concatenate(found.used), ~np.concatenate(wrong))
    assert_same(found, dense(spoiled, start(spoiled, 2320.0)))


@pytest.mark.parametrize("stated_px", [0.002, 0.05, 1.0])
def test_the_level_of_the_stated_uncertainty_does_not_matter(stated_px: float) -> None:
    """It decides by which way the answer is found, not what it is."""
    _, views = drawn(5, 8)
    restated = [dataclasses.replace(v, standard_uncertainty_px=np.full(len(v), stated_px)) for v in views]
    assert_same(calibrate_views(restated), dense(views, start(views, 2320.0)))


@pytest.mark.parametrize("factor", [0.4, 0.7, 1.5, 3.0])
def test_starts_far_from_the_truth_end_in_one_place(factor: float) -> None:
    camera, views = drawn(6, 8, sigma_px=0.01)
    expected = calibrate_views(views)
    begin = stack_states(start(views, factor * camera.fx_px))
    found = bundle_adjust(stack_views(views), begin, SHARED_CAMERA)
    assert found.converged
    sigma = np.sqrt(np.diag(expected.covariance))[:8]
    difference = found.at.placements.parameters[0, :8] - expected.camera.as_array()[:8]
    np.testing.assert_allclose(difference / sigma, 0.0, atol=0.02)


@pytest.mark.parametrize("factor", [1.02, 1.2])
def test_a_view_of_another_focus_is_excluded_among_many(factor: float) -> None:
    camera, views = drawn(7, 12)
    foreign = dataclasses.replace(camera, fx_px=factor * camera.fx_px, fy_px=factor * camera.fy_px, k1=0.2)
    _, (stranger,) = drawn(8, 1, foreign)
    found = calibrate_views([*views, stranger])
    assert not found.used[-1].any()
    assert all(u.mean() > 0.99 for u in found.used[:-1])
    z = (found.camera.as_array() - camera.as_array())[:8] / np.sqrt(np.diag(found.covariance))[:8]
    assert np.max(np.abs(z)) < 4.0


def bowed_session(seed: int, bow_mm: float, foreign: float | None = None) -> list[GridPoints]:
    """Ten images of each of five poses of a board that is bowed along its rows, every other image of a part of it. The
    last pose is taken with `foreign` times the others' focal length, and another distortion.
    """
    rng = np.random.default_rng(seed)
    board = TargetSpec("chessboard", 9, 6, 30.0)
    flat = board.points_target()
    row, column = (a.ravel() for a in np.mgrid[0:6, 0:9])
    printed = flat.copy()
    printed[:, 2] += bow_mm * (1.0 - ((column - 4.0) / 4.0) ** 2)
    camera = draw_camera(rng)
    other = (
        camera
        if foreign is None
        else dataclasses.replace(camera, fx_px=foreign * camera.fx_px, fy_px=foreign * camera.fy_px, k1=0.2)
    )
    sigma_px, views = 0.01, []
    for pose in range(5):
        T = draw_pose(rng, board, camera, 2448, np.radians(rng.uniform(15.0, 40.0)))
        for image in range(10):
            moved = T.copy()
            moved[:3, 3] += rng.normal(0.0, 0.05, 3)
            px = project(transform_points(moved, printed), other if pose == 4 else camera)
            px += rng.normal(0.0, sigma_px, px.shape)
            there = (rng.random(54) < 0.8) if image % 2 else np.ones(54, dtype=np.bool_)
            views.append(
                GridPoints(
                    board,
                    2448,
                    2050,
                    column[there],
                    row[there],
                    px[there],
                    np.full(int(there.sum()), sigma_px),
                )
            )
    return views


def excluded(views: list[GridPoints]) -> list[int]:
    labels = [i // 10 for i in range(len(views))]
    return [i for i, _ in estimate_group(views, "pooled", repeats=labels).failures]


@pytest.mark.parametrize("seed", [7, 19, 147, 181])
def test_no_view_of_a_bowed_board_is_foreign(seed: int) -> None:
    assert excluded(bowed_session(seed, 0.3)) == []


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("bow_mm", [0.0, 0.02])
def test_a_pose_of_another_focus_is_excluded_whole(seed: int, bow_mm: float) -> None:
    assert excluded(bowed_session(seed, bow_mm, foreign=1.05)) == list(range(40, 50))


def test_what_cannot_be_pooled_is_refused() -> None:
    _, views = drawn(9, 2)
    with pytest.raises(InvalidArgument):
        calibrate_views([])
    with pytest.raises(InvalidArgument, match="same image size"):
        calibrate_views([views[0], dataclasses.replace(views[1], image_width_px=2000)])
