"""The camera model: against OpenCV's, against differences, and back again."""

from __future__ import annotations

import cv2
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from core.geometry.camera import CAMERA_PARAMETERS, Camera, project, project_with_jacobian, undistort_points

CAMERA = Camera(900.0, 950.0, 640.5, 477.25, -0.21, 0.11, 8e-4, -6e-4, -0.03)
POINTS = np.random.default_rng(3).uniform([-200, -150, 400], [200, 150, 700], (60, 3))


def test_a_point_on_the_axis_falls_on_the_principal_point() -> None:
    np.testing.assert_allclose(project(np.array([[0.0, 0.0, 5.0]]), CAMERA), [[640.5, 477.25]])


def test_it_is_opencvs_model() -> None:
    distortion = np.array([CAMERA.k1, CAMERA.k2, CAMERA.p1, CAMERA.p2, CAMERA.k3])
    theirs, _ = cv2.projectPoints(POINTS, np.zeros(3), np.zeros(3), CAMERA.matrix, distortion)
    np.testing.assert_allclose(project(POINTS, CAMERA), theirs.reshape(-1, 2), atol=1e-9)


def test_derivatives_by_the_camera_match_differences() -> None:
    _, by_camera, _ = project_with_jacobian(POINTS, CAMERA)
    parameters = CAMERA.as_array()
    for index, name in enumerate(CAMERA_PARAMETERS):
        h = 1e-4 if index < 4 else 1e-7
        step = np.zeros(9)
        step[index] = h
        plus = project(POINTS, Camera.from_array(parameters + step))
        minus = project(POINTS, Camera.from_array(parameters - step))
        np.testing.assert_allclose(
            by_camera[index].T, (plus - minus) / (2 * h), rtol=1e-5, atol=1e-5, err_msg=name
        )


def test_derivatives_by_the_point_match_differences() -> None:
    _, _, by_point = project_with_jacobian(POINTS, CAMERA)
    for axis in range(3):
        step = np.zeros(3)
        step[axis] = 1e-4
        difference = (project(POINTS + step, CAMERA) - project(POINTS - step, CAMERA)) / 2e-4
        np.testing.assert_allclose(by_point[axis].T, difference, atol=1e-6)


@given(st.floats(-0.25, 0.1), st.floats(-0.05, 0.1), st.floats(-1e-3, 1e-3), st.floats(-1e-3, 1e-3))
def test_undistorting_undoes_projection(k1: float, k2: float, p1: float, p2: float) -> None:
    camera = Camera(900.0, 950.0, 640.5, 477.25, k1, k2, p1, p2)
    normalised = POINTS[:, :2] / POINTS[:, 2:]
    np.testing.assert_allclose(undistort_points(project(POINTS, camera), camera), normalised, atol=1e-10)


def test_beyond_the_fold_undistorting_stays_finite() -> None:
    camera = Camera(500.0, 500.0, 320.0, 240.0, -0.6)
    assert np.all(np.isfinite(undistort_points(np.array([[5000.0, -4000.0]]), camera)))
