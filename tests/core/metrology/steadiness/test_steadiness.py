"""Steadiness: what is steady passes, what moves is found and attributed, and what cannot be tested is said so."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom

from core.metrology import Attribution, PoseSeries, assess_steadiness
from core.metrology.steadiness.cycle_grid import cycle_grid
from core.metrology.steadiness.permutation_test import permutation_test
from core.metrology.steadiness.two_points import find_two_points, max_within_share
from tests.support.simulation import session_cycles as made


@cache
def false_alarm(name: str, k: int) -> bool:
    rng = np.random.default_rng([k, 31])
    return assess_steadiness(made.series_of(made.STEADY[name](rng, 30))).steady is False


@pytest.mark.parametrize("name", made.STEADY)
@pytest.mark.parametrize("sessions", [40, pytest.param(400, marks=pytest.mark.slow)])
def test_steady_cycles_are_called_so(name: str, sessions: int) -> None:
    """False alarms are 1 % by construction; a bound that fails by chance once in 100,000 runs."""
    alarms = sum(false_alarm(name, k) for k in range(sessions))
    assert alarms <= binom.isf(1e-5, sessions, 0.012)


@pytest.mark.parametrize("make", [made.common_drift, made.correlated, made.two_points])
def test_what_moves_is_found(make: Any) -> None:
    """METHOD's power of .98 or more in 30 cycles: 20 of 20 but for one."""
    found = [
        assess_steadiness(made.series_of(make(np.random.default_rng([k, 5]), 30))).steady for k in range(20)
    ]
    assert sum(steady is False for steady in found) >= 19


@pytest.mark.parametrize(
    ("make", "expected"),
    [
        (made.common_step, Attribution.COMMON),
        (made.own_drifts, Attribution.POSE_BY_POSE),
        (made.one_drift, Attribution.POSE_BY_POSE),
    ],
)
def test_motion_is_attributed(make: Any, expected: Attribution) -> None:
    found = [assess_steadiness(made.series_of(make(np.random.default_rng(k), 30))) for k in range(12)]
    assert sum(one.attribution is expected for one in found) >= 11
    assert all(
        (one.attribution is None) == (one.p_values is not None and one.p_values.overall > 0.01)
        for one in found
    )


def test_one_moving_pose_leaves_the_others_steady() -> None:
    found = [
        assess_steadiness(made.series_of(made.one_drift(np.random.default_rng(k), 40, length_mm=0.3)))
        for k in range(10)
    ]
    assert sum(one.moved == frozenset({1}) for one in found) >= 8
    assert all(1 in one.moved for one in found)
    lengths = [np.linalg.norm(one.poses[1].change_mm) for one in found]
    assert np.mean(lengths) == pytest.approx(0.3, abs=0.02)


def test_the_step_is_placed_and_measured() -> None:
    x = made.common_step(np.random.default_rng(2), 30, length_mm=0.2)
    found = assess_steadiness(made.series_of(x))
    assert found.change_point is not None
    assert found.change_point.cycle == 21
    assert np.linalg.norm(found.change_point.step_mm) == pytest.approx(0.2, abs=0.03)
    u = found.change_point.standard_uncertainty_mm
    expected = made.SIGMA_MM * np.sqrt((1 / 20 + 1 / 10) / 5)
    assert u == pytest.approx(np.full(3, expected), rel=0.4)


def test_trend_of_the_common_series_has_its_uncertainty() -> None:
    """Over sessions the estimated change scatters as stated."""
    z = []
    for k in range(60):
        x = (
            made.gaussian(np.random.default_rng([k, 8]), 30)
            + np.linspace(0.0, 0.06, 30)[:, None, None] / 3**0.5
        )
        trend = assess_steadiness(made.series_of(x)).trend
        assert trend is not None
        z += ((trend.change_mm - 0.06 / 3**0.5) / trend.standard_uncertainty_mm).tolist()
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.25)


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5])
def test_few_cycles_are_not_tested(n: int) -> None:
    found = assess_steadiness(made.series_of(made.common_drift(np.random.default_rng(0), n, length_mm=5.0)))
    assert found.p_values is None
    assert found.steady is None
    assert found.moved == frozenset()


def test_nothing_at_all_is_not_tested() -> None:
    assert assess_steadiness([]).steady is None
    still = [PoseSeries(np.zeros((30, 3)), np.arange(30)) for _ in range(3)]
    assert assess_steadiness(still).steady is None


def test_visits_without_an_order_are_not_tested_but_may_have_two_points() -> None:
    x = made.two_points(np.random.default_rng(1), 30)
    unordered = [replace(one, cycles=None) for one in made.series_of(x)]
    found = assess_steadiness(unordered)
    assert found.p_values is None
    assert [one.pose for one in found.two_points] == [2]
    assert found.two_points[0].distance_mm == pytest.approx(9.0 * made.SIGMA_MM, rel=0.1)
    assert found.steady is False


@pytest.mark.parametrize("sessions", [12, pytest.param(40, marks=pytest.mark.slow)])
def test_missing_cycles_do_not_matter_much(sessions: int) -> None:
    """Steady with a fifth of the visits missing at random or at the end; moving all the same."""
    alarms = found = 0
    for k in range(sessions):
        rng = np.random.default_rng([k, 77])
        for x, moving in ((made.gaussian(rng, 30), False), (made.common_drift(rng, 30, length_mm=0.1), True)):
            series = made.series_of(x)
            for i, one in enumerate(series):
                kept = np.sort(rng.permutation(30)[:24]) if i < 3 else np.arange(24)
                series[i] = PoseSeries(one.positions_mm[kept], np.arange(1, 31)[kept])
            steady = assess_steadiness(series).steady
            alarms += not moving and steady is False
            found += moving and steady is False
    assert alarms <= binom.isf(1e-5, sessions, 0.015)
    assert found >= sessions - 1


def test_poses_visited_in_turn_are_compared_visit_by_visit() -> None:
    series = made.series_of(made.own_drifts(np.random.default_rng(3), 30))
    apart = [replace(one, cycles=np.arange(30) + 30 * i) for i, one in enumerate(series)]
    found, together = assess_steadiness(apart), assess_steadiness(series)
    assert found.grid is not None
    assert found.grid.by_visit
    assert found.p_values == together.p_values
    assert found.moved == together.moved


def test_the_test_is_the_same_in_any_frame_and_unit() -> None:
    """z is whitened: rotation, shift and scale change nothing beyond rounding, and no p sits on an edge here."""
    x = made.common_drift(np.random.default_rng(9), 30)
    turn = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    first = assess_steadiness(made.series_of(x)).p_values
    assert first == assess_steadiness(made.series_of(1000.0 * (x @ turn.T))).p_values
    assert first == assess_steadiness(made.series_of(x)).p_values


def test_a_single_pose_is_tested_and_not_attributed() -> None:
    found = assess_steadiness(made.series_of(made.own_drifts(np.random.default_rng(4), 30, poses=1)))
    assert found.steady is False
    assert found.attribution is Attribution.UNDETERMINED
    assert found.moved == frozenset({0})


def test_poses_in_other_frames_have_no_motion_in_common() -> None:
    series = [
        replace(one, frame=int(i == 4))
        for i, one in enumerate(made.series_of(made.common_step(np.random.default_rng(1), 30)))
    ]
    with_it, without = cycle_grid(series), cycle_grid(series[:4])
    assert with_it is not None
    assert without is not None
    assert with_it.present.shape[1] == 5
    # Shrinkage takes the mean shape of all poses, so that the weights differ a little.
    assert with_it.common_mm == pytest.approx(without.common_mm, abs=0.2 * made.SIGMA_MM)


def test_statistics_agree_with_their_definitions() -> None:
    """p of one pose's trend against scipy's plain loop over the same permutations is what ranks give."""
    rng = np.random.default_rng(6)
    x = made.gaussian(rng, 12, poses=1) + np.linspace(0.0, 0.06, 12)[:, None, None]
    grid = cycle_grid(made.series_of(x))
    assert grid is not None
    tau = np.arange(12) - 5.5
    z = grid.whitened[:, 0]

    def trend(order: np.ndarray) -> float:
        return float(np.sum((tau @ z[order]) ** 2))

    orders = [rng.permutation(12) for _ in range(4000)]
    expected = np.mean([trend(order) >= trend(np.arange(12)) for order in orders])
    assert permutation_test(grid).kinds["trend"] == pytest.approx(expected, abs=0.02)


def test_unequal_noise_is_scaled_away() -> None:
    """Cycles that the instrument measured five times worse do not look like two kinds of cycles."""
    rng = np.random.default_rng(5)
    sigma = np.where(np.arange(30) % 5 == 0, 0.1, 0.02)
    positions = rng.standard_normal((30, 3)) * sigma[:, None]
    one = PoseSeries(positions, np.arange(30), noise=np.einsum("n,ij->nij", sigma**2, np.eye(3)))
    grid = cycle_grid([one])
    assert grid is not None
    spread = np.sqrt((grid.deviations_mm[:, 0] ** 2).mean(axis=1))
    assert spread[::5].mean() / spread[np.arange(30) % 5 > 0].mean() == pytest.approx(1.0, abs=0.5)


def test_two_points_need_both_parts() -> None:
    x = np.concatenate([np.zeros((28, 3)), np.ones((2, 3))]) + 1e-3 * np.random.default_rng(0).normal(
        size=(30, 3)
    )
    assert find_two_points(x, 0, 1) is None  # two cycles are outliers
    x[10:18] += 1.0
    found = find_two_points(x, 0, 1)
    assert found is not None
    assert found.second.sum() == 10
    assert find_two_points(x[:9], 0, 1) is None
    assert max_within_share(30, 5) == pytest.approx(0.093)
    assert max_within_share(30, 50) < max_within_share(30, 5)
