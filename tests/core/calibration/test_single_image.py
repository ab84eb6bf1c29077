"""One image: the truth recovered, and gross errors survived."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from core.calibration.closed_form import ClosedForm
from core.calibration.priors import PRINCIPAL_POINT_PRIOR, RADIAL_PRIORS, TANGENTIAL_PRIOR, Lens, view_prior
from core.calibration.single_image import calibrate_points
from core.calibration.state import FREE, centred, retract, view_of, view_residuals
from core.errors import FocalNotObservable
from core.geometry.camera import Camera, project
from core.geometry.se3 import invert, so3_log, transform, transform_points
from core.targets.specification import GridPoints
from tests.support.simulation.simulated_views import View, draw_view


def errors_in_sigmas(view: View, **options: object) -> np.ndarray:
    """Errors of camera (8) and pose (6), in units of their stated standard uncertainties."""
    found = calibrate_points(view.points, **options)  # type: ignore[arg-type]
    T_target_camera = invert(view.T_camera_target)
    camera = (view.camera.as_array() - found.camera.as_array())[:8] / found.camera_standard_uncertainty[:8]
    position = T_target_camera[:3, 3] - found.pose.position_mm
    rotation = so3_log(T_target_camera[:3, :3] @ found.pose.rotation.T)
    pose = np.concatenate([position, rotation]) / np.sqrt(np.diag(found.pose.covariance))
    return np.concatenate([camera, pose])


def spoiled(points: GridPoints, rng: np.random.Generator, share: float, size_px: float) -> GridPoints:
    px = points.points_px.copy()
    wrong = rng.permutation(len(px))[: int(share * len(px))]
    px[wrong] += size_px * rng.choice([-1.0, 1.0], (len(wrong), 2))
    return dataclasses.replace(points, points_px=px)


@pytest.mark.parametrize("tilt", [30, 45, 60])
def test_exact_points_of_a_centred_camera_give_the_exact_answer(tilt: float) -> None:
    rng = np.random.default_rng(tilt)
    camera = Camera(
        0.8 * 2448, 0.8 * 2448, 1223.5, 1024.5
    )  # at the priors' centres, so that they pull nowhere
    view = draw_view(rng, tilt_deg=tilt, sigma_px=0.0, camera=camera)
    points = dataclasses.replace(view.points, standard_uncertainty_px=np.full(len(view.points), 0.05))
    found = calibrate_points(points)
    assert found.reprojection.rms_px < 1e-6
    np.testing.assert_allclose(found.camera.as_array()[:4], camera.as_array()[:4], rtol=1e-6)
    np.testing.assert_allclose(found.T_camera_target, view.T_camera_target, rtol=1e-5, atol=1e-5)


def test_residual_derivatives_match_differences() -> None:
    view = draw_view(np.random.default_rng(2), tilt_deg=35.0)
    state = view_of(ClosedForm(view.camera, view.T_camera_target), view.points)
    evaluate = view_residuals(view.points, free=True)
    _, jacobian = evaluate(state)
    for index in range(len(FREE)):
        h = 1e-3 if index < 4 else 1e-6
        step = np.zeros(len(FREE))
        step[index] = h
        plus, minus = evaluate(retract(state, step))[0], evaluate(retract(state, -step))[0]
        np.testing.assert_allclose(jacobian[index], (minus - plus) / (2 * h), rtol=1e-4, atol=2e-3)


@pytest.mark.parametrize("lens", [None, Lens(8.0, 3.45)])
def test_prior_derivatives_match_differences(lens: Lens | None) -> None:
    view = draw_view(np.random.default_rng(3))
    state = view_of(ClosedForm(view.camera, view.T_camera_target), view.points)
    prior = view_prior(view.points, lens)
    Q = prior(state)[1].copy()
    for index in range(8):
        step = np.zeros(len(FREE))
        step[index] = h = 1e-3 if index < 4 else 1e-7
        difference = (prior(retract(state, -step))[0] - prior(retract(state, step))[0]) / (2 * h)
        np.testing.assert_allclose(Q[:, index], difference, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("tilt", [30, 45, 60])
def test_noise_leaves_errors_of_the_stated_size(tilt: float) -> None:
    rng = np.random.default_rng(100 + tilt)
    views = (draw_view(rng, tilt_deg=tilt, sigma_px=0.02) for _ in range(25))
    z = np.array([errors_in_sigmas(view) for view in views])
    # 350 roughly normal figures, correlated within a view: their rms is 1 within a quarter.
    assert 0.75 < math.sqrt(np.mean(z**2)) < 1.25
    assert np.max(np.abs(z)) < 5.0


def test_a_fifth_of_gross_errors_is_rejected() -> None:
    rng = np.random.default_rng(9)
    view = draw_view(rng, tilt_deg=30.0)
    bad = spoiled(view.points, rng, 0.2, 20.0)
    found = calibrate_points(bad)
    assert found.reprojection.rejected == int(0.2 * len(bad))
    assert "many_points_rejected" in {w.code for w in found.warnings}
    assert np.max(np.abs(errors_in_sigmas(dataclasses.replace(view, points=bad)))) < 5.0


def test_a_lens_prior_makes_a_fronto_parallel_view_usable() -> None:
    rng = np.random.default_rng(21)
    for _ in range(5):
        view = draw_view(rng, tilt_deg=1.0)
        lens = Lens(view.camera.fx_px * math.exp(rng.normal(0.0, 0.05)) * 3.45e-3, 3.45)
        found = calibrate_points(view.points, lens=lens)
        assert found.observability.focal_relative_uncertainty < 0.06  # the prior's 5 %, somewhat inflated
        assert {"fx_px", "fy_px"} <= set(found.observability.prior_dominated)
        assert np.max(np.abs(errors_in_sigmas(view, lens=lens))) < 5.0


def test_a_lens_that_contradicts_the_image_is_remarked_on() -> None:
    view = draw_view(np.random.default_rng(4), tilt_deg=45.0)
    found = calibrate_points(view.points, lens=Lens(16.0, 3.45))
    assert "focal_prior_inconsistent" in {w.code for w in found.warnings}
    assert found.camera.fx_px == pytest.approx(view.camera.fx_px, rel=0.05)


def test_given_intrinsics_leave_only_the_pose() -> None:
    rng = np.random.default_rng(31)
    z = []
    for tilt in (0.0, 5.0, 30.0, 60.0) * 5:
        view = draw_view(rng, tilt_deg=tilt)
        found = calibrate_points(view.points, intrinsics=view.camera)
        assert found.estimator == "given"
        assert found.camera == view.camera
        assert not found.camera_standard_uncertainty.any()
        np.testing.assert_allclose(
            found.pose.covariance, found.pose.covariance_given_camera, rtol=1e-6, atol=1e-15
        )
        T = invert(view.T_camera_target)
        error = np.concatenate(
            [T[:3, 3] - found.pose.position_mm, so3_log(T[:3, :3] @ found.pose.rotation.T)]
        )
        z.append(error / np.sqrt(np.diag(found.pose.covariance)))
    assert 0.75 < math.sqrt(np.mean(np.square(z))) < 1.25


def test_given_intrinsics_are_called_into_question_where_the_image_contradicts_them() -> None:
    view = draw_view(np.random.default_rng(5), tilt_deg=30.0)
    for factor in (1.0, 1.02):
        stated = dataclasses.replace(
            view.camera, fx_px=factor * view.camera.fx_px, fy_px=factor * view.camera.fy_px
        )
        found = calibrate_points(view.points, intrinsics=stated)
        (warning,) = (w for w in found.warnings if w.code == "intrinsics_without_uncertainty")
        assert (warning.advice is not None) == (factor != 1.0)


def test_the_covariance_given_camera_is_the_smaller() -> None:
    found = calibrate_points(draw_view(np.random.default_rng(5)).points)
    difference = found.pose.covariance - found.pose.covariance_given_camera
    assert np.linalg.eigvalsh(difference)[0] > -1e-12


def test_angle_uncertainties_are_those_of_the_rotation() -> None:
    found = calibrate_points(draw_view(np.random.default_rng(6), tilt_deg=30.0).points)
    assert np.all(found.pose.roll_pitch_yaw_standard_uncertainty > 0)
    total = np.linalg.norm(found.pose.roll_pitch_yaw_standard_uncertainty)
    assert total == pytest.approx(math.sqrt(np.trace(found.pose.covariance[3:, 3:])), rel=0.6)


def test_the_scale_of_the_print_is_in_the_absolute_position_only() -> None:
    view = draw_view(np.random.default_rng(7), tilt_deg=45.0)
    sure = calibrate_points(view.points, intrinsics=view.camera)
    target = dataclasses.replace(view.points.target, pitch_standard_uncertainty_mm=0.01)
    unsure = calibrate_points(dataclasses.replace(view.points, target=target), intrinsics=view.camera)
    p = sure.pose.position_mm
    expected = sure.pose.covariance[:3, :3] + np.outer(p, p) * (0.01 / 10.0) ** 2
    np.testing.assert_allclose(unsure.pose.covariance[:3, :3], expected, rtol=1e-9)
    np.testing.assert_allclose(
        unsure.pose.covariance_given_camera, sure.pose.covariance_given_camera, rtol=1e-9
    )


def test_a_bowed_print_raises_the_stated_uncertainty() -> None:
    """A print that bulges by a tenth of a millimetre leaves residuals that resemble their neighbours'."""
    view = draw_view(np.random.default_rng(8), tilt_deg=55.0, columns=25, rows=18)
    target = view.points.points_target
    middle = (target - target.mean(axis=0)) / np.ptp(target, axis=0).max()
    bowed = target.copy()
    bowed[:, 2] = 0.1 * np.sin(9.0 * middle[:, 0]) * np.cos(7.0 * middle[:, 1])
    px = project(transform_points(view.T_camera_target, bowed), view.camera)
    found = calibrate_points(dataclasses.replace(view.points, points_px=px))
    flat = calibrate_points(view.points)
    assert "residuals_correlated" in {w.code for w in found.warnings}
    assert "residuals_exceed_noise" in {w.code for w in found.warnings}
    # Nearly all of the flat print's u(f) is what the priors leave, and that is the bowed one's, too.
    assert (
        found.observability.focal_relative_uncertainty > 1.1 * flat.observability.focal_relative_uncertainty
    )
    ratio = np.diag(found.pose.covariance_given_camera) / np.diag(flat.pose.covariance_given_camera)
    assert np.all(ratio > 5.0**2)
    assert "residuals_correlated" not in {w.code for w in flat.warnings}
    # The data are worth less by that, the priors are not: nothing is less certain than they leave it.
    assert found.inflation > 5.0
    widths = [PRINCIPAL_POINT_PRIOR * 2448] * 2 + list(RADIAL_PRIORS) + [TANGENTIAL_PRIOR] * 2
    assert np.all(found.camera_standard_uncertainty[2:8] < np.array(widths) * 1.001)


def test_the_centroid_frame_is_only_internal() -> None:
    view = draw_view(np.random.default_rng(12))
    target, centroid = centred(view.points)
    np.testing.assert_allclose(target + centroid, view.points.points_target)
    state = view_of(ClosedForm(view.camera, view.T_camera_target), view.points)
    T = transform(state.rotation, state.translation_mm - state.rotation @ centroid)
    np.testing.assert_allclose(T, view.T_camera_target, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(("columns", "rows", "sigma"), [(14, 10, 0.05), (9, 6, 0.02), (25, 18, 0.1)])
def test_stated_intervals_cover_at_tilts_from_ten_degrees(columns: int, rows: int, sigma: float) -> None:
    """Coverage of 95 % intervals over tilts 10-60°, every parameter by itself."""
    rng = np.random.default_rng(columns)
    z = []
    while len(z) < 400:
        view = draw_view(rng, columns=columns, rows=rows, sigma_px=sigma, tilt_deg=rng.uniform(10, 60))
        try:
            z.append(errors_in_sigmas(view))
        except FocalNotObservable:
            continue
    coverage = np.mean(np.abs(z) < 1.96, axis=0)
    # Binomial: σ = 1.1 % at 400 trials; the worst of 14 within 3.5 σ, the mean over parameters within 2 %.
    assert np.all(np.abs(coverage - 0.95) < 3.5 * math.sqrt(0.95 * 0.05 / 400)), coverage
    assert abs(np.mean(coverage) - 0.95) < 0.02


def test_points_the_detector_distrusts_are_counted_as_rejected() -> None:
    view = draw_view(np.random.default_rng(13))
    px, uncertainty = view.points.points_px.copy(), view.points.standard_uncertainty_px.copy()
    px[17] += 1.5
    uncertainty[17] = 1.0
    uncertain = dataclasses.replace(view.points, points_px=px, standard_uncertainty_px=uncertainty)
    found = calibrate_points(uncertain)
    assert not found.used[17]
    assert found.reprojection.rejected == 1
    assert found.reprojection.max_px < 0.5
    assert found.camera.fx_px == pytest.approx(calibrate_points(view.points).camera.fx_px, rel=1e-3)


@pytest.mark.parametrize("intrinsics", [False, True])
def test_holes_in_the_grid_cost_points_and_nothing_else(intrinsics: bool) -> None:
    """A third of the points missing, in any order, the origin, a whole row and a corner among them."""
    rng = np.random.default_rng(14)
    z = []
    for _ in range(25):
        view = draw_view(rng, tilt_deg=40.0)
        points = view.points
        there = (
            (rng.random(len(points)) > 0.25) & (points.row != 4) & ((points.column > 2) | (points.row > 2))
        )
        kept = rng.permutation(np.flatnonzero(there))
        partial = points.take(kept)
        options = {"intrinsics": view.camera} if intrinsics else {}
        found = calibrate_points(partial, **options)  # type: ignore[arg-type]
        assert found.points is partial
        assert found.residuals_px.shape == (len(kept), 2)
        assert found.reprojection.points + found.reprojection.rejected == len(kept)
        T = invert(view.T_camera_target)
        error = np.concatenate(
            [T[:3, 3] - found.pose.position_mm, so3_log(T[:3, :3] @ found.pose.rotation.T)]
        )
        z.append(error / np.sqrt(np.diag(found.pose.covariance)))
    # 150 roughly normal figures, correlated within a view.
    assert 0.7 < math.sqrt(np.mean(np.square(z))) < 1.3


def test_very_precise_corners_are_believed_no_more_than_they_deserve() -> None:
    """At .003 px nothing in the fit may replace the noise: errors still have the stated size."""
    rng = np.random.default_rng(15)
    views = [draw_view(rng, tilt_deg=35.0, sigma_px=0.003) for _ in range(25)]
    z = np.array([errors_in_sigmas(view) for view in views])
    assert 0.75 < math.sqrt(np.mean(z**2)) < 1.25
    assert np.max(np.abs(z)) < 5.0
    # A print off by a hundredth of a millimetre here and there: far more than the corners' noise, and reported as such.
    target = views[0].points.points_target + rng.normal(0.0, 0.01, (140, 3)) * [1.0, 1.0, 0.0]
    px = project(transform_points(views[0].T_camera_target, target), views[0].camera)
    rough = calibrate_points(dataclasses.replace(views[0].points, points_px=px))
    smooth = calibrate_points(views[0].points)
    assert "residuals_exceed_noise" in {w.code for w in rough.warnings}
    ratio = rough.observability.focal_relative_uncertainty / smooth.observability.focal_relative_uncertainty
    assert ratio > 5.0


def test_a_long_way_along_the_valley_is_walked_to_its_end() -> None:
    """At .002 px one of these views takes 122 steps: f, depth, tilt and distortion move together, by little."""
    rng = np.random.default_rng(9020)
    views = [draw_view(rng, columns=9, rows=6, sigma_px=0.002, tilt_deg=20.0) for _ in range(40)]
    z = np.array([errors_in_sigmas(view) for view in views])
    assert np.max(np.abs(z)) < 5.0
