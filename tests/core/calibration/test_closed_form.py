"""Closed forms: exact on exact points, and honest where a view or the printed method determines nothing."""

from __future__ import annotations

import math

import numpy as np
import pytest

from core.calibration.closed_form import ClosedForm, nullspace, vanishing_point
from core.errors import DegenerateGeometry
from core.geometry.camera import Camera, project
from core.geometry.se3 import so3_exp, transform, transform_points
from core.targets.specification import GridPoints, TargetSpec
from tests.support.simulation.simulated_views import draw_view

CENTRE = (1223.5, 1024.5)


def exact_view(
    axis: tuple[float, float, float], tilt_deg: float, fy: float = 2320.0
) -> tuple[GridPoints, ClosedForm]:
    """Noise-free points of a distortion-free camera with its principal point in the middle."""
    target = TargetSpec("chessboard", 14, 10, 10.0)
    camera = Camera(2320.0, fy, *CENTRE)
    R = so3_exp(math.radians(tilt_deg) * np.array(axis) / np.linalg.norm(axis)) @ so3_exp(
        np.array([0, 0, 0.2])
    )
    T = transform(R, np.array([4.0, -3.0, 260.0]) - R @ target.points_target().mean(axis=0))
    row, column = (a.ravel() for a in np.mgrid[0:10, 0:14])
    px = project(transform_points(T, target.points_target()), camera)
    return GridPoints(target, 2448, 2050, column, row, px, np.full(140, 0.05)), ClosedForm(camera, T)


def assert_same(found: ClosedForm, truth: ClosedForm) -> None:
    np.testing.assert_allclose(found.camera.as_array(), truth.camera.as_array(), rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(found.T_camera_target, truth.T_camera_target, rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize("tilt", [10, 30, 60])
@pytest.mark.parametrize("fy", [2320.0, 2400.0])
def test_variants_with_two_focal_lengths_are_exact(tilt: float, fy: float) -> None:
    points, truth = exact_view((1.0, 0.6, 0.0), tilt, fy)
    assert_same(nullspace(points, CENTRE), truth)
    assert_same(vanishing_point(points, CENTRE, single_focal=False), truth)


@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (1.0, 0.6, 0.0)])
def test_one_focal_length_is_exact_whatever_the_tilt_axis(axis: tuple[float, float, float]) -> None:
    points, truth = exact_view(axis, 30)
    assert_same(vanishing_point(points, CENTRE), truth)


@pytest.mark.parametrize("solve", [nullspace, vanishing_point])
def test_a_fronto_parallel_view_is_degenerate(solve) -> None:  # type: ignore[no-untyped-def]
    points, _ = exact_view((1.0, 0.0, 0.0), 0.0)
    with pytest.raises(DegenerateGeometry):
        solve(points, CENTRE)


def test_tilt_about_an_image_axis_leaves_two_focal_lengths_undetermined() -> None:
    target = TargetSpec("chessboard", 14, 10, 10.0)
    R = so3_exp(np.array([math.radians(30), 0.0, 0.0]))
    T = transform(R, np.array([-65.0, -45.0, 260.0]))
    row, column = (a.ravel() for a in np.mgrid[0:10, 0:14])
    px = project(transform_points(T, target.points_target()), Camera(2320.0, 2320.0, *CENTRE))
    points = GridPoints(target, 2448, 2050, column, row, px, np.full(140, 0.05))
    with pytest.raises(DegenerateGeometry):
        vanishing_point(points, CENTRE, single_focal=False)


def test_the_printed_variant_is_rank_deficient_and_its_principal_point_an_artefact() -> None:
    """Equations (19)-(22) as printed, exact points and the true r31, r32, tz: the column h = x r31 + y r32 + tz is a
    combination of the others, and its coefficient by pseudo-inverse is not the principal point's.
    """
    ratios, errors = [], []
    for seed in range(40):
        points, truth = exact_view((1.0, 0.2 + 0.02 * seed, 0.0), 25.0 + 0.5 * seed)
        T = truth.T_camera_target
        x, y = points.points_target[:, :2].T / 100.0
        h = x * T[2, 0] + y * T[2, 1] + T[2, 3] / 100.0
        about = points.points_px.mean(axis=0)
        L3 = np.stack([x, y, h, np.ones_like(x)], axis=1)
        singular = np.linalg.svd(L3, compute_uv=False)
        ratios.append(singular[3] / singular[0])
        found = np.linalg.pinv(L3, rcond=1e-12) @ ((points.points_px - about) / 1000.0 * h[:, None])
        errors.append(np.linalg.norm(about + 1000.0 * found[2] - CENTRE))
    assert max(ratios) < 1e-12
    assert np.median(errors) > 50.0  # noise-free, and still far off


def test_variant_a_needs_the_origin_and_both_axes() -> None:
    points, _ = exact_view((1.0, 0.6, 0.0), 30)
    keep = ~((points.column == 0) & (points.row == 0))
    partial = points.take(keep)
    with pytest.raises(DegenerateGeometry, match="origin"):
        nullspace(partial, CENTRE)
    assert vanishing_point(partial, CENTRE).camera.fx_px == pytest.approx(2320.0, rel=1e-5)


def test_with_noise_the_single_focal_form_rarely_fails_from_ten_degrees_up() -> None:
    rng = np.random.default_rng(11)
    failures, errors = 0, []
    for _ in range(100):
        view = draw_view(rng, tilt_deg=20.0)
        try:
            found = vanishing_point(view.points, CENTRE)
        except DegenerateGeometry:
            failures += 1
            continue
        errors.append(abs(found.camera.fx_px / view.camera.fx_px - 1.0))
    assert failures <= 2
    # It ignores distortion and takes the principal point for the centre: a start, good to a tenth or so.
    assert np.median(errors) < 0.15
