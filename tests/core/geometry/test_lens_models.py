"""Lens models beyond Brown's: derivatives, OpenCV's own projection, inverses, and the radius at which they fold."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest

from core.geometry import (
    LENS_PARAMETERS,
    AnyCamera,
    Camera,
    KannalaBrandtCamera,
    RationalCamera,
    camera_from_array,
    fold_radius_px,
    free_parameters,
    lens_model_of,
    project_any,
    project_any_with_jacobian,
    undistort_any,
    undistort_points,
)

ANGULAR = KannalaBrandtCamera(560.0, 561.0, 650.0, 498.0, -0.03, 0.01, -0.004, 5e-4, 3e-4, -4e-4)
RATIONAL = RationalCamera(560.0, 561.0, 650.0, 498.0, 0.3, 0.05, 3e-4, -4e-4, 0.01, 0.6, 0.1, 0.02)
CAMERAS = pytest.mark.parametrize("camera", [ANGULAR, RATIONAL], ids=lens_model_of)
POINTS = np.random.default_rng(2).uniform([-1.2, -1.0, 0.8], [1.2, 1.0, 1.4], (60, 3)) * 300.0


@CAMERAS
def test_derivatives_are_those_of_differences(camera: AnyCamera) -> None:
    _, by_camera, by_point = project_any_with_jacobian(POINTS, camera)
    parameters = camera.as_array()
    for i in range(len(parameters)):
        step = np.zeros_like(parameters)
        step[i] = 1e-6 * max(1.0, abs(parameters[i]))
        ahead, behind = (
            project_any(POINTS, camera_from_array(parameters + sign * step)) for sign in (1.0, -1.0)
        )
        np.testing.assert_allclose(by_camera[i], (ahead - behind).T / (2.0 * step[i]), rtol=1e-6, atol=1e-5)
    for i in range(3):
        step = np.eye(3)[i] * 1e-3
        difference = (project_any(POINTS + step, camera) - project_any(POINTS - step, camera)) / 2e-3
        np.testing.assert_allclose(by_point[i], difference.T, rtol=1e-6, atol=1e-8)


def test_the_angular_model_is_smooth_at_the_axis() -> None:
    """On it, and on either side of where the series takes over."""
    r = np.array([0.0, 1e-9, 0.999e-3, 1.001e-3, 2e-3])
    points = np.column_stack([r, 0.5 * r, np.ones(5)]) * 400.0
    pixels, _, by_point = project_any_with_jacobian(points, ANGULAR)
    assert np.all(np.isfinite(pixels))
    np.testing.assert_allclose(by_point[:, :, 0], [[1.4, 0.0], [0.0, 1.4025], [0.0, 0.0]], atol=1e-3)
    np.testing.assert_allclose(by_point[:, :, 2], by_point[:, :, 3], rtol=1e-4, atol=1e-5)


def test_opencv_projects_to_the_same_pixels() -> None:
    nothing = np.zeros(3)
    plain = dataclasses.replace(ANGULAR, p1=0.0, p2=0.0)
    coefficients = np.array([plain.k1, plain.k2, plain.k3, plain.k4])
    theirs, _ = cv2.fisheye.projectPoints(
        POINTS.reshape(-1, 1, 3), nothing, nothing, plain.matrix, coefficients
    )
    np.testing.assert_allclose(project_any(POINTS, plain), theirs.reshape(-1, 2), atol=1e-9)
    theirs, _ = cv2.projectPoints(POINTS, nothing, nothing, RATIONAL.matrix, RATIONAL.as_array()[4:])
    np.testing.assert_allclose(project_any(POINTS, RATIONAL), theirs.reshape(-1, 2), atol=1e-9)


def test_a_rational_lens_without_its_further_terms_is_browns() -> None:
    brown = Camera(560.0, 561.0, 650.0, 498.0, -0.2, 0.05, 3e-4, -4e-4, 0.01)
    rational = RationalCamera(560.0, 561.0, 650.0, 498.0, -0.2, 0.05, 3e-4, -4e-4, 0.01)
    np.testing.assert_allclose(project_any(POINTS, rational), project_any(POINTS, brown), atol=1e-10)
    assert fold_radius_px(rational) == pytest.approx(fold_radius_px(brown))


@CAMERAS
def test_pixels_have_the_direction_that_projects_to_them(camera: AnyCamera) -> None:
    directions = POINTS / POINTS[:, 2:]
    found = undistort_any(project_any(POINTS, camera), camera)
    np.testing.assert_allclose(found, directions[:, :2], atol=1e-8)


def test_browns_directions_are_those_of_its_own_function() -> None:
    brown = Camera(560.0, 561.0, 650.0, 498.0, -0.2, 0.05)
    pixels = project_any(POINTS, brown)
    np.testing.assert_array_equal(undistort_any(pixels, brown), undistort_points(pixels, brown))


def test_a_pixel_beyond_the_fold_has_no_direction() -> None:
    folding = KannalaBrandtCamera(500.0, 500.0, 640.0, 480.0, -0.2)
    fold = fold_radius_px(folding)
    assert fold is not None
    angle = np.linspace(0.0, 3.0, 3001)
    reached = 500.0 * np.max(angle * (1.0 - 0.2 * angle**2))
    assert fold == pytest.approx(reached, rel=1e-5)
    found = undistort_any(np.array([[640.0 + 0.9 * fold, 480.0], [640.0 + 1.1 * fold, 480.0]]), folding)
    assert np.all(np.isfinite(found[0]))
    assert np.all(np.isnan(found[1]))


def test_the_radius_of_the_fold() -> None:
    """r (1 + k1 r²) turns back at r² = -1/(3 k1), at two thirds of r; a lens that spreads the edge never does."""
    assert fold_radius_px(Camera(600.0, 600.0, 0.0, 0.0, -0.3)) == pytest.approx(
        600.0 * 2.0 / 3.0 / np.sqrt(0.9)
    )
    assert fold_radius_px(Camera(600.0, 600.0, 0.0, 0.0, 0.3)) is None
    assert fold_radius_px(Camera(600.0, 600.0, 0.0, 0.0)) is None
    assert fold_radius_px(KannalaBrandtCamera(600.0, 600.0, 0.0, 0.0)) is None
    r = np.linspace(0.0, 5.0, 100_001)
    g = (1.0 + 0.1 * r**2) / (1.0 + 0.6 * r**2 + 0.4 * r**4)
    assert fold_radius_px(RationalCamera(600.0, 600.0, 0.0, 0.0, k1=0.1, k4=0.6, k5=0.4)) == pytest.approx(
        600.0 * np.max(r * g), rel=1e-6
    )


def test_the_number_of_parameters_says_which_model_it_is() -> None:
    for camera, model, free in (
        (Camera(1, 1, 0, 0), "brown", 8),
        (ANGULAR, "kannala_brandt", 10),
        (RATIONAL, "rational", 12),
    ):
        parameters = camera.as_array()
        assert lens_model_of(camera) == model
        assert len(LENS_PARAMETERS[lens_model_of(camera)]) == len(parameters)
        assert free_parameters(len(parameters)) == free
        assert camera_from_array(parameters) == camera
