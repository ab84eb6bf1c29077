"""Decisions on a data sheet: uncertainty decides nothing, and neither error is more frequent than stated."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from core.metrology import (
    UNSTEADY,
    Decision,
    FrameTie,
    PoseCycles,
    Reading,
    assess_repeatability,
    decide,
    eigenvalues,
    long_run_rp,
    repeatability_reading,
)
from core.metrology.acceptance import TOO_FEW

LIMIT = 0.1


def reading(value: float, low: float, high: float, cycles: int = 30) -> Reading:
    return Reading(cycles, value, (low, high), high)


def test_all_poses_must_lie_within_the_limit() -> None:
    found = decide(LIMIT, [reading(0.05, 0.04, 0.07), reading(0.06, 0.05, 0.09)])
    assert found.decision is Decision.PASS
    assert found.reading == 1  # whose interval reaches farthest
    assert found.cycles_needed is None


def test_one_pose_beyond_it_is_enough_and_uncertainty_of_others_does_not_help() -> None:
    found = decide(LIMIT, [reading(0.09, 0.07, 0.12), reading(0.2, 0.15, 0.27)])
    assert (found.decision, found.reading) == (Decision.FAIL, 1)
    unsteady = Reading(30, 0.2, (0.15, 0.27), 0.27, flaw=UNSTEADY)
    assert decide(LIMIT, [unsteady, reading(0.05, 0.04, 0.07)]).decision is Decision.INCONCLUSIVE


def test_each_of_many_poses_fails_at_a_part_of_the_risk() -> None:
    barely = reading(0.13, 0.101, 0.16)
    assert decide(LIMIT, [barely]).decision is Decision.FAIL
    together = decide(LIMIT, [barely] * 5)
    assert together.decision is Decision.INCONCLUSIVE
    assert together.reason.endswith("not the wider one by which each of 5 poses is judged")
    assert together.cycles_needed is not None
    # The interval shrinks with the root of the cycles: with so many all five are beyond it together.
    root = math.sqrt(29 / (together.cycles_needed - 1))
    shrunk = reading(0.13, 0.13 * (0.101 / 0.13) ** root, 0.13 * (0.16 / 0.13) ** root)
    assert decide(LIMIT, [shrunk] * 5).decision is Decision.FAIL


@pytest.mark.parametrize(("value", "low", "high"), [(0.09, 0.08, 0.105), (0.11, 0.098, 0.13)])
def test_an_interval_that_spans_the_limit_says_how_many_cycles_would_decide(
    value: float, low: float, high: float
) -> None:
    found = decide(LIMIT, [reading(value, low, high)])
    assert found.decision is Decision.INCONCLUSIVE
    assert found.cycles_needed is not None
    # The interval shrinks with the root of the cycles: there its end meets the limit, on the logarithmic scale.
    end = high if value < LIMIT else low
    shrunk = value * (end / value) ** math.sqrt(29 / (found.cycles_needed - 1))
    assert shrunk == pytest.approx(LIMIT, rel=0.01)


def test_a_reading_at_the_limit_is_never_decided() -> None:
    assert decide(LIMIT, [reading(0.1, 0.08, 0.13)]).cycles_needed is None


def test_an_instrument_too_coarse_may_pass_a_robot_but_not_fail_it() -> None:
    coarse = Reading(30, None, None, 0.08)
    assert decide(LIMIT, [coarse]).decision is Decision.PASS
    assert decide(0.07, [coarse]).decision is Decision.INCONCLUSIVE
    assert decide(0.07, [coarse]).cycles_needed is None
    assert decide(0.07, [Reading(30, None, None, None)]).decision is Decision.INCONCLUSIVE


def test_fewer_than_ten_cycles_decide_nothing() -> None:
    assert decide(LIMIT, [reading(0.02, 0.01, 0.04, cycles=9)]).reading is None
    assert decide(LIMIT, [reading(0.02, 0.01, 0.04, cycles=9)]).decision is Decision.INCONCLUSIVE
    mixed = decide(LIMIT, [reading(0.02, 0.01, 0.04, cycles=9), reading(0.02, 0.01, 0.04)])
    assert mixed.decision is Decision.INCONCLUSIVE


@pytest.mark.slow
def test_errors_of_either_kind_are_as_rare_as_stated() -> None:
    """500 robots of five poses each: at the limit itself at most 2.5 % are decided wrongly to either side.

    Bounds are four standard deviations above 2.5 %; at .6 and 1.6 times the limit most are decided, and none wrongly.
    """
    rng = np.random.default_rng(15)
    robots, noise = 500, 0.004**2 * np.eye(6)
    counts = {}
    for size in (0.6, 1.0, 1.6):
        decided: list[Decision] = []
        for _ in range(robots // (1 if size == 1.0 else 4)):
            poses = []
            for _ in range(5):
                axes = rng.normal(size=(3, 3)) * [1.0, 0.6, 0.3]
                covariance = axes @ axes.T
                scale = size * LIMIT / float(long_run_rp(eigenvalues(covariance[None]))[0])
                scatter = rng.multivariate_normal(np.zeros(3), scale**2 * covariance, 30)
                scatter += rng.normal(0.0, 0.004, (30, 3))
                poses.append(PoseCycles(scatter, None, np.repeat(noise[None], 30, axis=0)))
            decided.append(
                decide(LIMIT, [repeatability_reading(one) for one in assess_repeatability(poses)]).decision
            )
        counts[size] = {one: decided.count(one) / len(decided) for one in Decision}
    bound = 0.025 + 4.0 * math.sqrt(0.025 * 0.975 / robots)
    assert counts[1.0][Decision.PASS] <= bound
    assert counts[1.0][Decision.FAIL] <= bound
    assert counts[0.6][Decision.PASS] >= 0.7
    assert counts[0.6][Decision.FAIL] == 0.0
    assert counts[1.6][Decision.FAIL] >= 0.7
    assert counts[1.6][Decision.PASS] == 0.0


def test_cycles_narrow_only_their_own_share_of_an_interval() -> None:
    whole = decide(LIMIT, [reading(0.09, 0.08, 0.105)]).cycles_needed
    half = decide(LIMIT, [replace(reading(0.09, 0.08, 0.105), cycles_share=0.7)]).cycles_needed
    assert whole is not None
    assert half is not None
    assert half > whole
    # The logarithm's width would have to shrink to less than what cycles leave of it.
    assert decide(LIMIT, [replace(reading(0.09, 0.08, 0.105), cycles_share=0.3)]).cycles_needed is None


def test_a_tie_that_keeps_an_interval_wide_takes_poses() -> None:
    tie = FrameTie(0.3**2, 5, 9.0, 0.6, 0.6)
    open_ = replace(reading(0.6, 0.1, 1.9), cycles_share=1e-4, tie=tie, frames=" in other frames")
    found = decide(1.5, [open_])
    assert (found.decision, found.interval) == (Decision.INCONCLUSIVE, (0.1, 1.9))
    assert found.cycles_needed is None
    assert found.reason.startswith("the interval in other frames spans the limit")
    assert found.poses_needed is not None
    assert 5 < found.poses_needed < 15
    # The worst of more poses comes too near to a limit of few standard deviations.
    assert decide(0.9, [open_]).poses_needed is None
    # One that is far beyond it fails with more.
    beyond = replace(open_, value=2.5, interval=(1.0, 4.0), tie=replace(tie, worst_mm=2.5))
    assert decide(1.5, [beyond]).poses_needed is not None


def test_poses_that_are_open_are_named_and_no_other_pose_decides() -> None:
    few, unsteady = reading(0.05, 0.04, 0.07, cycles=1), replace(reading(0.05, 0.04, 0.07), flaw=UNSTEADY)
    found = decide(LIMIT, [reading(0.05, 0.04, 0.07), few, unsteady, few], ["A", "B", "C", "D"])
    assert (found.decision, found.reading, found.interval) == (Decision.INCONCLUSIVE, None, None)
    assert found.reason == f"3 of 4 poses are open: B, D, {TOO_FEW}; C, {UNSTEADY}"
    assert decide(LIMIT, [few]).reason == f"1 of 1 poses is open: 1, {TOO_FEW}"


def test_what_decides_is_stated() -> None:
    assert decide(LIMIT, [reading(0.05, 0.04, 0.07)]).interval == (0.04, 0.07)
    assert decide(LIMIT, [reading(0.2, 0.15, 0.27)]).interval == (0.15, 0.27)
    assert decide(LIMIT, [Reading(30, None, None, 0.08)]).interval == (0.0, 0.08)
    assert decide(LIMIT, [Reading(3, 0.05, (0.04, 0.07), 0.07)]).interval is None
