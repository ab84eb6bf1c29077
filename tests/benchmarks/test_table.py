"""The tables measurements are kept in."""

from __future__ import annotations

import math

import pytest

from benchmarks.table import Row, figure, markdown, with_section


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.84213, "0.842"),
        (12.0, "12"),
        (0.0, "0"),
        (1234.5, "1,234"),
        (math.nan, "nan"),
        (0.00123, "0.00123"),
    ],
)
def test_figures_have_three_digits(value: float, text: str) -> None:
    assert figure(value) == text
    assert figure(value, "ms") == f"{text} ms"


def test_a_goal_is_met_on_its_own_side_and_never_by_nan() -> None:
    assert Row.at_most("x", 3.0, 3.0).met is True
    assert Row.at_most("x", 3.1, 3.0).met is False
    assert Row.at_least("x", 0.85, 0.85).met is True
    assert Row.within("x", 0.97, 0.93, 0.97).met is True
    assert Row.within("x", 0.975, 0.93, 0.97).met is False
    for row in (
        Row.at_most("x", math.nan, 1),
        Row.at_least("x", math.nan, 1),
        Row.within("x", math.nan, 0, 1),
    ):
        assert row.verdict == "NO"
    assert Row.context("x", 1.0).verdict == ""


def test_a_section_is_replaced_and_the_others_stay() -> None:
    document = with_section("# Measured\n\nHead.\n", "service", markdown([Row.at_most("b", 1, 2)]))
    document = with_section(document, "fit", markdown([Row.at_most("a", 3, 2)]))
    assert document.index("## fit") < document.index("## service")
    assert document.startswith("# Measured\n\nHead.\n\n## fit\n\n| what |")
    again = with_section(document, "fit", "gone\n")
    assert "| a |" not in again
    assert "| b | 1 | ≤ 2 | yes |" in again
