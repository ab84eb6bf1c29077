"""Differences of figures between sessions: worked examples, coverage by simulation, what is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import chdtri

from core.errors import InvalidArgument
from core.metrology import estimate_difference


def test_symmetric_intervals_give_the_root_of_the_sum_of_squares() -> None:
    found = estimate_difference(10.0, (7.0, 13.0), 20.0, (16.0, 24.0))
    assert found.difference == 10.0
    assert found.interval == pytest.approx((5.0, 15.0))
    assert found.change == "larger"
    assert found.ratio == pytest.approx(2.0)


def test_a_figure_that_may_be_zero_has_a_difference_and_no_ratio() -> None:
    found = estimate_difference(0.0, (0.0, 0.02), 0.01, (0.0, 0.03))
    assert (found.ratio, found.ratio_interval, found.change) == (None, None, "no_change_shown")


def test_exchanged_sessions_give_the_opposite() -> None:
    there = estimate_difference(0.05, (0.04, 0.07), 0.03, (0.025, 0.036))
    back = estimate_difference(0.03, (0.025, 0.036), 0.05, (0.04, 0.07))
    assert (there.change, back.change) == ("smaller", "larger")
    assert there.interval == pytest.approx((-back.interval[1], -back.interval[0]))
    assert there.ratio is not None
    assert back.ratio == pytest.approx(1.0 / there.ratio)


def test_the_interval_covers_the_ratio_of_two_scatters() -> None:
    """Standard deviations of 10 values with chi-squared intervals: 95 %, within four standard errors and a half point.

    Where both intervals are exact, the method's own approximation is below half a percent (Zou and Donner, table 2).
    """
    rng = np.random.default_rng(4)
    runs, n, true = 4000, 10, (0.04, 0.06)
    reach = np.sqrt((n - 1) / np.array([chdtri(n - 1, 0.025), chdtri(n - 1, 0.975)]))
    covered = 0
    for _ in range(runs):
        s = [float(rng.normal(0.0, sigma, n).std(ddof=1)) for sigma in true]
        found = estimate_difference(
            s[0],
            (s[0] * float(reach[0]), s[0] * float(reach[1])),
            s[1],
            (s[1] * float(reach[0]), s[1] * float(reach[1])),
        )
        assert found.ratio_interval is not None
        covered += found.ratio_interval[0] <= true[1] / true[0] <= found.ratio_interval[1]
    assert abs(covered / runs - 0.95) < 4.0 * math.sqrt(0.95 * 0.05 / runs) + 0.005


@pytest.mark.parametrize("interval", [(0.06, 0.07), (math.nan, 0.07), (0.04, math.inf)])
def test_a_figure_outside_of_its_interval_is_refused(interval: tuple[float, float]) -> None:
    with pytest.raises(InvalidArgument):
        estimate_difference(0.05, interval, 0.05, (0.04, 0.06))
