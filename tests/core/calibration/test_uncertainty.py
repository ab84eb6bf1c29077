"""From a fit's covariance to what is reported, each step by itself."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from scipy.special import chdtri

from core.calibration.closed_form import ClosedForm
from core.calibration.priors import Lens
from core.calibration.single_image import calibrate_points
from core.calibration.state import POSE, view_of, view_residuals
from core.calibration.summary import summarise_fit
from core.calibration.uncertainty import camera_pose, correlation_inflation, reprojection
from core.errors import FocalNotObservable
from core.geometry.roll_pitch_yaw import rotation_to_rpy
from core.geometry.se3 import invert, so3_exp, so3_log, transform
from core.numerics.least_squares import Fit
from tests.support.simulation.simulated_views import View, draw_view


def random_covariance(rng: np.random.Generator) -> np.ndarray:
    A = rng.normal(size=(6, 6)) * np.array([1e-4, 2e-4, 3e-4, 0.1, 0.2, 0.3])[:, None]
    return A @ A.T


def test_the_cameras_pose_and_covariance_match_differences() -> None:
    """Every entry, the position-rotation ones too, against T_camera_target perturbed entry by entry."""
    rng = np.random.default_rng(1)
    R, t = so3_exp(np.array([0.4, -0.3, 1.1])), np.array([12.0, -30.0, 400.0])
    covariance, conditional = random_covariance(rng), random_covariance(rng)
    pose = camera_pose(R, t, covariance, conditional, np.zeros(6))
    exact = invert(transform(R, t))
    np.testing.assert_allclose(pose.position_mm, exact[:3, 3])
    np.testing.assert_allclose(pose.rotation, exact[:3, :3])
    J, angles = np.zeros((6, 6)), np.zeros((3, 6))
    for k in range(6):
        h = 1e-6
        step = np.zeros(6)
        step[k] = h
        moved = invert(transform(so3_exp(step[:3]) @ R, t + step[3:]))
        J[:3, k] = (moved[:3, 3] - exact[:3, 3]) / h
        J[3:, k] = so3_log(moved[:3, :3] @ exact[:3, :3].T) / h
        angles[:, k] = (rotation_to_rpy(moved[:3, :3]) - rotation_to_rpy(exact[:3, :3])) / h
    np.testing.assert_allclose(pose.covariance, J @ covariance @ J.T, rtol=1e-3, atol=1e-9)
    np.testing.assert_allclose(pose.covariance_given_camera, J @ conditional @ J.T, rtol=1e-3, atol=1e-9)
    expected = np.sqrt(np.diag(angles @ covariance @ angles.T))
    np.testing.assert_allclose(pose.roll_pitch_yaw_standard_uncertainty, expected, rtol=1e-3)


def test_reprojection_statistics_by_hand() -> None:
    residuals = np.array([[3.0, 4.0], [0.0, 1.0], [0.6, 0.8], [100.0, 0.0]])
    found = reprojection(residuals, np.array([True, True, True, False]))
    assert found.mean_px == pytest.approx(7.0 / 3.0)
    assert found.rms_px == pytest.approx(math.sqrt(27.0 / 3.0))
    assert found.std_px == pytest.approx(math.sqrt(((5 - 7 / 3) ** 2 + 2 * (1 - 7 / 3) ** 2) / 2))
    assert (found.max_px, found.points, found.rejected) == (pytest.approx(5.0), 3, 1)


def residual_fit(view: View, residuals: np.ndarray) -> Fit:  # type: ignore[type-arg]
    """A finished fit with these residuals and no parameters that could explain any of them."""
    state = view_of(ClosedForm(view.camera, view.T_camera_target), view.points)
    _, jacobian = view_residuals(view.points, free=False)(state)
    return Fit(
        state=state,
        status="converged",
        covariance=np.zeros((6, 6)),
        information=np.eye(6),
        condition_number=1.0,
        residuals=residuals,
        jacobian=jacobian,
        used=np.ones(residuals.shape[1], bool),
        scale=float(np.sqrt(np.mean(residuals**2))),
        degrees_of_freedom=float(residuals.size),
        iterations=1,
    )


def test_white_residuals_do_not_inflate_and_smooth_ones_do() -> None:
    view = draw_view(np.random.default_rng(2), columns=25, rows=18)
    rng = np.random.default_rng(3)
    white = [
        correlation_inflation(view.points, residual_fit(view, rng.normal(size=(2, 450))))[0]
        for _ in range(200)
    ]
    assert np.mean(white) < 1.03
    # A first-order autoregression along both axes with ρ = .5: inflation (1 + ρ)/(1 - ρ) = 3.
    found = []
    for _ in range(50):
        field = rng.normal(size=(2, 18, 25))
        for c in range(1, 25):
            field[:, :, c] = 0.5 * field[:, :, c - 1] + math.sqrt(0.75) * field[:, :, c]
        for r in range(1, 18):
            field[:, r] = 0.5 * field[:, r - 1] + math.sqrt(0.75) * field[:, r]
        found.append(correlation_inflation(view.points, residual_fit(view, field.reshape(2, -1)))[0])
    assert np.mean(found) == pytest.approx(3.0, abs=0.25)


def test_points_of_unequal_uncertainty_count_by_their_weight() -> None:
    """The least certain twentieth of the points has a smooth error: nearly no weight, and next to no inflation."""
    view = draw_view(np.random.default_rng(2), columns=25, rows=18)
    rng, poor = np.random.default_rng(3), view.points.column == 24
    u = np.where(poor, 1.0, 0.05)
    points = dataclasses.replace(view.points, standard_uncertainty_px=u)
    found = []
    for _ in range(50):
        residuals = 0.05 * rng.normal(size=(2, 450))
        residuals[:, poor] = rng.choice([-1.0, 1.0])
        weighted = residuals * u.mean() / u
        fit = dataclasses.replace(residual_fit(view, residuals), scale=float(np.sqrt(np.mean(weighted**2))))
        found.append(correlation_inflation(points, fit)[0])
    assert np.mean(found) < 1.15


def test_too_few_residuals_determine_nothing() -> None:
    view = draw_view(np.random.default_rng(2))
    fit = residual_fit(view, np.full((2, 140), 0.5))
    assert summarise_fit(view.points, "nominal", fit, POSE, smallest_scale=1.0).inflation == 1.0
    assert summarise_fit(view.points, "nominal", fit, POSE, smallest_scale=0.1).inflation > 3.0


def poses_in_sigmas(views: list[View], **options: object) -> tuple[np.ndarray, np.ndarray]:
    """Angle errors in their stated uncertainties (n, 3), and d² of the pose and of its position (n, 2)."""
    z, d2 = [], []
    for view in views:
        found = calibrate_points(view.points, **options)  # type: ignore[arg-type]
        T = invert(view.T_camera_target)
        error = rotation_to_rpy(T[:3, :3]) - found.pose.roll_pitch_yaw
        error = (error + math.pi) % (2 * math.pi) - math.pi
        z.append(error / found.pose.roll_pitch_yaw_standard_uncertainty)
        e = np.concatenate([T[:3, 3] - found.pose.position_mm, so3_log(T[:3, :3] @ found.pose.rotation.T)])
        C = found.pose.covariance
        d2.append([e @ np.linalg.solve(C, e), e[:3] @ np.linalg.solve(C[:3, :3], e[:3])])
    return np.array(z), np.array(d2)


def test_angles_scatter_as_stated_each_by_itself() -> None:
    """Given intrinsics, tilts to 60°: pitch far from 0, so that roll and yaw have uncertainties of their own."""
    rng = np.random.default_rng(4)
    camera = draw_view(rng).camera
    views = [draw_view(rng, tilt_deg=60.0, camera=camera) for _ in range(300)]
    z, d2 = poses_in_sigmas(views, intrinsics=camera)
    # The rms of 300 standard normals is 1 within 4.1 % (1 σ); of d² with 6 degrees the mean 6 within .2.
    np.testing.assert_allclose(np.sqrt(np.mean(z**2, axis=0)), 1.0, atol=0.15)
    assert np.mean(d2[:, 0]) == pytest.approx(6.0, abs=0.8)


@pytest.mark.parametrize(
    ("sigma_px", "columns", "rows"),
    [
        (0.05, 14, 10),
        pytest.param(0.02, 14, 10, marks=pytest.mark.slow),
        pytest.param(0.05, 9, 6, marks=pytest.mark.slow),
        pytest.param(0.2, 25, 18, marks=pytest.mark.slow),
    ],
)
def test_regions_of_the_pose_hold_the_truth(sigma_px: float, columns: int, rows: int) -> None:
    """All free, weak views too: the 95 % regions of the pose and of the position, which the valley of f leaves."""
    rng = np.random.default_rng(5)
    views = [
        draw_view(rng, tilt_deg=rng.uniform(15.0, 60.0), sigma_px=sigma_px, columns=columns, rows=rows)
        for _ in range(300)
    ]
    _, squares = poses_in_sigmas(views)
    held = np.mean(squares < chdtri([6.0, 3.0], 0.05), axis=0)
    # Three binomial standard deviations of 300 views. An ellipsoid about the valley is wider than it: more is well.
    assert np.all(held > 0.95 - 3.0 * np.sqrt(0.95 * 0.05 / 300.0)), held
    assert 4.5 < np.mean(squares[:, 0]) < 7.0


@pytest.mark.slow
@pytest.mark.parametrize(("columns", "rows"), [(3, 3), (4, 3), (5, 4)])
def test_small_grids_keep_their_coverage(columns: int, rows: int) -> None:
    """Ten observations or fewer to spare: the detector's own uncertainty replaces the residuals'."""
    rng = np.random.default_rng(columns * rows)
    z = []
    for _ in range(250):
        view = draw_view(rng, columns=columns, rows=rows, sigma_px=0.02, tilt_deg=rng.uniform(40, 60))
        try:
            found = calibrate_points(view.points)
        except FocalNotObservable:
            continue
        T = invert(view.T_camera_target)
        error = np.concatenate(
            [
                (view.camera.as_array() - found.camera.as_array())[:8],
                T[:3, 3] - found.pose.position_mm,
                so3_log(T[:3, :3] @ found.pose.rotation.T),
            ]
        )
        sigma = np.concatenate(
            [found.camera_standard_uncertainty[:8], np.sqrt(np.diag(found.pose.covariance))]
        )
        z.append(error / sigma)
        assert found.reprojection.rejected <= 1
    assert len(z) > 100
    coverage = np.mean(np.abs(z) < 1.96, axis=0)
    # Binomial at 100 and more: σ ≤ 2.2 %.
    assert np.all(coverage > 0.95 - 4 * 0.022), coverage
    assert np.max(np.abs(z)) < 6.0


def test_prior_dominated_is_about_the_priors() -> None:
    rng = np.random.default_rng(7)
    steep = calibrate_points(draw_view(rng, columns=25, rows=18, tilt_deg=60.0, sigma_px=0.01).points)
    assert not {"k1", "k2", "fx_px"} & set(steep.observability.prior_dominated)
    flat = draw_view(rng, columns=9, rows=6, tilt_deg=25.0, sigma_px=0.6)
    with_lens = calibrate_points(flat.points, lens=Lens(flat.camera.fx_px * 3.45e-3, 3.45))
    assert {"p1", "p2"} <= set(with_lens.observability.prior_dominated)


def test_tilt_is_the_angle_between_axis_and_normal() -> None:
    rng = np.random.default_rng(8)
    for tilt in (25.0, 45.0, 60.0):
        found = calibrate_points(draw_view(rng, tilt_deg=tilt, sigma_px=0.01).points)
        assert math.degrees(found.observability.tilt) == pytest.approx(tilt, abs=1.5)
