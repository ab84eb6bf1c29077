"""Forecast of a planned session: its floor is the scatter that a motionless robot shows in such a session."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from core.calibration import estimate_group
from core.errors import FocalNotObservable, InvalidArgument
from core.geometry import Camera, project, so3_exp, transform, transform_points
from core.metrology import PoseCycles, assess_repeatability
from core.simulation import PlannedSession, forecast_repeatability
from core.targets import GridPoints, TargetSpec

TARGET = TargetSpec("chessboard", 9, 6, 30.0)
CAMERA = Camera(2320.0, 2320.0, 1223.5, 1024.5, 0.0, 0.0, 0.0, 0.0)
SIZE = (2448, 2050)
SIGMA_PX = 0.03


def view(tilt_x: float, tilt_y: float, x_mm: float = 0.0) -> np.ndarray:
    middle = TARGET.points_target().mean(axis=0)
    R = so3_exp(np.array([tilt_x, tilt_y, 0.0]))
    return transform(R, np.array([x_mm, 0.0, 700.0]) - R @ middle)


PLANNED = PlannedSession(
    TARGET,
    CAMERA,
    SIZE,
    np.array([view(0.3, 0.0), view(0.3, 0.1, 60.0)]),
    np.array([view(0.4, 0.0), view(-0.4, 0.0), view(0.0, 0.4), view(0.0, -0.4)]),
    12,
    SIGMA_PX,
)


def test_the_floor_is_what_a_motionless_robot_reads() -> None:
    found = forecast_repeatability(PLANNED, 0.05, draws=10)
    rng = np.random.default_rng(7)
    row, column = (a.ravel() for a in np.mgrid[0:6, 0:9])
    readings = []
    for _ in range(20):
        views = []
        for T in (*np.repeat(PLANNED.views, 12, axis=0), *PLANNED.additional_views):
            exact = project(transform_points(T, TARGET.points_target()), CAMERA)
            noisy = exact + rng.normal(0.0, SIGMA_PX, exact.shape)
            views.append(GridPoints(TARGET, *SIZE, column, row, noisy, np.full(len(exact), SIGMA_PX)))
        estimate = estimate_group(views, "pooled")
        cycles = [PoseCycles(estimate.positions_mm[k : k + 12]) for k in (0, 12)]
        readings.append([one.repeatability.position_mm for one in assess_repeatability(cycles)])
    # A reading of 12 cycles scatters by some 20 %, the mean of 20 by 5.
    expected = np.mean(readings, axis=0)
    assert [one.floor_mm for one in found.poses] == pytest.approx(expected, rel=0.2)


def test_a_view_that_does_not_show_the_target_passes_nothing() -> None:
    found = forecast_repeatability(PLANNED, 0.05, limit_mm=0.5, draws=5)
    assert found.decisions is not None
    assert found.decisions["pass"] == 1.0
    with_hidden = replace(PLANNED, views=np.array([*PLANNED.views, view(0.3, 0.0, 5000.0)]))
    found = forecast_repeatability(with_hidden, 0.05, limit_mm=0.5, draws=5)
    assert [one.in_view for one in found.poses] == [True, True, False]
    assert found.decisions == {"pass": 0.0, "fail": 0.0, "inconclusive": 1.0}
    failed = forecast_repeatability(with_hidden, 0.5, limit_mm=0.05, draws=5).decisions
    assert failed is not None
    assert failed["fail"] == 1.0, "one pose beyond the limit is enough"


def test_the_images_of_a_stop_share_the_noise() -> None:
    alone = forecast_repeatability(PLANNED, 0.05, draws=2)
    four = forecast_repeatability(replace(PLANNED, images_per_stop=4), 0.05, draws=2)
    assert [one.floor_mm for one in four.poses] == pytest.approx([one.floor_mm / 2.0 for one in alone.poses])
    with pytest.raises(InvalidArgument):
        forecast_repeatability(replace(PLANNED, images_per_stop=0), 0.05)


def test_a_robot_well_above_the_floor_is_seen_and_decided_on() -> None:
    floor = max(one.floor_mm for one in forecast_repeatability(PLANNED, 0.05, draws=2).poses)
    found = forecast_repeatability(PLANNED, 8.0 * floor, limit_mm=32.0 * floor, draws=40)
    for one in found.poses:
        assert one.verdicts == {"robot": 1.0}
        assert one.interval_mm[0] < one.reading_mm < one.interval_mm[1]
        assert one.reading_mm == pytest.approx(8.0 * floor, rel=0.15)
    assert found.decisions == {"pass": 1.0, "fail": 0.0, "inconclusive": 0.0}
    none = forecast_repeatability(PLANNED, 0.2 * floor, draws=10)
    assert not any("robot" in one.verdicts for one in none.poses)
    assert none.decisions is None


def test_what_is_not_in_view_is_said_and_what_determines_nothing_is_refused() -> None:
    beyond = replace(PLANNED, views=np.array([view(0.3, 0.0), view(0.3, 0.0, 400.0)]))
    assert [one.in_view for one in forecast_repeatability(beyond, 0.05, draws=2).poses] == [True, False]
    with pytest.raises(InvalidArgument, match="No planned view"):
        forecast_repeatability(replace(PLANNED, views=np.array([view(0.3, 0.0, 400.0)])), 0.05)
    with pytest.raises(InvalidArgument):
        forecast_repeatability(PLANNED, 0.0)
    with pytest.raises(InvalidArgument):
        forecast_repeatability(replace(PLANNED, cycles=1), 0.05)
    frontal = replace(PLANNED, views=np.array([view(0.0, 0.0)]), additional_views=np.empty((0, 4, 4)))
    with pytest.raises(FocalNotObservable):
        forecast_repeatability(frontal, 0.05)
