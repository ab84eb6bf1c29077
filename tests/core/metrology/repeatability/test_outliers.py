"""Cycles that are outliers: named, counted, and second figures without them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from core.geometry.se3 import so3_exp
from core.metrology import PoseCycles
from core.metrology.iso9283 import position_repeatability
from core.metrology.repeatability.outliers import find_outliers
from tests.support.metrology.assessments import assess


def move(cycles: PoseCycles, index: int, by_mm: float = 0.0, turn_rad: float = 0.0) -> PoseCycles:
    positions = cycles.positions_mm.copy()
    positions[index, 1] += by_mm
    assert cycles.rotations is not None
    rotations = cycles.rotations.copy()
    rotations[index] = so3_exp(np.array([0.0, 0.0, turn_rad])) @ rotations[index]
    return PoseCycles(positions, rotations, cycles.covariances)


@pytest.mark.parametrize(
    ("by_mm", "turn_rad", "code"),
    [
        (5.0, 0.0, "position_outlier"),
        (0.0, 0.02, "orientation_outlier"),
        (0.0, math.pi, "orientation_outlier"),
    ],
)
def test_a_gross_outlier_counts_and_is_named_and_the_table_says_what_it_would_be_without(
    make_cycles: Any, by_mm: float, turn_rad: float, code: str
) -> None:
    clean = make_cycles()
    spoilt = move(clean, 7, by_mm, turn_rad)
    result = assess(spoilt)
    (outlier,) = result.outliers
    assert (outlier.index, outlier.code, result.n) == (7, code, 30)
    assert (outlier.distance_mm > 4.5) == (by_mm > 0.0)
    rest = assess(clean.take(np.delete(np.arange(30), 7)))
    assert result.without_outliers == rest.repeatability
    assert result.repeatability != rest.repeatability
    if by_mm:
        expected = position_repeatability(spoilt.positions_mm)
        assert result.repeatability.position_mm == pytest.approx(expected, rel=1e-9)


def test_a_moderate_outlier_is_the_robots_own(make_cycles: Any) -> None:
    result = assess(move(make_cycles(), 3, by_mm=0.15))  # five of the robot's standard deviations
    assert result.outliers == ()
    assert result.without_outliers is None


def test_a_slip_of_twelve_deviations_is_named_and_slips_do_not_hide_one_another() -> None:
    alone = together = 0
    for seed in range(100):
        rng = np.random.default_rng(seed)
        cycles = rng.standard_normal((30, 3))
        direction = rng.standard_normal(3)
        slip = 12.0 * direction / np.linalg.norm(direction)
        one, two = cycles.copy(), cycles.copy()
        one[4] += slip
        two[[4, 20]] += slip
        alone += [found.index for found in assess(PoseCycles(one)).outliers] == [4]
        together += [found.index for found in assess(PoseCycles(two)).outliers] == [4, 20]
    assert alone >= 88  # 95 % and 90 % in 1,000: less three standard deviations of 100
    assert together >= 81


@pytest.mark.parametrize("scatter", [(1.0, 1.0, 1.0), (1.0, 0.6, 0.3), (1.0, 0.01, 0.0)])
@pytest.mark.parametrize("n", [10, 30])
def test_steady_cycles_are_named_once_in_a_thousand_poses_at_most(
    n: int, scatter: tuple[float, float, float]
) -> None:
    rng = np.random.default_rng(n)
    poses = [rng.standard_normal((n, 3)) * scatter for _ in range(1000)]
    named = sum(bool(find_outliers(pose)[0]) for pose in poses)
    assert named <= 4  # of a mean of one, 5 and more have a chance of .004


def test_nothing_is_named_on_a_display_that_shows_most_cycles_on_one_spot() -> None:
    cycles = np.zeros((30, 3))
    cycles[:4, 0] = 0.01
    assert find_outliers(cycles) == ([], [])


def test_a_second_cluster_stays_and_is_remarked(make_cycles: Any) -> None:
    cycles = make_cycles()
    for index in range(0, 30, 6):
        cycles = move(cycles, index, by_mm=5.0)
    result = assess(cycles)
    assert result.outliers == ()
    assert [warning.code for warning in result.warnings] == ["position_clusters"]


def test_nothing_is_excluded_below_ten_cycles(make_cycles: Any) -> None:
    assert assess(move(make_cycles(n=9), 3, by_mm=5.0)).outliers == ()
