"""One image that determines too little, or nothing that can be: refused in words, with the points kept."""

from __future__ import annotations

import contextlib
import dataclasses
import math

import numpy as np
import pytest

from core.calibration.priors import Lens
from core.calibration.single_image import calibrate_points
from core.errors import ADVISED_TILT, DegenerateGeometry, FocalNotObservable, GridposeError, InvalidArgument
from tests.support.simulation.simulated_views import draw_view


@pytest.mark.parametrize("tilt", [0.0, 0.5, 1.0])
def test_a_nearly_fronto_parallel_view_is_refused_and_keeps_its_points(tilt: float) -> None:
    rng = np.random.default_rng(int(10 * tilt))
    for _ in range(5):
        view = draw_view(rng, tilt_deg=tilt)
        with pytest.raises(FocalNotObservable) as refusal:
            calibrate_points(view.points)
        assert refusal.value.points is view.points
        assert ADVISED_TILT in str(refusal.value.advice)


def test_points_on_one_line_are_degenerate() -> None:
    view = draw_view(np.random.default_rng(9))
    keep = view.points.row == 0
    line = view.points.take(keep)
    for options in ({}, {"intrinsics": view.camera}):
        with pytest.raises(DegenerateGeometry) as failure:
            calibrate_points(line, **options)  # type: ignore[arg-type]
        assert failure.value.points is line


def test_nonsense_points_end_in_a_failure_with_advice_not_in_a_pose() -> None:
    rng = np.random.default_rng(10)
    view = draw_view(rng)
    outcomes: list[float] = []
    for _ in range(10):
        px = rng.uniform(0, 2000, view.points.points_px.shape)
        points = dataclasses.replace(view.points, points_px=px)
        with contextlib.suppress(GridposeError):
            outcomes.append(calibrate_points(points).reprojection.rms_px)
    assert all(rms > 20.0 for rms in outcomes)  # what gets through says so itself


@pytest.mark.parametrize("values", [(0.0, 3.45), (8.0, -1.0), (math.nan, 3.45), (math.inf, 3.45)])
def test_an_impossible_lens_is_refused(values: tuple[float, float]) -> None:
    with pytest.raises(InvalidArgument):
        Lens(*values)
