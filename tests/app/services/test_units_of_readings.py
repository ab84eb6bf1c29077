"""Readings in another unit: service and analyses, which share no code across processes, judge in the same way."""

from __future__ import annotations

import numpy as np
import pytest

from app.errors import InvalidContent
from app.services.plausibility import check_readings, readings
from core.session import CommandedPose
from core.session.commanded_poses import contradicted_unit, units
from core.session.model import MeasuredPose


def test_both_take_the_same_scales_and_spans_for_units() -> None:
    assert readings.MAX_METRES == units.MAX_METRES
    assert readings.MAX_SCATTER_SHARE == units.MAX_SCATTER_SHARE
    assert readings.MIN_COMMANDED_MM == units.MIN_COMMANDED_MM
    assert readings.UNIT_FACTOR == units.FACTOR


@pytest.mark.parametrize("scale", [1e-3, 0.4e-3, 0.25e-3, 2.5e-3, 1e3, 5e3, 1.0, 0.1])
@pytest.mark.parametrize("scatter", [1e-5, 1e-3, 0.05])
def test_a_list_is_refused_where_an_analysis_would_contradict_it(scale: float, scatter: float) -> None:
    rng = np.random.default_rng(4)
    places = rng.uniform(-300.0, 300.0, (5, 3)) + np.array([400.0, 0.0, 500.0])
    read = scale * (places[:, None] + scatter * 600.0 * rng.standard_normal((5, 6, 3)))
    commanded = {f"P{k}": place.tolist() for k, place in enumerate(places)}
    listed = [(f"P{k}", row.tolist()) for k in range(5) for row in read[k]]
    visits = {
        f"P{k}": [
            MeasuredPose("m", f"P{k}", cycle, None, row, None, None, None, None)
            for cycle, row in enumerate(read[k], 1)
        ]
        for k in range(5)
    }
    found = contradicted_unit(
        visits, {name: CommandedPose(place, None, None, None) for name, place in commanded.items()}
    )
    if found is None:
        check_readings(listed, commanded)
    else:
        with pytest.raises(InvalidContent):
            check_readings(listed, commanded)
