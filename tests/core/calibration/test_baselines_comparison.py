"""One row a method, over the same points: figures where it answers, the reason where it does not."""

from __future__ import annotations

import numpy as np
import pytest

from core.calibration.baselines import CALIBRATION_METHODS, compare_calibrations, proposed
from core.calibration.single_image import calibrate_points
from core.errors import DegenerateGeometry
from core.simulation.views import View, draw_camera, draw_view


def session(count: int, tilt_deg: float = 35.0) -> list[View]:
    rng = np.random.default_rng(3)
    camera = draw_camera(rng)
    return [draw_view(rng, tilt_deg=tilt_deg, camera=camera) for _ in range(count)]


def test_every_method_has_its_row_and_its_noise() -> None:
    views = session(6)
    rows = {row.method: row for row in compare_calibrations([v.points for v in views])}
    assert tuple(rows) == CALIBRATION_METHODS
    for method in ("proposed_vanishing_point", "zhang", "opencv_single_image"):
        row = rows[method]
        assert row.images == 6
        assert row.failures == ()
        assert row.failure is None
        assert row.reprojection is not None
        # σ √(π/2) less the few parameters' share, over 840 points: 2 % by chance.
        assert row.reprojection.mean_px == pytest.approx(0.05 * np.sqrt(np.pi / 2), rel=0.08)
        assert row.reprojection.std_px == pytest.approx(0.05 * np.sqrt(2 - np.pi / 2), rel=0.1)
    for method in ("tsai", "dlt"):  # no tangential term, no second radial one; no distortion at all
        reprojection = rows[method].reprojection
        assert reprojection is not None
        assert reprojection.mean_px > 0.1
    zhang = rows["zhang"].answers[0][1].camera
    assert zhang is not None
    assert zhang.fx_px == pytest.approx(views[0].camera.fx_px, rel=3e-3)


def test_both_variants_end_in_the_same_minimum_as_the_product_itself() -> None:
    points = session(1)[0].points
    product = calibrate_points(points)
    for method in ("proposed_nullspace", "proposed_vanishing_point"):
        found = proposed(method, points)
        assert found.camera is not None
        assert found.camera.fx_px == pytest.approx(product.camera.fx_px, rel=1e-5)
        np.testing.assert_allclose(found.T_camera_target[0], product.T_camera_target, rtol=1e-4, atol=1e-2)


def test_failures_are_named_image_by_image() -> None:
    rows = {row.method: row for row in compare_calibrations([session(1, tilt_deg=0.0)[0].points])}
    assert rows["zhang"].failure is not None
    assert rows["zhang"].failure.image is None
    assert "two views" in rows["zhang"].failure.detail
    for method in ("proposed_nullspace", "proposed_vanishing_point"):
        failure = rows[method].failure
        assert failure is not None
        assert failure.image == 0
        assert failure.code in ("focal_not_observable", "degenerate_geometry")
        assert failure.advice
        assert rows[method].reprojection is None
    assert rows["opencv_single_image"].answers[0][1].warnings


def test_no_images_are_no_rows_of_figures() -> None:
    for row in compare_calibrations([]):
        assert row.reprojection is None
        assert row.images == 0
        assert row.answers == ()


def test_too_few_points_are_refused() -> None:
    rng = np.random.default_rng(4)
    points = draw_view(rng, columns=3, rows=2).points
    with pytest.raises(DegenerateGeometry, match="at least 8"):
        proposed("proposed_vanishing_point", points)
