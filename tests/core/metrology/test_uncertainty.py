"""Intervals, floors and subtraction where the answer is known exactly."""

from __future__ import annotations

import math

import numpy as np
import pytest

from core.metrology.repeatability import (
    IntervalEstimate,
    assess_radial,
    assess_three_sigma,
    noise_only_lengths,
)
from core.metrology.repeatability.verdict import Verdict, classify
from core.metrology.rp_distribution import long_run_rp


def three_sigma(variance: float, noise: float, n: int, noise_square: float | None = None) -> IntervalEstimate:
    square = noise * noise if noise_square is None else noise_square
    return assess_three_sigma(
        np.array([[variance]]), np.array([[noise]]), np.array([[square]]), np.array([float(n)])
    )


def radial(covariance: np.ndarray, noise: np.ndarray, reading: float, n: int) -> IntervalEstimate:
    still = noise_only_lengths(np.repeat(noise[None], n, axis=0))
    return assess_radial(
        np.array([reading]),
        covariance[None],
        noise[None],
        np.zeros(1),
        np.array([still]),
        np.array([float(n)]),
    )


@pytest.mark.parametrize(("n", "low", "high"), [(30, 0.796, 1.344), (10, 0.688, 1.826), (2, 0.446, 31.91)])
def test_intervals_of_three_sigma_are_the_published_chi_square_factors(
    n: int, low: float, high: float
) -> None:
    # √(ν / χ²_{.975, ν}) and √(ν / χ²_{.025, ν}) as in any table of the chi-square distribution.
    result = three_sigma(4.0, 0.0, n)
    assert result.low[0, 0] / 6.0 == pytest.approx(low, abs=6e-4)
    assert result.high[0, 0] / 6.0 == pytest.approx(high, rel=6e-4)


@pytest.mark.parametrize(("n", "c4"), [(2, 0.7979), (5, 0.9400), (10, 0.9727), (25, 0.9896)])
def test_floor_of_three_sigma_is_the_control_charts_c4(n: int, c4: float) -> None:
    assert three_sigma(1.0, 0.25, n).floor[0, 0] / 1.5 == pytest.approx(c4, abs=5e-5)


def test_cycles_of_unequal_noise_count_for_fewer() -> None:
    # Half of the cycles with variance 1, half with 9: mean 5, mean square 41, so ν = 29 · 25 / 41.
    result = three_sigma(5.0, 5.0, 30, noise_square=41.0)
    equal = three_sigma(5.0, 5.0, 19)  # 18 degrees of freedom against 17.7
    assert result.high[0, 0] == pytest.approx(equal.high[0, 0], rel=0.01)


def test_floor_of_two_measurements_is_half_their_mean_distance() -> None:
    # p_1 - p_2 ~ N(0, 2σ²): l = |p_1 - p_2| / 2, E l = ½ √2 σ 1.595769, S_l = 0
    length, within = noise_only_lengths(np.repeat(0.04 * np.eye(3)[None], 2, axis=0))
    assert length == pytest.approx(0.5 * math.sqrt(2.0) * 0.2 * 2.0 * math.sqrt(2.0 / math.pi), rel=1e-9)
    assert within == 0.0


def test_without_noise_nothing_is_corrected() -> None:
    covariance = np.diag([4.0, 1.0, 0.25])
    result = radial(covariance, np.zeros((3, 3)), 7.0, 30)
    assert result.floor[0] == 0.0
    assert result.corrected[0] == pytest.approx(7.0, rel=1e-12)
    assert (result.corrected_low[0], result.corrected_high[0]) == pytest.approx(
        (result.low[0], result.high[0])
    )
    assert three_sigma(4.0, 0.0, 30).corrected[0, 0] == pytest.approx(6.0, rel=1e-12)


def test_noise_above_all_that_was_observed_leaves_nothing() -> None:
    assert radial(np.eye(3), 2.0 * np.eye(3), 3.5, 30).corrected[0] == 0.0
    assert three_sigma(1.0, 2.0, 30).corrected[0, 0] == 0.0


def test_subtraction_is_by_squares_when_there_are_many_cycles() -> None:
    # 3 √(25 - 9) = 12; and 5² - 3² in every direction leaves 4/5 of the reading.
    assert three_sigma(25.0, 9.0, 100_000).corrected[0, 0] == pytest.approx(12.0, rel=1e-4)
    reading = float(long_run_rp(np.full(3, 25.0)))
    corrected = radial(25.0 * np.eye(3), 9.0 * np.eye(3), reading, 100_000).corrected[0]
    assert corrected == pytest.approx(0.8 * reading, rel=1e-3)


def test_noise_in_one_direction_leaves_the_others() -> None:
    covariance = np.diag([25.0, 4.0, 1.0])
    noise = np.diag([0.0, 0.0, 1.0])
    reading = float(long_run_rp(np.array([25.0, 4.0, 1.0])))
    expected = float(long_run_rp(np.array([25.0, 4.0, 0.0])))
    assert radial(covariance, noise, reading, 100_000).corrected[0] == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize(
    ("reading", "floor", "cycles", "verdict"),
    [
        (1.00, 0.25, 30, Verdict.ROBOT),
        (1.00, 0.26, 30, Verdict.INSTRUMENT_LIMITED),
        (0.76, 1.00, 30, Verdict.INSTRUMENT_LIMITED),
        (0.74, 1.00, 30, Verdict.BELOW_DETECTION),
        (0.00, 0.00, 30, Verdict.BELOW_DETECTION),
        (1.00, 0.00, 9, Verdict.TOO_FEW_CYCLES),
        (1.00, 0.00, 10, Verdict.ROBOT),
        (1.00, None, 30, Verdict.INSTRUMENT_LIMITED),
        (0.00, None, 30, Verdict.BELOW_DETECTION),
        (1.00, None, 9, Verdict.TOO_FEW_CYCLES),
    ],
)
def test_verdicts(reading: float, floor: float | None, cycles: int, verdict: Verdict) -> None:
    assert classify(reading, floor, cycles) is verdict
