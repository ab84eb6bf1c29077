"""What the estimators refuse, in words: cameras that the images do not determine, and views that nothing explains."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from core.calibration.multi_view.estimators import ESTIMATORS, estimate_group
from core.errors import DegenerateGeometry, FocalNotObservable, GridposeError, InvalidArgument, NotConverged
from core.geometry.se3 import invert
from core.targets.specification import GridPoints, TargetSpec
from tests.support.simulation.robots.resting_robot import (
    BOARD,
    WIDTH,
    session,
    view,
)
from tests.support.simulation.simulated_views import draw_camera, draw_pose


def test_what_cannot_be_estimated_is_named() -> None:
    s = session(10, cycles=1)
    line = np.arange(14)
    short = s.views[0]
    on_a_line = short.take(line)
    for estimator in ESTIMATORS:
        found = estimate_group([*s.views, on_a_line], estimator, intrinsics=s.camera)
        assert [(i, type(failure)) for i, failure in found.failures] == [(5, DegenerateGeometry)]
        with pytest.raises(GridposeError):
            estimate_group([on_a_line], estimator, intrinsics=s.camera)
    flat = [view(np.random.default_rng(i), s.camera, invert(s.T_target_camera[0])) for i in range(2)]
    assert len(estimate_group(flat, "pooled").images) == 2
    with pytest.raises(InvalidArgument):
        estimate_group([], "pooled")
    with pytest.raises(InvalidArgument):
        estimate_group(s.views, "best")
    with pytest.raises(InvalidArgument):
        estimate_group(s.views, "given")
    with pytest.raises(InvalidArgument):
        estimate_group([*s.views, dataclasses.replace(s.views[0], image_width_px=100)], "pooled")


def test_flat_views_alone_are_refused() -> None:
    rng = np.random.default_rng(3)
    camera = draw_camera(rng)
    poses = [draw_pose(rng, BOARD, camera, WIDTH, math.radians(0.3)) for _ in range(4)]
    views = [view(rng, camera, T) for T in poses]
    with pytest.raises(FocalNotObservable):
        estimate_group(views, "pooled")
    # A camera that is known needs no tilt.
    assert len(estimate_group(views, "given", intrinsics=camera).images) == 4


@pytest.mark.parametrize("scale", [(-5.0, 5.0), (1e-3, 1e-3)])
def test_images_that_no_camera_takes_are_refused_in_words(scale: tuple[float, float]) -> None:
    """A mirrored board, and one of a hundredth of a pixel: the fit ends where it has no covariance."""
    board = TargetSpec("chessboard", 9, 6, 12.0)
    row, column = (a.ravel() for a in np.mgrid[0:6, 0:9])
    px = board.points_target()[:, :2] * scale + 600.0
    points = GridPoints(board, 1224, 1024, column, row, px, np.full(54, 0.02))
    for count in (1, 3):
        with pytest.raises(GridposeError):
            estimate_group([points] * count, "pooled")


def test_a_view_that_nothing_explains_does_not_pass() -> None:
    s = session(13, cycles=1)
    rng = np.random.default_rng(0)
    noise = dataclasses.replace(s.views[0], points_px=s.views[0].points_px + rng.normal(0.0, 30.0, (140, 2)))
    found = estimate_group([*s.views, noise], "pooled")
    ((place, failure),) = found.failures
    assert place == 5
    assert isinstance(failure, NotConverged)
    assert failure.advice
