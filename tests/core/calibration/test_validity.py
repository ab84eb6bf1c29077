"""What must not enter, and what must not leave as if it were a measurement."""

from __future__ import annotations

import contextlib
import dataclasses
import math

import numpy as np
import pytest

from core.calibration.priors import Lens
from core.calibration.single_image import calibrate_points
from core.errors import DegenerateGeometry, FocalNotObservable, GridposeError, InvalidArgument, InvalidTarget
from core.geometry.camera import Camera
from core.targets.specification import GridPoints, TargetSpec
from tests.support.simulation.simulated_views import draw_view, draw_view_from_priors


@pytest.fixture
def points() -> GridPoints:
    return draw_view(np.random.default_rng(1), tilt_deg=35.0).points


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e200])
def test_coordinates_without_meaning_are_refused(points: GridPoints, value: float) -> None:
    px = points.points_px.copy()
    px[5, 1] = value
    with pytest.raises(InvalidArgument):
        calibrate_points(dataclasses.replace(points, points_px=px))


@pytest.mark.parametrize("value", [0.0, -0.05, math.nan, math.inf, 1e300, 1e-12])
def test_uncertainties_without_meaning_are_refused(points: GridPoints, value: float) -> None:
    uncertainty = points.standard_uncertainty_px.copy()
    uncertainty[5] = value
    with pytest.raises(InvalidArgument):
        calibrate_points(dataclasses.replace(points, standard_uncertainty_px=uncertainty))


def test_an_image_without_pixels_is_refused(points: GridPoints) -> None:
    with pytest.raises(InvalidArgument):
        calibrate_points(dataclasses.replace(points, image_width_px=0))


def test_a_point_named_twice_is_refused(points: GridPoints) -> None:
    column = points.column.copy()
    column[1] = column[0]
    with pytest.raises(DegenerateGeometry, match="twice"):
        calibrate_points(dataclasses.replace(points, column=column))


@pytest.mark.parametrize("step", [1, -14])
def test_a_point_outside_the_target_is_refused(points: GridPoints, step: int) -> None:
    with pytest.raises(InvalidArgument, match="outside the target"):
        calibrate_points(dataclasses.replace(points, column=points.column + step))


@pytest.mark.parametrize(
    "values", [(1e5, 1e-300), (5e-324, 1e4), (0.004, 4e-243), (3.2e-54, 0.0076), (8.0, 3450.0)]
)
def test_no_camera_has_such_a_lens(points: GridPoints, values: tuple[float, float]) -> None:
    with pytest.raises(InvalidArgument):
        calibrate_points(points, lens=Lens(*values))


@pytest.mark.parametrize("factor", [0.1, 0.3, 0.5, 2.0, 10.0, 100.0])
def test_a_wrong_lens_is_rejected_where_the_image_knows_better(factor: float) -> None:
    rng = np.random.default_rng(int(10 * factor))
    for tilt in (20.0, 40.0):
        view = draw_view(rng, tilt_deg=tilt, sigma_px=0.02)
        found = calibrate_points(view.points, lens=Lens(view.camera.fx_px * factor * 3.45e-3, 3.45))
        assert abs(found.camera.fx_px / view.camera.fx_px - 1.0) < 0.1
        assert "focal_prior_inconsistent" in {w.code for w in found.warnings}
        assert found.camera == calibrate_points(view.points).camera


@pytest.mark.parametrize("factor", [0.01, 100.0])
def test_an_absurd_lens_on_a_flat_view_ends_in_no_measurement(factor: float) -> None:
    """The image cannot contradict it by its focal length, but its residuals do."""
    view = draw_view(np.random.default_rng(3), tilt_deg=0.5)
    with pytest.raises(GridposeError) as failure:
        calibrate_points(view.points, lens=Lens(view.camera.fx_px * factor * 3.45e-3, 3.45))
    assert failure.value.advice
    assert failure.value.points is view.points


@pytest.mark.parametrize(
    "camera",
    [
        Camera(-2320.0, -2320.0, 1223.5, 1024.5),
        Camera(-2320.0, 2320.0, 1223.5, 1024.5),
        Camera(0.0, 2320.0, 1223.5, 1024.5),
        Camera(math.nan, 2320.0, 1223.5, 1024.5),
        Camera(2320.0, math.inf, 1223.5, 1024.5),
        Camera(1e9, 1e9, 1223.5, 1024.5),
        Camera(600.0, 600.0, 1223.5, 1024.5, -0.6),
        Camera(2320.0, 2320.0, 1223.5, 1024.5, 1e6),
        Camera(1.3e-56, 63.6, 326349.0, 1000.0, 0.1),
        Camera(2320.0, 2320.0, 1223.5, 1024.5, 0.0, -1e5),
    ],
)
def test_intrinsics_that_do_not_explain_the_image_give_no_pose(points: GridPoints, camera: Camera) -> None:
    with pytest.raises(GridposeError) as failure:
        calibrate_points(points, intrinsics=camera)
    assert failure.value.advice
    assert failure.value.points is points


@pytest.mark.parametrize("mirror", ["left-right", "transposed"])
@pytest.mark.parametrize("known", [True, False])
def test_a_mirrored_grid_is_seen_from_behind(mirror: str, known: bool) -> None:
    view = draw_view(np.random.default_rng(4), tilt_deg=35.0)
    px = view.points.points_px
    swapped = px[:, ::-1].copy() if mirror == "transposed" else px * [-1.0, 1.0] + [2447.0, 0.0]
    mirrored = dataclasses.replace(view.points, points_px=swapped)
    with pytest.raises(DegenerateGeometry, match="behind"):
        calibrate_points(mirrored, intrinsics=view.camera if known else None)


@pytest.mark.parametrize("uncertainty", [-0.01, math.nan, math.inf, 10.0])
def test_an_impossible_uncertainty_of_the_pitch_is_refused(uncertainty: float) -> None:
    with pytest.raises(InvalidTarget):
        TargetSpec("chessboard", 9, 6, 10.0, pitch_standard_uncertainty_mm=uncertainty)


@pytest.mark.parametrize("pitch", [1e-3, 1e4])
def test_the_unit_of_the_target_does_not_matter(points: GridPoints, pitch: float) -> None:
    scaled = dataclasses.replace(points, target=dataclasses.replace(points.target, pitch_mm=pitch))
    found, usual = calibrate_points(scaled), calibrate_points(points)
    np.testing.assert_allclose(found.pose.position_mm, usual.pose.position_mm * pitch / 10.0, rtol=1e-4)


def test_cameras_beyond_the_priors_are_remarked_on() -> None:
    rng = np.random.default_rng(5)
    usual = Camera(2320.0, 2320.0, 1223.5, 1024.5, -0.1, 0.05)
    shifted = dataclasses.replace(usual, cx_px=usual.cx_px + 0.05 * 2448, fy_px=2320.0 * 1.01)
    views = [draw_view(rng, tilt_deg=45.0, columns=25, rows=18, camera=c) for c in (usual, shifted)]
    codes = [{w.code for w in calibrate_points(v.points).warnings} for v in views]
    assert "prior_residuals_large" not in codes[0]
    assert "prior_residuals_large" in codes[1]


@pytest.mark.slow
def test_cropped_images_are_remarked_on_and_whole_ones_are_not() -> None:
    """Contradictions of 2.5 times the expected distance: 1.2 % of each parameter, where it holds."""
    rng = np.random.default_rng(4)
    whole, cropped = [], []
    for _ in range(120):
        points = draw_view_from_priors(
            rng, sigma_px=0.1, tilt_deg=rng.uniform(15.0, 45.0), columns=9, rows=6
        ).points
        cut = int(min(0.15 * points.image_width_px, points.points_px[:, 0].min() - 10.0))
        left = dataclasses.replace(
            points, image_width_px=points.image_width_px - cut, points_px=points.points_px - [cut, 0.0]
        )
        for view, remarked in ((points, whole), (left, cropped)):
            if view is left and cut < 0.1 * points.image_width_px:
                continue
            with contextlib.suppress(FocalNotObservable):
                codes = {w.code for w in calibrate_points(view).warnings}
                remarked.append("prior_residuals_large" in codes)
    # Binomial bounds of four standard deviations about .084 (1 - .988⁷) and .85.
    assert len(whole) > 100
    assert np.mean(whole) < 0.084 + 4.0 * math.sqrt(0.084 * 0.916 / len(whole))
    assert len(cropped) > 70
    assert np.mean(cropped) > 0.85 - 4.0 * math.sqrt(0.85 * 0.15 / len(cropped))


@pytest.mark.parametrize(("columns", "rows"), [(80, 60), (20, 500), (500, 20)])
def test_a_very_large_grid_is_fitted_from_a_part_of_it_first(columns: int, rows: int) -> None:
    """A part chosen by a regular step would be one column of the second: 20 · 500 points, every twentieth."""
    view = draw_view(np.random.default_rng(6), columns=columns, rows=rows, tilt_deg=40.0)
    found = calibrate_points(view.points)
    assert len(found.residuals_px) == columns * rows
    assert found.reprojection.points > 0.97 * columns * rows
    error = found.camera.fx_px - view.camera.fx_px
    # A strip determines f less well than a sheet.
    assert abs(error) < 4.0 * found.camera_standard_uncertainty[0]
