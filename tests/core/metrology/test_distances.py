"""Distances and approaches: worked examples, coverage of what is stated, and floors that are the expected readings."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest

from core.errors import InvalidArgument
from core.geometry.roll_pitch_yaw import rpy_to_rotation
from core.geometry.se3 import so3_exp
from core.metrology import (
    CycleProcess,
    PoseCycles,
    assess_approaches,
    assess_distance,
    estimate_process,
    mean_of_cycles,
)
from core.metrology.cycle_process import MeanOfCycles
from core.metrology.cycle_process.lag_correlation import CORRELATIONS
from tests.support.simulation.session_cycles import SIGMA_MM, correlated

FAR = np.array([300.0, 400.0, 0.0])


def test_a_distance_worked_by_hand() -> None:
    # Along (3, 4, 0)/5 the second pose is 500, 500.1 and 499.9 away.
    e = FAR / 500.0
    first = np.zeros((3, 3))
    second = np.array([500.0 * e, 500.1 * e, 499.9 * e])
    found = assess_distance(PoseCycles(first), PoseCycles(second), np.zeros(3), np.array([0.0, 0.0, 499.5]))
    assert found.performance.mean_distance_mm == pytest.approx(500.0)
    assert found.performance.accuracy_mm == pytest.approx(0.5)
    assert found.performance.repeatability_mm == pytest.approx(0.3)  # S = .1
    assert found.standard_uncertainty_mm == pytest.approx(0.1 / math.sqrt(3.0))
    assert found.noise_floor_mm is None
    assert found.interval_mm is not None
    # χ² of two degrees of freedom: √(2 / 7.3778) and √(2 / .050636).
    assert found.interval_mm == pytest.approx((0.3 * 0.52066, 0.3 * 6.2847), rel=1e-3)


def cycles(
    rng: np.random.Generator, at: np.ndarray, robot: np.ndarray, noise: np.ndarray, n: int
) -> PoseCycles:
    positions = at + rng.standard_normal((n, 3)) * np.sqrt(robot + noise)
    covariance = np.zeros((n, 6, 6))
    covariance[:, range(3), range(3)] = noise
    return PoseCycles(positions, None, covariance)


def test_intervals_and_floors_of_distance_repeatability_hold() -> None:
    # 1,500 ways know a coverage to .56 %. Only what scatters along the way counts: 3/5 and 4/5 of x and y.
    rng = np.random.default_rng(1)
    robot, noise = np.array([0.02, 0.01, 0.5]) ** 2, np.array([0.01, 0.02, 0.3]) ** 2
    n, trials = 10, 1500
    along = (FAR / 500.0) ** 2
    truth = 3.0 * math.sqrt(2.0 * float(along @ (robot + noise)))
    covered, still, floors = 0, [], []
    for _ in range(trials):
        found = assess_distance(cycles(rng, np.zeros(3), robot, noise, n), cycles(rng, FAR, robot, noise, n))
        assert found.interval_mm is not None
        covered += found.interval_mm[0] <= truth <= found.interval_mm[1]
        quiet = assess_distance(
            cycles(rng, np.zeros(3), 0.0 * robot, noise, n), cycles(rng, FAR, 0.0 * robot, noise, n)
        )
        still.append(quiet.performance.repeatability_mm)
        floors.append(quiet.noise_floor_mm)
    assert covered / trials == pytest.approx(0.95, abs=0.02)
    readings = np.array(still, dtype=float)
    assert np.mean(floors) == pytest.approx(
        readings.mean(), abs=4.0 * readings.std() / math.sqrt(trials) + 0.001 * readings.mean()
    )


def test_errors_common_to_all_readings_are_in_the_mean_and_not_in_the_scatter() -> None:
    rng = np.random.default_rng(2)
    first = cycles(rng, np.zeros(3), np.full(3, 1e-4), np.zeros(3), 30)
    second = cycles(rng, FAR, np.full(3, 1e-4), np.zeros(3), 30)
    alone = assess_distance(first, second)
    # A print whose scale is uncertain by 1e-4 moves every point by that share of its place: .05 mm in 500.
    scale = [np.zeros((6, 1)), np.concatenate([FAR, np.zeros(3)])[:, None] * 1e-4]
    common = assess_distance(first, second, None, None, *scale)
    assert common.interval_mm == alone.interval_mm
    assert alone.standard_uncertainty_mm is not None
    assert common.standard_uncertainty_mm == pytest.approx(
        math.hypot(0.05, alone.standard_uncertainty_mm), rel=1e-3
    )
    # What moves both equally leaves the distance alone.
    both = assess_distance(first, second, None, None, scale[1], scale[1])
    assert both.standard_uncertainty_mm == alone.standard_uncertainty_mm


def test_one_cycle_has_a_distance_and_no_scatter() -> None:
    found = assess_distance(PoseCycles(np.zeros((1, 3))), PoseCycles(FAR[None]))
    assert found.performance.mean_distance_mm == 500.0
    assert found.interval_mm is found.noise_floor_mm is found.standard_uncertainty_mm is None


def test_poses_in_one_place_have_no_distance() -> None:
    rng = np.random.default_rng(3)
    one, other = rng.normal(0.0, 0.01, (2, 10, 3))
    with pytest.raises(InvalidArgument, match="no distance"):
        assess_distance(PoseCycles(one), PoseCycles(other))
    with pytest.raises(InvalidArgument, match="both its ends"):
        assess_distance(PoseCycles(one), PoseCycles(FAR + other[:9]))


def approached(rng: np.random.Generator, offsets: np.ndarray, n: int, sigma_mm: float) -> list[PoseCycles]:
    base = rpy_to_rotation(np.array([0.2, 0.4, -1.0]))
    directions = []
    for offset in offsets:
        turns = rng.normal(0.0, 1e-3 * sigma_mm, (n, 3))
        rotations = np.array([so3_exp(w) @ base for w in turns])
        directions.append(PoseCycles(offset + rng.normal(0.0, sigma_mm, (n, 3)), rotations))
    return directions


def test_variation_over_approaches_and_what_scatter_alone_makes_of_it() -> None:
    rng = np.random.default_rng(4)
    offsets = np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.4], [0.0, 0.1, 0.0]])
    found = assess_approaches(approached(rng, offsets, 30, 0.01))
    assert found.figures.position_mm == pytest.approx(math.sqrt(0.26), abs=0.015)
    assert found.figures.x_mm == pytest.approx(0.3, abs=0.012)
    assert found.noise_floor.position_mm is not None
    assert found.noise_floor.position_mm < 0.01
    # Where the direction has no effect, the reading is the floor, on the average.
    results = [assess_approaches(approached(rng, 0.0 * offsets, 10, 0.01)) for _ in range(300)]
    for name in ("position_mm", "z_mm", "roll", "yaw"):
        read = np.array([getattr(r.figures, name) for r in results])
        floor = np.mean([getattr(r.noise_floor, name) for r in results])
        # 300 readings, and the floor's own thousand draws.
        assert floor == pytest.approx(read.mean(), abs=4.0 * read.std() / math.sqrt(300) + 0.04 * read.mean())


def test_single_visits_from_two_sides_have_no_floor() -> None:
    found = assess_approaches([PoseCycles(np.zeros((1, 3))), PoseCycles(np.array([[0.0, 3.0, 4.0]]))])
    assert found.figures.position_mm == 5.0
    assert found.figures.roll is found.noise_floor.position_mm is None
    with pytest.raises(InvalidArgument, match="two directions"):
        assess_approaches([PoseCycles(np.zeros((1, 3)))])


@pytest.mark.slow
def test_cycles_that_correlate_widen_what_is_stated_of_a_distance() -> None:
    """300 ways, φ = .8, three in each session of six poses; intervals for independent cycles fail."""
    rng = np.random.default_rng(7)
    sessions, n, phi = 100, 30, 0.8
    covered = np.zeros((2, 2))
    for _ in range(sessions):
        x = correlated(rng, n, poses=6, phi=phi)
        process = estimate_process(
            [x[:, i] - x[:, i].mean(axis=0) for i in range(6)], [np.arange(n)] * 6, True
        )
        for way, (k, known) in product(range(0, 6, 2), enumerate((None, process))):
            ends = PoseCycles(x[:, way]), PoseCycles(FAR + x[:, way + 1])
            found = assess_distance(*ends, np.zeros(3), FAR, process=known)
            assert found.interval_mm is not None
            assert found.accuracy_interval_mm is not None
            truth = 3.0 * math.sqrt(2.0) * SIGMA_MM
            covered[0, k] += found.interval_mm[0] <= truth <= found.interval_mm[1]
            covered[1, k] += found.accuracy_interval_mm[0] <= 0.0 <= found.accuracy_interval_mm[1]
            assert found.standard_uncertainty_mm == found.cycles_uncertainty_mm
    independent, followed = (covered / (3 * sessions)).T
    assert np.all(independent < 0.75)
    # 300 ways, which share nothing but their session's process, know a coverage of .95 to .0126.
    assert followed == pytest.approx([0.95, 0.95], abs=3.0 * 0.0126)


def test_a_mean_of_independent_cycles_is_as_uncertain_as_ever() -> None:
    assert mean_of_cycles(None, 30) == MeanOfCycles(1.0, 29.0)
    none = estimate_process([np.random.default_rng(1).normal(size=(30, 3))], [None], False)
    assert mean_of_cycles(none, 30) == MeanOfCycles(1.0, 29.0)
    # Long runs of one φ: √((1 + φ) / (1 - φ)).
    weights = np.zeros(len(CORRELATIONS))
    weights[25] = 1.0
    phi = float(CORRELATIONS[25])
    found = mean_of_cycles(CycleProcess(np.zeros(7), weights), 500)
    assert found.inflation == pytest.approx(math.sqrt((1 + phi) / (1 - phi)), rel=0.03)
