"""A cycle in which all poses were displaced together is named; steady, heavy-tailed and wandering cycles are not."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.stats import binom

from core.metrology import assess_steadiness
from core.metrology.steadiness.cycle_grid import cycle_grid
from core.metrology.steadiness.displaced_cycles import MAX_CHANCE, find_displaced_cycles
from tests.support.simulation import session_cycles as made

Make = Callable[[np.random.Generator, int], np.ndarray]


def displaced(x: np.ndarray) -> list[int]:
    grid = cycle_grid(made.series_of(x))
    assert grid is not None
    return [one.cycle for one in find_displaced_cycles(grid)]


def wandering(rng: np.random.Generator, n: int) -> np.ndarray:
    """A common motion that correlates by .9 from cycle to cycle, three times as large as the poses' own scatter."""
    common = made.correlated(rng, n, poses=1, phi=0.9)
    return np.asarray(3.0 * common + made.gaussian(rng, n))


@pytest.mark.parametrize("cycles", [12, 30])
@pytest.mark.parametrize("bumped", [(4,), (4, 5), (3, 9), (-1,)])
def test_cycles_that_displace_all_poses_are_named(cycles: int, bumped: tuple[int, ...]) -> None:
    found = []
    for seed in range(5):
        x = made.gaussian(np.random.default_rng([seed, 41]), cycles)
        x[list(bumped)] += 25.0 * x.std() * np.array([0.6, 0.8, 0.0])
        found.append(displaced(x) == sorted((place % cycles) + 1 for place in bumped))
    assert all(found)


def test_a_bump_of_six_deviations_of_a_pose_is_named_in_thirty_cycles() -> None:
    found = []
    for seed in range(20):
        x = made.gaussian(np.random.default_rng([seed, 42]), 30)
        x[14] += np.array([6.0 * x.std(), 0.0, 0.0])
        found.append(displaced(x) == [15])
    assert sum(found) >= 17


def test_the_session_is_not_steady() -> None:
    x = made.gaussian(np.random.default_rng(43), 30)
    x[14] += np.array([0.3, 0.0, 0.0])
    found = assess_steadiness(made.series_of(x))
    assert found.steady is False
    assert found.moved == frozenset(range(5))
    assert found.p_values is not None
    assert found.p_values.overall > 0.01  # the order of the cycles does not show it
    (one,) = found.displaced
    assert one.displacement_mm[0] == pytest.approx(0.3, abs=0.05)


@pytest.mark.parametrize("make", [made.gaussian, made.student, made.needles, wandering, made.common_step])
@pytest.mark.parametrize("sessions", [60, pytest.param(1500, marks=pytest.mark.slow)])
def test_steady_and_wandering_cycles_are_not_displaced(make: Make, sessions: int) -> None:
    """A bound that fails by chance once in 100,000 runs."""
    alarms = 0
    for seed in range(sessions):
        rng = np.random.default_rng([seed, 44])
        alarms += bool(displaced(make(rng, (10, 30)[seed % 2])))
    assert alarms <= binom.isf(1e-5, sessions, MAX_CHANCE)


def test_a_slip_of_one_pose_is_not_the_mounts() -> None:
    x = made.gaussian(np.random.default_rng(45), 30, poses=3)
    x[7, 0] += np.array([2.0, 0.0, 0.0])
    assert displaced(x) == []
    x = made.gaussian(np.random.default_rng(46), 30)
    x[7, 0] += np.array([2.0, 0.0, 0.0])
    assert displaced(x) == []


def test_nothing_is_named_in_few_cycles_or_of_two_poses() -> None:
    for cycles, poses in ((9, 5), (30, 2)):
        x = made.gaussian(np.random.default_rng(47), cycles, poses=poses)
        x[3] += 5.0
        assert displaced(x) == []
