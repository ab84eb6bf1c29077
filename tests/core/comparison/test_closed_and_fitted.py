"""The methods ours are compared with: right where their model holds, a named failure where they cannot answer."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from core.calibration.residuals import View
from core.calibration.state import centred, view_residuals
from core.comparison import dlt, opencv_single_image, tsai, zhang
from core.errors import DegenerateGeometry, GridposeError, InvalidArgument
from core.geometry.camera import Camera, project
from core.geometry.se3 import so3_exp, transform, transform_points
from core.targets.specification import GridPoints, TargetSpec
from tests.support.sessions.comparisons import reprojection_of
from tests.support.simulation.simulated_views import draw_view

CENTRE = (1223.5, 1024.5)
TARGET = TargetSpec("chessboard", 14, 10, 10.0)


def view_of(camera: Camera, T: np.ndarray, sigma_px: float = 0.0, seed: int = 0) -> GridPoints:
    row, column = (a.ravel() for a in np.mgrid[0:10, 0:14])
    exact = project(transform_points(T, TARGET.points_target()), camera)
    noise = np.random.default_rng(seed).normal(0.0, sigma_px, exact.shape) if sigma_px else 0.0
    return GridPoints(TARGET, 2448, 2050, column, row, exact + noise, np.full(140, sigma_px or 0.05))


def pose(axis: tuple[float, float], tilt_deg: float, at: tuple[float, float] = (4.0, -3.0)) -> np.ndarray:
    turn = math.radians(tilt_deg) * np.array([*axis, 0.0]) / np.hypot(*axis)
    R = so3_exp(turn) @ so3_exp(np.array([0.0, 0.0, 0.2]))
    return transform(R, np.array([*at, 260.0]) - R @ TARGET.points_target().mean(axis=0))


@pytest.mark.parametrize("tilt", [15.0, 31.0, 60.0])
@pytest.mark.parametrize("axis", [(1.0, 0.0), (0.0, 1.0), (1.0, -0.6), (-1.0, 0.3)])
def test_tsai_recovers_the_truth_of_his_own_model(axis: tuple[float, float], tilt: float) -> None:
    camera = Camera(1.02 * 2300.0, 2300.0, 1200.0, 1040.0, k1=-0.12)
    T = pose(axis, tilt)
    found = tsai(view_of(camera, T), principal_point=(1200.0, 1040.0), aspect=1.02)
    assert found.camera is not None
    np.testing.assert_allclose(found.camera.as_array(), camera.as_array(), rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(found.T_camera_target[0], T, rtol=1e-6, atol=1e-5)
    assert reprojection_of(found).max_px < 1e-6
    assert [w.code for w in found.warnings] == ([] if tilt >= 30 else ["tilt_below_method_limit"])


def test_tsai_needs_no_origin_off_the_axes() -> None:
    """In the printed form t_y = 0 divides by zero; here the grid's middle is on the optical axis."""
    camera = Camera(2300.0, 2300.0, *CENTRE)
    found = tsai(view_of(camera, pose((1.0, 0.4), 35.0, (0.0, 0.0))))
    assert found.camera is not None
    assert found.camera.fx_px == pytest.approx(2300.0, rel=1e-6)


@pytest.mark.parametrize("tilt", [20.0, 45.0])
def test_tsai_is_unbiased_and_near_the_bound(tilt: float) -> None:
    """Against the Cramér-Rao bound of f, the pose and k1; his two stages give a little of it away."""
    camera, T, sigma = Camera(2320.0, 2320.0, *CENTRE, k1=-0.1), pose((1.0, 0.5), tilt), 0.05
    exact = view_of(camera, T)
    state = View(camera.as_array(), T[:3, :3], T[:3, :3] @ centred(exact)[1] + T[:3, 3])
    J = view_residuals(exact, free=True)(state)[1]
    J = np.concatenate([[J[0] + J[1]], J[4:5], J[8:]]).reshape(8, -1)
    bound = sigma * math.sqrt(np.linalg.inv(J @ J.T)[0, 0])
    found = [tsai(view_of(camera, T, sigma, seed + 1)) for seed in range(120)]
    focal = np.array([f.camera.fy_px for f in found if f.camera is not None])
    assert len(focal) == 120
    assert abs(focal.mean() - 2320.0) < 4.0 * focal.std() / math.sqrt(120)
    # A spread is known to 1/√240 = 6.5 %: 3 of those below the bound, and at most half more than it.
    assert 0.8 * bound < focal.std() < 1.5 * 1.2 * bound


def test_tsai_refuses_an_axis_perpendicular_to_the_grid() -> None:
    camera = Camera(2320.0, 2320.0, *CENTRE, k1=-0.1)
    for sigma in (0.0, 0.05):
        for seed in range(20):
            T = transform(so3_exp(np.array([0.0, 0.0, 0.1 * seed])), np.array([-60.0, -40.0, 260.0]))
            with pytest.raises(DegenerateGeometry, match="perpendicular") as failure:
                tsai(view_of(camera, T, sigma, seed + 1))
            assert failure.value.advice is not None
            assert "30°" in failure.value.advice


def test_tsai_never_answers_without_a_warning_below_his_limit() -> None:
    """A principal point 1 % off tilts the view for him: what comes of it is refused or marked."""
    rng = np.random.default_rng(8)
    for tilt in (0.0, 1.0, 5.0):
        for _ in range(25):
            view = draw_view(rng, tilt_deg=tilt)
            try:
                found = tsai(view.points)
            except GridposeError:
                continue
            assert found.camera is not None
            assert np.all(np.isfinite(found.camera.as_array()))
            assert found.warnings


def test_tsai_refuses_what_it_cannot_take() -> None:
    points = view_of(Camera(2320.0, 2320.0, *CENTRE), pose((1.0, 0.5), 30.0))
    with pytest.raises(InvalidArgument):
        tsai(points, aspect=-1.0)
    bowed = TARGET.points_target()
    bowed[5, 2] = 0.3
    with pytest.raises(DegenerateGeometry, match="flat"):
        tsai(dataclasses.replace(points, measured_points_target=bowed))
    for rows, words in ((slice(0, 7), "at least 8"), (slice(0, 14), "one line")):
        part = points.take(rows)
        with pytest.raises(DegenerateGeometry, match=words):
            tsai(part)


def test_the_dlt_of_a_plane_is_exact_without_distortion() -> None:
    camera, T = Camera(2320.0, 2400.0, *CENTRE), pose((1.0, 0.6), 30.0)
    found = dlt(view_of(camera, T))
    assert found.camera is not None
    np.testing.assert_allclose(found.camera.as_array(), camera.as_array(), rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(found.T_camera_target[0], T, rtol=1e-6, atol=1e-5)


def test_the_dlt_leaves_distortion_in_the_residuals_and_noise_as_it_is() -> None:
    T, sigma = pose((1.0, 0.6), 30.0), 0.05
    found = dlt(view_of(Camera(2320.0, 2320.0, *CENTRE), T, sigma, 1))
    # Eight of 280 observations are used up; the mean of a 2-D distance is √(π/4) of its rms.
    rms = sigma * math.sqrt(2.0 * (1.0 - 8.0 / 280.0))
    assert reprojection_of(found).rms_px == pytest.approx(rms, rel=4.0 / math.sqrt(2 * 272))
    assert reprojection_of(found).mean_px == pytest.approx(rms * math.sqrt(math.pi / 4), rel=0.15)
    distorted = dlt(view_of(Camera(2320.0, 2320.0, *CENTRE, k1=-0.1), T, sigma, 1))
    assert reprojection_of(distorted).rms_px > 5 * rms


def test_the_dlt_maps_where_it_gives_no_camera() -> None:
    for axis, tilt in (((1.0, 0.0), 30.0), ((1.0, 0.0), 0.0)):
        R = so3_exp(math.radians(tilt) * np.array([*axis, 0.0]))
        T = transform(R, np.array([0.0, 0.0, 260.0]) - R @ TARGET.points_target().mean(axis=0))
        found = dlt(view_of(Camera(2320.0, 2320.0, *CENTRE), T))
        assert found.camera is None
        assert found.T_camera_target == ()
        assert [w.code for w in found.warnings] == ["camera_not_observable"]
        assert reprojection_of(found).max_px < 1e-6


def test_zhang_recovers_the_truth_from_exact_views() -> None:
    camera = Camera(2320.0, 2340.0, 1200.0, 1040.0, -0.1, 0.05, 2e-4, -1e-4)
    poses = [pose(axis, 30.0) for axis in ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.4), (0.3, -1.0))]
    found = zhang([view_of(camera, T) for T in poses])
    assert found.camera is not None
    # OpenCV takes pixels as float32: 1e-4 px.
    np.testing.assert_allclose(found.camera.as_array()[:4], camera.as_array()[:4], rtol=1e-5)
    np.testing.assert_allclose(found.camera.as_array()[4:], camera.as_array()[4:], atol=1e-4)
    np.testing.assert_allclose(found.T_camera_target, poses, atol=2e-3)
    assert len(found.residuals_px) == 4
    assert found.warnings == ()


def test_zhang_fails_with_one_view_and_says_when_views_determine_nothing() -> None:
    camera = Camera(2320.0, 2320.0, *CENTRE, -0.1, 0.05)
    with pytest.raises(DegenerateGeometry, match="at least two views"):
        zhang([view_of(camera, pose((1.0, 0.5), 30.0), 0.05)])
    flat = transform(np.eye(3), np.array([-60.0, -40.0, 260.0]))
    parallel = [view_of(camera, flat, 0.05, i + 1) for i in range(3)]
    assert [w.code for w in zhang(parallel).warnings] == ["focal_not_observable"]
    other = dataclasses.replace(parallel[0], image_width_px=1000)
    with pytest.raises(InvalidArgument, match="same image size"):
        zhang([parallel[0], other])


def test_opencv_on_one_view_answers_whatever_it_is_shown() -> None:
    camera = Camera(2320.0, 2320.0, *CENTRE, -0.1, 0.05)
    good = opencv_single_image(view_of(camera, pose((1.0, 0.5), 40.0)))
    assert good.camera is not None
    assert good.camera.fx_px == pytest.approx(2320.0, rel=1e-3)
    flat = transform(np.eye(3), np.array([-60.0, -40.0, 260.0]))
    off = []
    for seed in range(10):
        nonsense = opencv_single_image(view_of(camera, flat, 0.05, seed + 1))
        assert nonsense.camera is not None
        assert reprojection_of(nonsense).rms_px < 0.08
        assert [w.code for w in nonsense.warnings] == ["focal_not_observable"]
        off.append(abs(nonsense.camera.fx_px / 2320.0 - 1.0))
    assert np.median(off) > 0.2
