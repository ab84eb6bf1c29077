"""The pose of each image, also of those that an estimator does not use."""

from __future__ import annotations

import math

import numpy as np

from core.calibration.multi_view.view_stack import stack_views
from core.calibration.single_image import calibrate_points
from core.geometry.camera import Camera, project
from core.geometry.se3 import invert, transform_points
from core.session import ImageObservation, SessionData, estimate_session, group_views, image_poses
from core.targets.specification import GridPoints, TargetSpec
from tests.support.simulation.simulated_views import draw_pose

CAMERA = Camera(1160.0, 1160.3, 605.0, 515.0, -0.1, 0.05, 1e-4, -2e-4)
SIZE = (1224, 1024)
BOARD = TargetSpec("chessboard", 9, 6, 12.0)
NOISE_PX = 0.1


def seen(rng: np.random.Generator, T_camera_target: np.ndarray) -> GridPoints:
    row, column = (a.ravel() for a in np.mgrid[0 : BOARD.rows, 0 : BOARD.columns])
    px = project(transform_points(T_camera_target, BOARD.points_target()), CAMERA)
    sigma = np.full(len(px), NOISE_PX)
    return GridPoints(BOARD, *SIZE, column, row, px + rng.normal(0.0, NOISE_PX, px.shape), sigma)


def test_an_image_that_determines_the_focal_length_weakly_has_its_own_pose_and_is_not_used() -> None:
    rng = np.random.default_rng(5)
    T = [draw_pose(rng, BOARD, CAMERA, SIZE[0], math.radians(tilt)) for tilt in (40.0, 8.0)]
    views = [seen(rng, one) for one in T]
    images = tuple(
        ImageObservation(name, name, 1, name, 0, "default", None, *SIZE) for name in ("steep", "flat")
    )
    data = SessionData((BOARD,), ("board",), images, group_views(images, dict(enumerate(views))))
    steep, flat = image_poses(data, estimate_session(data, "per_image"))
    assert steep.used
    assert flat.reason is not None
    assert (flat.used, flat.reason.code) == (False, "focal_weakly_observable")
    alone = calibrate_points(stack_views(views).view(1))
    assert flat.pose is not None
    assert flat.pose.covariance is not None
    own = flat.pose.own_covariance()
    assert own is not None
    np.testing.assert_allclose(flat.pose.position_mm, alone.pose.position_mm)
    np.testing.assert_allclose(flat.pose.covariance, alone.pose.covariance)
    np.testing.assert_allclose(own, alone.pose.covariance_given_camera, atol=1e-9 * np.abs(own).max())
    error = invert(T[1])[:3, 3] - flat.pose.position_mm
    assert error @ np.linalg.solve(flat.pose.covariance[:3, :3], error) < 20.0
