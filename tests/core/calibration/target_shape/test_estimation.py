"""The target's own shape: recovered within its uncertainty, distinguished from noise, or refused."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from core.calibration.lens_selection import select_lens
from core.calibration.multi_view import estimate_group, stack_views
from core.calibration.target_shape.deformation import TargetShape, gauge_of
from core.calibration.target_shape.estimation import (
    MIN_DIRECTIONS,
    estimate_target_shape,
)
from core.calibration.target_shape.normal_equations import SeenPoints, ShapeState, normals_at, residuals_at
from core.calibration.target_shape.planar_views import count_directions
from core.errors import InvalidArgument, TargetShapeNotObservable
from core.geometry.camera import Camera, project
from core.geometry.lens_models import lens_model_of
from core.geometry.se3 import so3_exp, transform_points
from core.targets.specification import GridPoints, TargetSpec
from tests.support.simulation.scenes import standard_camera
from tests.support.simulation.simulated_views import draw_pose
from tests.support.simulation.wide_lenses import draw_session

BOARD = TargetSpec("chessboard", 9, 6, 30.0)
CAMERA = standard_camera()
SIGMA_PX = 0.006
"""What this project's corners have."""


def deviations(seed: int, bow_mm: float, print_mm: float) -> np.ndarray:
    """A board whose middle column stands out, printed with independent errors; the gauge's part taken off."""
    places = BOARD.points_target() - BOARD.points_target().mean(axis=0)
    found = np.zeros_like(places)
    found[:, 2] = bow_mm * (1.0 - (places[:, 0] / places[:, 0].max()) ** 2)
    found[:, :2] += print_mm * np.random.default_rng([seed, 1]).standard_normal((len(places), 2))
    gauge = gauge_of(places)
    return (found.ravel() - gauge @ (gauge.T @ found.ravel())).reshape(-1, 3)


def look(
    seed: int,
    off: np.ndarray,
    *,
    count: int = 14,
    tilt_deg: float = 30.0,
    sigma_px: float = SIGMA_PX,
    camera: Camera = CAMERA,
) -> list[GridPoints]:
    """Views of the board with these deviations, from random sides."""
    rng = np.random.default_rng(seed)
    row, column = (a.ravel() for a in np.mgrid[0 : BOARD.rows, 0 : BOARD.columns])
    views = []
    for _ in range(count):
        T = draw_pose(rng, BOARD, camera, 2448, math.radians(tilt_deg))
        exact = project(transform_points(T, BOARD.points_target() + off), camera)
        noisy = exact + rng.normal(0.0, sigma_px, exact.shape)
        views.append(GridPoints(BOARD, 2448, 2050, column, row, noisy, np.full(len(exact), sigma_px)))
    return views


@pytest.fixture(scope="module")
def bowed() -> tuple[np.ndarray, TargetShape]:
    true = deviations(0, 0.3, 0.03)
    return true, estimate_target_shape(look(0, true))


def test_a_bow_and_print_errors_are_found_within_their_uncertainty(
    bowed: tuple[np.ndarray, TargetShape],
) -> None:
    true, found = bowed
    score = (found.deviations_mm - true) / found.standard_uncertainty_mm
    # 162 coordinates, neighbours correlated: a root mean square of 1 within 4 / √(2 · 81).
    assert np.sqrt(np.mean(score**2)) == pytest.approx(1.0, abs=0.31)
    # A micrometre is what corners of .006 px at .3 mm a px determine in fourteen views.
    assert np.max(found.standard_uncertainty_mm) < 0.003
    assert found.bow_x_mm.value == pytest.approx(0.3, abs=0.02)  # the print's own errors bow, too
    assert abs(found.bow_y_mm.value) < 0.02
    assert found.in_plane.significant
    assert found.out_of_plane.significant
    assert found.in_plane.rms_mm == pytest.approx(
        math.sqrt(float(np.mean(np.sum(true[:, :2] ** 2, axis=1)))),
        abs=4 * found.in_plane.standard_uncertainty_mm,
    )
    assert found.rms_px < 0.05 * found.rms_before_px
    assert found.reduced_chi2 == pytest.approx(1.0, abs=0.15)


def test_the_camera_found_with_the_shape_is_the_true_one(bowed: tuple[np.ndarray, TargetShape]) -> None:
    _, found = bowed
    u = np.sqrt(np.diag(found.camera_covariance))[:8]
    assert np.all(np.abs((found.camera.as_array() - CAMERA.as_array())[:8]) < 4.0 * u)
    assert u[0] < 0.1


def test_a_lens_that_needs_a_third_radial_term_does_not_pass_for_a_bow() -> None:
    wide = Camera(1250.0, 1250.0, 1223.5, 1024.5, -0.3, 0.13, 0.0, 0.0, -0.03)
    true = deviations(4, 0.0, 0.0)
    squares = 0.0
    for seed in range(20, 24):
        found = estimate_target_shape(look(seed, true, camera=wide))
        assert found.reduced_chi2 == pytest.approx(1.0, abs=0.15)
        assert abs(found.camera.k3 - wide.k3) < 4.0 * math.sqrt(found.camera_covariance[8, 8])
        measures = (found.bow_x_mm, found.bow_y_mm, found.twist_mm, found.aspect, found.shear)
        squares += sum((m.value / m.standard_uncertainty) ** 2 for m in measures)
    assert squares == pytest.approx(20.0, abs=4.0 * math.sqrt(2.0 * 20.0))


def test_residuals_smaller_than_stated_make_nothing_surer() -> None:
    views = look(3, np.zeros((BOARD.size, 3)))
    stated = [dataclasses.replace(v, standard_uncertainty_px=4.0 * v.standard_uncertainty_px) for v in views]
    found, less_certain = estimate_target_shape(views), estimate_target_shape(stated)
    assert less_certain.reduced_chi2 == pytest.approx(found.reduced_chi2 / 16.0, rel=0.01)
    for name in ("bow_x_mm", "shear"):
        ratio = getattr(less_certain, name).standard_uncertainty / getattr(found, name).standard_uncertainty
        assert ratio == pytest.approx(4.0 / max(1.0, math.sqrt(found.reduced_chi2)), rel=0.05), name


@pytest.mark.slow
def test_the_covariance_is_that_of_repeated_estimates() -> None:
    # Six estimates: Mahalanobis squares are χ², in all directions of the shape and in the least certain one.
    squares, freedom, least_certain = 0.0, 0, 0.0
    for seed in range(6):
        true = deviations(seed, 0.2, 0.02)
        found = estimate_target_shape(look(100 + seed, true, count=10))
        error = (found.deviations_mm - true).ravel()
        values, vectors = np.linalg.eigh(found.covariance)
        determined = values > 1e-9 * values[-1]
        squares += float(np.sum((vectors[:, determined].T @ error) ** 2 / values[determined]))
        freedom += int(determined.sum())
        least_certain += float((vectors[:, -1] @ error) ** 2 / values[-1])
    assert squares == pytest.approx(freedom, abs=4.0 * math.sqrt(2.0 * freedom))
    assert least_certain < 6.0 + 4.0 * math.sqrt(2.0 * 6.0)


def test_a_perfect_target_is_not_called_bent() -> None:
    found = estimate_target_shape(look(3, np.zeros((BOARD.size, 3))))
    for deviation in (found.in_plane, found.out_of_plane):
        assert not deviation.significant
        assert deviation.rms_mm < 1.5 * deviation.noise_mm
        assert deviation.chi2 == pytest.approx(
            deviation.freedom, abs=5.0 * math.sqrt(2.0 * deviation.freedom)
        )
    assert found.in_plane.freedom == 2 * BOARD.size - 4  # moved, turned and scaled in the plane
    assert found.out_of_plane.freedom == BOARD.size - 3


def test_refined_points_make_the_pose_right(bowed: tuple[np.ndarray, TargetShape]) -> None:
    true, found = bowed
    points = look(7, true, count=1)[0]
    part = points.take(slice(None, None, 2))
    places = found.applied(part).points_target
    np.testing.assert_allclose(places, (BOARD.points_target() + true)[::2], atol=0.005)
    with pytest.raises(InvalidArgument, match="another target"):
        found.applied(dataclasses.replace(points, target=TargetSpec("chessboard", 9, 6, 31.0)))


def test_gross_errors_and_hidden_points_do_no_harm() -> None:
    true = deviations(1, 0.3, 0.03)
    views = look(1, true)
    rng = np.random.default_rng(5)
    for view in views[:5]:
        hit = rng.choice(len(view), 4, replace=False)
        view.points_px[hit] += rng.normal(0.0, 5.0, (4, 2))
    chosen = [np.flatnonzero(rng.random(BOARD.size) < 0.8) for _ in views]
    views = [v.take(c) for v, c in zip(views, chosen, strict=True)]
    found = estimate_target_shape(views)
    score = (found.deviations_mm - true) / found.standard_uncertainty_mm
    assert np.sqrt(np.mean(score**2)) == pytest.approx(1.0, abs=0.31)


def test_what_views_do_not_determine_is_refused_with_advice() -> None:
    nothing = np.zeros((BOARD.size, 3))
    with pytest.raises(TargetShapeNotObservable, match=r"\b5 ") as few:
        estimate_target_shape(look(2, nothing, count=5))
    assert "tilted by 20°" in (few.value.advice or "")
    with pytest.raises(TargetShapeNotObservable, match=r"\b0 "):
        estimate_target_shape(look(2, nothing, tilt_deg=8.0))
    # Images of one pose are one direction, however many.
    views = look(2, nothing, count=6)
    with pytest.raises(TargetShapeNotObservable, match=r"\b6 "):
        estimate_target_shape(views * 4)
    with pytest.raises(TargetShapeNotObservable, match="bow"):
        estimate_target_shape(look(2, nothing, count=9, tilt_deg=12.0, sigma_px=3.0))


def test_bad_input_is_named() -> None:
    with pytest.raises(InvalidArgument, match="At least one view"):
        estimate_target_shape([])
    views = look(0, np.zeros((BOARD.size, 3)), count=2)
    other = dataclasses.replace(views[1], target=TargetSpec("chessboard", 9, 6, 31.0))
    with pytest.raises(InvalidArgument, match="same target"):
        estimate_target_shape([views[0], other])
    fine = TargetSpec("chessboard", 40, 40, 5.0)
    with pytest.raises(InvalidArgument, match="1600 points"):
        estimate_target_shape([dataclasses.replace(views[0], target=fine)])


def test_directions_count_turns_in_the_plane_and_nothing_twice() -> None:
    tilted = so3_exp(np.array([0.5, 0.0, 0.0]))
    turned = [tilted @ so3_exp(np.array([0.0, 0.0, math.radians(a)])) for a in (0.0, 3.0, 7.0, 90.0)]
    assert count_directions(np.array(turned)) == 3
    assert count_directions(np.eye(3)[None]) == 0
    assert MIN_DIRECTIONS == 8


def test_the_eliminated_system_is_that_of_the_whole_jacobian() -> None:
    rng = np.random.default_rng(4)
    places = BOARD.points_target()[:12] - BOARD.points_target()[:12].mean(axis=0)
    rotations = np.array([so3_exp(np.array([0.4, 0.1 * k, -0.2])) for k in range(3)])
    translations = np.array([[5.0 * k, -3.0, 400.0] for k in range(3)])
    state = ShapeState(CAMERA.as_array(), rotations, translations, places)
    views = [
        SeenPoints(
            place := np.sort(rng.choice(12, 9, replace=False)),
            rng.normal(1000.0, 1.0, (9, 2)),
            rng.uniform(0.5, 2.0, len(place)),
        )
        for _ in range(3)
    ]
    weights = [rng.uniform(0.0, 1.0, 9) for _ in views]
    size, step = 9 + 36, 1e-4
    scales = np.concatenate([[1.0] * 4 + [1e-3] * 5, np.ones(36)])

    def stacked(z: np.ndarray, poses: np.ndarray) -> np.ndarray:
        residuals = residuals_at(state.moved(z, poses), views)
        return np.concatenate([(r * np.sqrt(w)).ravel() for r, w in zip(residuals, weights, strict=True)])

    columns = []
    for k in range(size + 18):
        e = np.zeros(size + 18)
        e[k] = step * (scales[k] if k < size else 1.0)
        up, down = (stacked(s * e[:size], s * e[size:].reshape(3, 6)) for s in (1.0, -1.0))
        columns.append((down - up) / (2.0 * e[k]))
    J = np.array(columns).T
    N, b = J.T @ J, J.T @ stacked(np.zeros(size), np.zeros((3, 6)))
    whole = np.zeros(size + 18)
    damped = N.copy()
    damped[:size, :size] += np.diag(1.0 / scales**2)  # as priors would
    whole = np.linalg.solve(damped, b)
    found = normals_at(state, views, weights)
    z = np.linalg.solve(found.information + np.diag(1.0 / scales**2), found.gradient)
    np.testing.assert_allclose(z, whole[:size], rtol=2e-4, atol=1e-6 * np.abs(whole[:size]).max())
    np.testing.assert_allclose(found.poses(z).ravel(), whole[size:], rtol=2e-4, atol=1e-5)


@pytest.mark.parametrize("seed", [3, 4])
def test_a_bow_is_found_before_a_lens_beyond_brown(seed: int) -> None:
    """Brown's model takes what such a lens has beyond it for the print's shape."""
    session = draw_session(np.random.default_rng(seed), "kannala_brandt", images=20, bow_mm=0.3)
    stack = stack_views(session.views)
    choice = select_lens(stack, np.arange(len(stack)), None, estimate_group(stack, "pooled"))
    found = estimate_target_shape(session.views, start=choice.start)
    assert lens_model_of(found.camera) == "kannala_brandt"
    assert found.out_of_plane.significant
    assert found.reduced_chi2 == pytest.approx(1.0, abs=0.15)
    assert found.rms_px < 0.75 * found.rms_before_px
    # The bow is a paraboloid about the board's middle: over its longer side .3 mm, over the shorter (5/8)² of it.
    for measure, true in ((found.bow_x_mm, 0.3), (found.bow_y_mm, 0.3 * (5.0 / 8.0) ** 2)):
        assert abs(abs(measure.value) - true) < 4.0 * measure.standard_uncertainty
        assert measure.standard_uncertainty < 0.05
    f, true_f = (0.5 * (camera.fx_px + camera.fy_px) for camera in (found.camera, session.camera))
    assert abs(f - true_f) < 4.0 * math.sqrt(0.25 * float(found.camera_covariance[:2, :2].sum()))
