"""Sessions whose images all have one orientation, before a print that is slightly bowed."""

from __future__ import annotations

import math

import numpy as np
import pytest

from core.calibration.multi_view.estimators import estimate_group
from core.calibration.multi_view.group_estimate import GroupEstimate
from core.errors import FocalNotObservable
from core.geometry.camera import project
from core.geometry.se3 import transform, transform_points
from core.targets.specification import GridPoints, TargetSpec
from tests.support.simulation.simulated_views import draw_camera, draw_pose

BOARD = TargetSpec("chessboard", 14, 10, 20.0)
WIDTH, HEIGHT = 2448, 2050
SIGMA_PX = 0.02


def session_of_one_orientation(seed: int, tilt_deg: float, bow: float, images: int = 25) -> list[GridPoints]:
    """Return images at random places, all points within; the bow is a share of the board's longer side."""
    rng = np.random.default_rng(seed)
    camera = draw_camera(rng)
    printed = BOARD.points_target().copy()
    extent = np.ptp(printed, axis=0)
    x, y = printed[:, 0] / extent[0] - 0.5, printed[:, 1] / extent[1] - 0.5
    printed[:, 2] = 2.0 * bow * extent[0] * (x * x + y * y)
    rotation = draw_pose(rng, BOARD, camera, WIDTH, math.radians(tilt_deg))[:3, :3]
    row, column = (a.ravel() for a in np.mgrid[0:10, 0:14])
    middle = printed.mean(axis=0)
    views: list[GridPoints] = []
    while len(views) < images:
        depth = camera.fx_px * extent[0] / WIDTH * rng.uniform(1.4, 4.0)
        centre = np.array([*rng.uniform(-0.25, 0.25, 2) * depth, depth])
        pixels = project(transform_points(transform(rotation, centre - rotation @ middle), printed), camera)
        if pixels.min() > 0.0 and pixels[:, 0].max() < WIDTH - 1 and pixels[:, 1].max() < HEIGHT - 1:
            noisy = pixels + rng.normal(0.0, SIGMA_PX, pixels.shape)
            views.append(GridPoints(BOARD, WIDTH, HEIGHT, column, row, noisy, np.full(140, SIGMA_PX)))
    return views


def pooled(seed: int, tilt_deg: float, bow: float) -> GroupEstimate:
    return estimate_group(session_of_one_orientation(seed, tilt_deg, bow), "pooled", repeats=range(25))


@pytest.mark.parametrize("seed", range(4))
def test_a_bowed_print_of_one_orientation_converges(seed: int) -> None:
    """Focal length and depths are in one narrow curved valley, in which the bow puts the minimum far from the start."""
    for tilt_deg, bow in ((10.0, 0.002), (20.0, 0.001), (30.0, 0.002)):
        found = pooled(seed, tilt_deg, bow)
        assert len(found.images) == 25
        # What the bow does to the camera is not hidden.
        assert found.inflation > 1.5


def test_facing_the_camera_the_focal_length_is_not_observable() -> None:
    with pytest.raises(FocalNotObservable):
        pooled(1, 0.0, 0.001)


@pytest.mark.slow
@pytest.mark.parametrize("tilt_deg", [10.0, 20.0, 30.0])
@pytest.mark.parametrize("bow", [0.0005, 0.001, 0.002])
def test_every_session_of_one_orientation_converges(tilt_deg: float, bow: float) -> None:
    """One that is refused lacks the focal length, and says so."""
    for seed in range(10, 22):
        try:
            found = pooled(seed, tilt_deg, bow)
        except FocalNotObservable:
            assert tilt_deg == 10.0
        else:
            assert len(found.images) == 25
