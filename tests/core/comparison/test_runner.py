"""One row a method, over the same points: figures where it answers, the reason where it does not."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from core.calibration.single_image import calibrate_points
from core.comparison import (
    METHODS,
    Failure,
    MethodRow,
    compare_methods,
    opencv_single_image,
    pose_of_points,
    proposed,
    runner,
)
from core.comparison.results import Answer, MethodResult, attempt
from core.comparison.runner import MARKER_METHODS, evenly
from core.errors import DegenerateGeometry, InvalidArgument
from core.geometry.camera import Camera, project
from core.geometry.se3 import transform_points
from core.targets.charuco.layout import charuco_layout
from core.targets.specification import GridPoints, TargetSpec
from tests.support.sessions.comparisons import NOT_POOLED, pooled
from tests.support.simulation.simulated_views import View, draw_camera, draw_pose, draw_view

CAMERA = Camera(1160.0, 1160.3, 605.0, 515.0, -0.1, 0.05, 1e-4, -2e-4)
CHARUCO = TargetSpec("charuco", 9, 6, 12.0, 8.4, "DICT_5X5_100")


def session(count: int, tilt_deg: float = 35.0) -> list[View]:
    rng = np.random.default_rng(3)
    # Much tangential distortion makes a board seen at right angles look tilted to those who know none.
    camera = dataclasses.replace(draw_camera(rng), p1=1e-4, p2=-2e-4)
    return [draw_view(rng, tilt_deg=tilt_deg, camera=camera) for _ in range(count)]


def charuco_views(count: int, sigma_px: float = 0.02) -> tuple[list[GridPoints], list[np.ndarray]]:
    """Views of a ChArUco board, markers as noisy as corners, and the true T_camera_target."""
    rng = np.random.default_rng(5)
    layout = charuco_layout(CHARUCO)
    row, column = (a.ravel() for a in np.mgrid[0:6, 0:9])
    views, truth = [], []
    for _ in range(count):
        T = draw_pose(rng, CHARUCO, CAMERA, 1224, math.radians(30.0))

        def seen(points: np.ndarray, T: np.ndarray = T) -> np.ndarray:
            exact = project(transform_points(T, points), CAMERA)
            return np.asarray(exact + rng.normal(0.0, sigma_px, exact.shape))

        markers = {k: seen(layout.marker_corners(k)) for k in range(len(layout.marker_squares))}
        px = seen(CHARUCO.points_target())
        views.append(
            GridPoints(CHARUCO, 1224, 1024, column, row, px, np.full(54, sigma_px), markers_px=markers)
        )
        truth.append(T)
    return views, truth


def by_method(rows: tuple[MethodRow, ...]) -> dict[str, MethodRow]:
    return {row.method: row for row in rows}


def test_every_method_has_its_row_and_its_noise() -> None:
    views = session(6)
    points = [v.points for v in views]
    rows = by_method(compare_methods(points, pooled(points)))
    assert tuple(rows) == METHODS
    for method in ("proposed_vanishing_point", "zhang", "opencv_single_image", "pooled"):
        row = rows[method]
        assert row.images == tuple(range(6))
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
    for method in ("zhang", "pooled"):
        figures = rows[method].camera
        assert figures is not None
        assert figures.mean[0] == pytest.approx(views[0].camera.fx_px, rel=3e-3)
        assert figures.spread is None
    for method, row in rows.items():
        expected = ["principal_point_estimated"] if method.startswith("proposed") else []
        assert [warning.code for warning in row.warnings] == expected
    assert rows["pooled"].scatter is not None
    assert sorted(rows["pooled"].scatter) == list(range(6))


def test_cameras_of_single_images_are_summed_up() -> None:
    views = [v.points for v in session(4)]
    (row,) = compare_methods(views, NOT_POOLED, methods=["opencv_single_image"])
    cameras = np.array([opencv_single_image(v).camera.as_array() for v in views])  # type: ignore[union-attr]
    assert row.camera is not None
    assert row.camera.images == 4
    np.testing.assert_allclose(row.camera.mean, cameras.mean(axis=0))
    np.testing.assert_allclose(row.camera.spread, cameras.std(axis=0, ddof=1))
    (single,) = compare_methods(views[:1], NOT_POOLED, methods=["opencv_single_image"])
    assert single.camera is not None
    assert single.camera.spread is None


def test_both_variants_end_in_the_same_minimum_as_the_product_itself() -> None:
    points = session(1)[0].points
    product = calibrate_points(points)
    for method in ("proposed_nullspace", "proposed_vanishing_point"):
        found = proposed(method, points)
        assert found.camera is not None
        assert found.camera.fx_px == pytest.approx(product.camera.fx_px, rel=1e-5)
        np.testing.assert_allclose(found.T_camera_target[0], product.T_camera_target, rtol=1e-4, atol=1e-2)


def test_failures_are_named_image_by_image() -> None:
    flat = [session(1, tilt_deg=0.0)[0].points]
    rows = by_method(compare_methods(flat, pooled(flat)))
    assert rows["zhang"].failure is not None
    assert rows["zhang"].failure.image is None
    assert "two views" in rows["zhang"].failure.detail
    for method in ("proposed_nullspace", "proposed_vanishing_point", "tsai"):
        failure = rows[method].failure
        assert failure is not None
        assert failure.image == 0
        assert failure.code in ("focal_not_observable", "degenerate_geometry")
        assert failure.advice
        assert rows[method].reprojection is None
        assert rows[method].camera is None
    assert "perpendicular" in rows["tsai"].failures[0].detail
    assert rows["opencv_single_image"].answers[0].result.warnings
    assert rows["pooled"].failure is not None
    assert rows["pooled"].failure.code == "focal_not_observable"
    for method in MARKER_METHODS:
        failure = rows[method].failure
        assert failure is not None
        assert failure.code == "intrinsics_missing"


def test_a_mapping_that_determines_no_camera_is_no_answer() -> None:
    row_, column = (a.ravel() for a in np.mgrid[0:6, 0:9])
    px = CHARUCO.points_target()[:, :2] * 5.0 + 300.0  # seen at right angles, without noise
    flat = GridPoints(CHARUCO, 1224, 1024, column, row_, px, np.full(54, 0.02))
    (row,) = compare_methods([flat], NOT_POOLED, methods=["dlt"])
    assert row.answers == ()
    assert row.failure is not None
    assert row.failure.code == "camera_not_observable"


def test_a_pose_beyond_all_distances_is_no_answer() -> None:
    T = np.eye(4)
    T[2, 3] = 2e6
    answer = MethodResult("dlt", CAMERA, (T,), (np.zeros((54, 2)),))
    failure = attempt(3, lambda: Answer((3,), answer))
    assert isinstance(failure, Failure)
    assert (failure.image, failure.code) == (3, "not_converged")
    assert "2 km" in failure.detail
    T[2, 3] = math.nan
    failure = attempt(3, lambda: Answer((3,), answer))
    assert isinstance(failure, Failure)
    assert "finite" in failure.detail


def test_one_image_that_fails_leaves_the_others_their_figures() -> None:
    good, flat = session(3), session(1, tilt_deg=0.0)
    views = [good[0].points, flat[0].points, *(v.points for v in good[1:])]
    rows = by_method(compare_methods(views, pooled(views)))
    for method in ("proposed_vanishing_point", "tsai"):
        assert rows[method].images == (0, 2, 3)
        assert [failure.image for failure in rows[method].failures] == [1]
        assert rows[method].failure is None
    for method in ("zhang", "pooled"):
        assert rows[method].images == (0, 1, 2, 3)


def test_too_few_points_cost_zhang_the_image_only() -> None:
    views = [v.points for v in session(4)]
    few = dataclasses.replace(
        views[1],
        column=views[1].column[:5],
        row=views[1].row[:5],
        points_px=views[1].points_px[:5],
        standard_uncertainty_px=views[1].standard_uncertainty_px[:5],
    )
    (row,) = compare_methods([views[0], few, *views[2:]], NOT_POOLED, methods=["zhang"])
    assert row.images == (0, 2, 3)
    assert [(f.image, f.code) for f in row.failures] == [(1, "degenerate_geometry")]


def test_zhang_from_a_part_places_all_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    views = [v.points for v in session(8)]
    (whole,) = compare_methods(views, NOT_POOLED, methods=["zhang"])
    assert whole.warnings == ()
    monkeypatch.setattr(runner, "ZHANG_VIEWS", 5)
    (part,) = compare_methods(views, NOT_POOLED, methods=["zhang"])
    assert part.images == whole.images
    assert part.camera is not None
    assert part.camera.spread is None
    assert part.camera.mean[0] == pytest.approx(session(1)[0].camera.fx_px, rel=5e-3)
    assert [r.code for r in part.warnings] == ["calibrated_from_subset"]
    assert "5 of 8" in part.warnings[0].detail


def test_poses_of_a_camera_held_are_those_of_the_calibration_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    """What justifies placing views by the camera of a part: with the same camera it is the same pose."""
    views = [v.points for v in session(4)]
    (whole,) = compare_methods(views, NOT_POOLED, methods=["zhang"])
    camera = whole.answers[0].result.camera
    for i, T in whole.poses.items():
        placed = pose_of_points("zhang", views[i].points_target, views[i].points_px, camera)
        np.testing.assert_allclose(placed.T_camera_target[0][:3, 3], T[:3, 3], atol=2e-3)
        np.testing.assert_allclose(placed.T_camera_target[0][:3, :3], T[:3, :3], atol=1e-5)


def test_places_are_even_and_hold_both_ends() -> None:
    assert evenly(3, 5) == [0, 1, 2]
    assert evenly(10, 4) == [0, 3, 6, 9]
    assert evenly(10, 1) == [0]
    for count, at_most in ((150, 60), (61, 60), (1000, 7)):
        places = evenly(count, at_most)
        assert len(set(places)) == at_most
        assert (places[0], places[-1]) == (0, count - 1)
        assert max(np.diff(places)) - min(np.diff(places)) <= 1


def test_markers_give_poses_by_the_pooled_camera_or_the_given_one() -> None:
    views, truth = charuco_views(4)
    rows = by_method(compare_methods(views, pooled(views)))
    for method in MARKER_METHODS:
        row = rows[method]
        assert row.camera_of == "given"
        assert row.images == (0, 1, 2, 3)
        assert row.camera is not None
        assert rows["pooled"].camera is not None
        np.testing.assert_array_equal(row.camera.mean, rows["pooled"].camera.mean)
    (held,) = compare_methods(views, NOT_POOLED, intrinsics=CAMERA, methods=["aruco_board"])
    assert held.camera is not None
    np.testing.assert_array_equal(held.camera.mean, CAMERA.as_array())
    # 35 markers of four corners of .02 px, 300 mm away: some hundredths of a mm
    for i, T in held.poses.items():
        np.testing.assert_allclose(T[:3, 3], truth[i][:3, 3], atol=0.2)
    (marker,) = compare_methods(views, NOT_POOLED, intrinsics=CAMERA, methods=["aruco_marker"])
    worst = max(float(np.abs(T[:3, 3] - truth[i][:3, 3]).max()) for i, T in marker.poses.items())
    assert 0.05 < worst < 10.0


def test_where_markers_are_missing_the_reason_is_said() -> None:
    views, _ = charuco_views(3)
    views[0] = dataclasses.replace(views[0], markers_px=None)
    views[1] = dataclasses.replace(views[1], markers_px={0: (views[1].markers_px or {})[0]})
    rows = by_method(compare_methods(views, pooled(views), methods=MARKER_METHODS))
    assert [(f.image, f.code) for f in rows["aruco_marker"].failures] == [
        (0, "markers_not_stored"),
        (1, "target_not_found"),
    ]
    assert [(f.image, f.code) for f in rows["aruco_board"].failures] == [
        (0, "markers_not_stored"),
        (1, "degenerate_geometry"),
    ]
    chessboards = [v.points for v in session(3)]
    plain = by_method(compare_methods(chessboards, pooled(chessboards), methods=MARKER_METHODS))
    for method in MARKER_METHODS:
        failure = plain[method].failure
        assert failure is not None
        assert failure.code == "target_without_markers"
        assert "ChArUco" in (failure.advice or "")


def test_no_images_are_no_rows_of_figures() -> None:
    for row in compare_methods([], pooled([])):
        assert row.reprojection is None
        assert row.camera is None
        assert row.images == ()
        assert row.answers == ()


def test_too_few_points_are_refused() -> None:
    rng = np.random.default_rng(4)
    points = draw_view(rng, columns=3, rows=2).points
    with pytest.raises(DegenerateGeometry, match="at least 8"):
        proposed("proposed_vanishing_point", points)


def test_a_method_there_is_not() -> None:
    with pytest.raises(InvalidArgument, match="best"):
        compare_methods([], NOT_POOLED, methods=["zhang", "best"])
