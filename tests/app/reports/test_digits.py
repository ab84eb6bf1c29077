"""Digits of figures in reports: skewed intervals keep their lower end, floors have the digits of their own size."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from app.reports.forms.blocks import of_its_own_size, with_interval


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
