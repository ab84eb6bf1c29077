"""Baselines of the paper's references [16] and [17]: right on exact points, and how they fail is named."""

from __future__ import annotations

import math

import numpy as np
import pytest

from core.comparison import five_points, lines
from core.errors import DegenerateGeometry
from core.geometry import Camera, project, so3_exp, transform, transform_points
from core.targets import GridPoints, TargetSpec
from tests.support.sessions.comparisons import reprojection_of

TARGET = TargetSpec("chessboard", 14, 10, 20.0)
SIZE = (2448, 2050)
FOCAL = 2320.0


def view(
    tilt_deg: float,
    axis: tuple[float, float] = (0.8, 0.6),
    *,
    k1: float = 0.0,
    noise_px: float = 0.0,
    scale: float = 1.0,
) -> GridPoints:
    camera = Camera(FOCAL, FOCAL, (SIZE[0] - 1) / 2, (SIZE[1] - 1) / 2, k1)
    R = so3_exp(math.radians(tilt_deg) * np.array([*axis, 0.0])) @ so3_exp(np.array([0.0, 0.0, 0.2]))
    if axis[1] == 0.0:
        R = so3_exp(math.radians(tilt_deg) * np.array([*axis, 0.0]))
    middle = TARGET.points_target().mean(axis=0)
    T = transform(R, np.array([10.0, -8.0, 420.0 / scale]) - R @ middle)
    px = project(transform_points(T, TARGET.points_target()), camera)
    px = px + noise_px * np.random.default_rng(3).standard_normal(px.shape)
    row, column = (a.ravel() for a in np.mgrid[0:10, 0:14])
    return GridPoints(TARGET, *SIZE, column, row, px, np.full(len(px), max(noise_px, 0.01)))


@pytest.mark.parametrize("method", [five_points, lines])
def test_exact_points_give_the_camera(method) -> None:  # type: ignore[no-untyped-def]
    found = method(view(30.0))
    assert found.camera.fx_px == pytest.approx(FOCAL, rel=1e-5)
    assert found.camera.k1 == pytest.approx(0.0, abs=1e-5)
    assert reprojection_of(found).rms_px < 1e-3
    assert found.warnings == ()


def test_lines_find_the_distortion_that_five_points_leave_in_the_residuals() -> None:
    bent = view(30.0, k1=-0.1)
    by_lines, by_points = lines(bent), five_points(bent)
    assert by_lines.camera is not None
    assert by_points.camera is not None
    assert by_lines.camera.k1 == pytest.approx(-0.1, abs=0.03)
    assert abs(by_lines.camera.fx_px - FOCAL) < 0.5 * abs(by_points.camera.fx_px - FOCAL)
    assert reprojection_of(by_lines).rms_px < 0.3 * reprojection_of(by_points).rms_px


@pytest.mark.parametrize("method", [five_points, lines])
def test_a_grid_parallel_to_the_image_gives_no_camera(method) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(DegenerateGeometry):
        method(view(0.0))


def test_a_line_parallel_to_the_image_is_named() -> None:
    found = five_points(view(30.0, (1.0, 0.0)))
    assert [warning.code for warning in found.warnings] == ["one_line_parallel"]


def test_distortion_of_a_small_grid_is_named_as_noise() -> None:
    found = lines(view(40.0, noise_px=0.2, scale=0.15))
    assert "distortion_not_observable" in [warning.code for warning in found.warnings]


def test_views_without_the_first_row_or_with_too_few_lines_are_refused() -> None:
    whole = view(30.0)

    def only(some: np.ndarray) -> GridPoints:
        return GridPoints(
            TARGET,
            *SIZE,
            whole.column[some],
            whole.row[some],
            whole.points_px[some],
            whole.standard_uncertainty_px[some],
        )

    with pytest.raises(DegenerateGeometry, match="first row"):
        five_points(only(whole.row > 0))
    with pytest.raises(DegenerateGeometry, match="two rows"):
        lines(only(whole.row == 4))
