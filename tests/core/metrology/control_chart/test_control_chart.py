"""Control charts: run lengths as published and as simulated, standard normal scores, changes that are found."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import ndtr

from core.errors import InvalidArgument
from core.metrology import chart_figure, ewma_limit, ewma_run_length, self_starting_scores
from core.metrology.control_chart.change_point import first_step
from core.metrology.control_chart.chart import RUN_LENGTH, SMOOTHING


@pytest.mark.parametrize(
    ("smoothing", "limit"), [(0.4, 3.054), (0.25, 2.998), (0.2, 2.962), (0.1, 2.814), (0.05, 2.615)]
)
def test_limits_are_the_published_ones(smoothing: float, limit: float) -> None:
    """Lucas and Saccucci (1990), table 3: limits for false alarms 500 apart, to their last digit."""
    assert ewma_limit(smoothing, 500.0) == pytest.approx(limit, abs=0.001)


@pytest.mark.parametrize(("shift", "published"), [(0.5, 48.2), (1.0, 11.1), (2.0, 3.6), (3.0, 2.3)])
def test_run_lengths_after_a_shift_are_the_published_ones(shift: float, published: float) -> None:
    """Lucas and Saccucci (1990), table 3, λ = 0.25, L = 2.998: by a Markov chain, to three digits at most."""
    assert ewma_run_length(0.25, 2.998, shift) == pytest.approx(published, abs=0.1)


def test_without_smoothing_it_is_a_chart_of_single_values() -> None:
    """λ = 1: alarms are independent, with the probability of a value beyond L."""
    assert ewma_run_length(1.0, 3.0) == pytest.approx(1.0 / (2.0 * ndtr(-3.0)), rel=1e-9)


def test_simulated_run_lengths_agree() -> None:
    """The mean of 4,000 run lengths lies within four of its standard errors."""
    rng = np.random.default_rng(3)
    smoothing, expected, runs = 0.2, 20.0, 4000
    h = ewma_limit(smoothing, expected) * math.sqrt(smoothing / (2.0 - smoothing))
    level, alive, lengths = np.zeros(runs), np.ones(runs, bool), np.zeros(runs)
    while alive.any():
        level[alive] += smoothing * (rng.normal(size=int(alive.sum())) - level[alive])
        lengths[alive] += 1
        alive &= np.abs(level) <= h
    assert abs(lengths.mean() - expected) < 4.0 * lengths.std() / math.sqrt(runs)


def test_scores_are_independent_and_standard_normal_from_the_third_value_on() -> None:
    """The share of false alarms within 60 sessions is that of known parameters, whatever mean and scatter are."""
    rng = np.random.default_rng(5)
    runs, sessions = 3000, 12
    scores = np.array([self_starting_scores(rng.normal(3.0, 0.2, sessions)) for _ in range(runs)])
    assert scores.shape == (runs, sessions - 2)
    correlation = np.corrcoef(scores.T)
    off = correlation[np.triu_indices(sessions - 2, 1)]
    assert np.abs(scores.mean(axis=0)).max() < 4.0 / math.sqrt(runs)
    assert np.abs(scores.var(axis=0) - 1.0).max() < 4.0 * math.sqrt(2.0 / runs)
    assert np.abs(off).max() < 4.0 / math.sqrt(runs)
    beyond = (np.abs(scores) > 1.959964).mean()
    assert abs(beyond - 0.05) < 4.0 * math.sqrt(0.05 * 0.95 / scores.size)


@pytest.mark.slow
def test_false_alarms_of_self_starting_charts_come_at_the_stated_rate() -> None:
    """600 robots, each from its first session to its first alarm, at most 3,000 sessions."""
    rng = np.random.default_rng(11)
    runs, longest = 600, 3000
    lengths = []
    for _ in range(runs):
        alarm = chart_figure(np.exp(rng.normal(-3.0, 0.1, longest)), logarithms=True).alarm
        lengths.append(longest if alarm is None else alarm.at - 1)
    expected = RUN_LENGTH * (1.0 - math.exp(-longest / RUN_LENGTH))  # what the cut takes away
    assert abs(np.mean(lengths) - expected) < 4.0 * np.std(lengths) / math.sqrt(runs)


def test_a_lasting_change_is_found_and_placed() -> None:
    rng = np.random.default_rng(1)
    values = np.exp(rng.normal(math.log(0.05), 0.06, 40))
    values[25:] *= 1.15
    chart = chart_figure(values, logarithms=True)
    assert chart.alarm is not None
    assert chart.alarm.direction == "up"
    assert 25 <= chart.alarm.at <= 35
    assert abs(chart.alarm.since - 25) <= 3
    assert chart.alarm.before == pytest.approx(0.05, rel=0.05)
    assert chart.alarm.after == pytest.approx(0.0575, rel=0.05)
    assert chart_figure(values[:25], logarithms=True).alarm is None


@pytest.mark.parametrize(("step", "before"), [(5.0, 3), (10.0, 3), (50.0, 3), (-10.0, 5), (20.0, 8)])
def test_a_large_step_is_shown_however_early_it_is(step: float, before: int) -> None:
    """The scatter that self-starting scores are in contains the step: the EWMA shows 0 to 90 % of these, ever."""
    rng = np.random.default_rng(12)
    for _ in range(20):
        values = rng.normal(size=40)
        values[before:] += step
        alarm = chart_figure(values, logarithms=False, run_length=8.0 * RUN_LENGTH).alarm
        assert alarm is not None
        assert alarm.direction == ("up" if step > 0.0 else "down")
        assert abs(alarm.since - before) <= 1


def test_two_levels_show_falsely_no_more_often_than_stated() -> None:
    rng = np.random.default_rng(8)
    runs, sessions, risk = 1000, 20, 0.01
    alarms = sum(first_step(rng.normal(5.0, 0.1, sessions), risk) is not None for _ in range(runs))
    assert alarms < runs * risk * sessions
    assert first_step(np.array([1.0, 1.0, 2.0, 2.0, 2.0]), risk) is None


@pytest.mark.parametrize("direction", ["up", "down"])
def test_an_alarm_states_levels_that_differ_the_way_it_went(direction: str) -> None:
    """The first session stands out one way, later ones go the other way by less, and farther back in the end."""
    rng = np.random.default_rng(6)
    found = []
    for _ in range(60):
        values = rng.normal(size=70)
        values[0] += 8.0
        values[30:] += 1.5
        values[60:] -= 9.0
        alarm = chart_figure(
            values if direction == "up" else -values, logarithms=False, run_length=20.0
        ).alarm
        found += [alarm] if alarm is not None and alarm.direction == direction else []
    assert len(found) > 10
    assert all((alarm.after > alarm.before) == (direction == "up") for alarm in found)


def test_limits_of_individuals_are_those_of_the_standard() -> None:
    """Worked by hand: moving ranges 1, 2, 1, 4, mean 2; limits at 2.66 mean moving ranges (ISO 7870-2)."""
    chart = chart_figure([10.0, 11.0, 9.0, 10.0, 14.0], logarithms=False)
    limits = chart.limits
    assert limits.centre == pytest.approx(10.8)
    assert limits.upper - limits.centre == pytest.approx(2.66 * 2.0, abs=0.01)
    assert limits.centre - limits.lower == pytest.approx(2.66 * 2.0, abs=0.01)


def test_a_single_session_that_stands_out_is_named_and_is_no_lasting_change() -> None:
    values = [
        0.05,
        0.051,
        0.049,
        0.0505,
        0.0495,
        0.05,
        0.09,
        0.0502,
        0.0498,
        0.0501,
        0.0499,
        0.05,
        0.0502,
        0.0497,
    ]
    chart = chart_figure(values, logarithms=True)
    assert chart.outside == (6,)
    assert chart.limits.lower > 0.0


@pytest.mark.parametrize("step", [0.5, 1.0, 1.5, 3.0])
def test_rounded_values_show_falsely_no_more_often_than_stated(step: float) -> None:
    """Steps in standard deviations. Of unrounded values 0.15 of runs have a false alarm within 60 sessions."""
    rng = np.random.default_rng(21)
    runs, sessions = 300, 60
    stated = 1.0 - math.exp(-sessions / RUN_LENGTH)
    alarms = 0
    for _ in range(runs):
        values = 100.0 + step * np.round((rng.normal(size=sessions) + rng.uniform(0.0, 10.0)) / step)
        alarms += chart_figure(values, logarithms=False).alarm is not None
    assert alarms / runs < stated + 2.0 * math.sqrt(stated * (1.0 - stated) / runs)


def test_a_lasting_change_of_rounded_values_is_shown() -> None:
    """One step of rounding up, for good, after equal values; once is no lasting change."""
    assert self_starting_scores(np.array([1.0, 1.0, 1.0, 2.0])) == pytest.approx([0.0, 1.6672], abs=1e-4)
    assert chart_figure([0.05] * 12 + [0.06] + [0.05] * 12, logarithms=True).alarm is None
    for before in (5, 12):
        alarm = chart_figure([0.05] * before + [0.06] * 16, logarithms=True).alarm
        assert alarm is not None
        assert (alarm.since, alarm.direction) == (before, "up")


def test_values_that_never_differ_raise_no_alarm() -> None:
    assert chart_figure([0.05] * 8, logarithms=True).alarm is None
    assert len(self_starting_scores(np.array([1.0, 2.0]))) == 0


def test_scores_do_not_depend_on_unit_and_offset() -> None:
    rng = np.random.default_rng(2)
    x = rng.normal(size=30)
    assert self_starting_scores(1e6 + 3.0 * x) == pytest.approx(self_starting_scores(x), abs=1e-6)
    far = self_starting_scores(np.concatenate([x, [1e9]]))
    assert np.isfinite(far).all()
    assert far[-1] > 8.0


@pytest.mark.parametrize("values", [[1.0] * 4, [1.0, 2.0, 3.0, 4.0, math.nan], [1.0, 2.0, 3.0, 4.0, 0.0]])
def test_what_cannot_be_charted_is_refused(values: list[float]) -> None:
    with pytest.raises(InvalidArgument):
        chart_figure(values, logarithms=True)


def test_limits_out_of_range_are_refused() -> None:
    for wrong in ((0.01, 3.0), (0.2, 0.0), (0.2, math.nan)):
        with pytest.raises(InvalidArgument):
            ewma_run_length(*wrong)
    with pytest.raises(InvalidArgument):
        ewma_limit(SMOOTHING, 1.0)
