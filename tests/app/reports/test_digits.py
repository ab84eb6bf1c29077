"""Figures in reports: digits of skewed intervals and floors, and the coverage factor of a certificate's shifts."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from app.reports.forms.blocks import of_its_own_size, with_interval
from app.reports.forms.certificate.repeatability import _drift


@pytest.mark.parametrize(
    ("value", "interval", "value_text", "interval_text"),
    [
        (0.0488, [0.0394, 0.127], "0.049", "0.039 … 0.127"),
        (156.78, [97.09, 648.9], "157", "97 … 649"),
        (99.7, [0.135, 99.7], "100", "0.14 … 100"),
        (99.71, [0.135, 99.74], "99.71", "0.14 … 99.74"),
        (0.001, [-0.3, 0.3], "0.00", "−0.30 … 0.30"),
        (0.00012, [0.0, 0.3], "0.00012", "0.000 … 0.300"),
        (0.0, [0.0, 0.0], "0.0000", "0.0000 … 0.0000"),
    ],
)
def test_an_end_of_an_interval_is_written_as_neither_0_nor_the_value(
    value: float, interval: Sequence[float], value_text: str, interval_text: str
) -> None:
    assert with_interval(value, interval) == (value_text, interval_text)


@pytest.mark.parametrize(
    ("floor", "text"), [(0.00246, "0.0025"), (0.0000123, "0.000012"), (0.0, "0.0000"), (None, "–")]
)
def test_a_floor_has_two_digits_of_its_own(floor: float | None, text: str) -> None:
    assert of_its_own_size(floor) == text


def test_drift_has_the_coverage_factor_of_its_degrees_of_freedom() -> None:
    one = {
        "pose_id": "P1",
        "shift_mm": [0.01, 0.02, 0.03],
        "shift_standard_uncertainty_mm": [0.004, 0.004, 0.004],
        "shift_degrees_of_freedom": [18.0, 18.0, 9.0],
        "shift_distance_mm": 0.04,
        "shift_distance_standard_uncertainty_mm": 0.004,
        "shift_distance_degrees_of_freedom": 20.0,
        "drp_mm": 0.001,
    }
    earlier = {name: value for name, value in one.items() if "freedom" not in name}
    results = [_drift({"drift": {"poses": [pose]}}) for pose in (one, earlier)]
    found = [
        float(k.text or "nan")
        for result in results
        for each in result
        for k in each.iter("si:coverageFactor")
    ]
    # JCGM 100:2008, table G.2; the normal distribution's where an earlier version stated none.
    assert found == pytest.approx([2.10, 2.10, 2.26, 2.09, 1.96, 1.96, 1.96, 1.96], abs=0.005)
