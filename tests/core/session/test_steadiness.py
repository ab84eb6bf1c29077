"""Steadiness of a session: verdicts, warnings and the visits that count in them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from core.metrology import Verdict
from core.session import assess_repeatability
from tests.support.simulation import session_cycles as made


def _codes(found: Any) -> list[str]:
    return [warning.code for warning in found.warnings]


def _verdicts(found: Any) -> list[Verdict]:
    return [row.figures.verdict for row in found.poses]


def test_a_steady_session_is_the_robots() -> None:
    found = assess_repeatability(made.measured_session(made.gaussian(np.random.default_rng(1), 30)))
    assert found.steadiness.found.steady is True
    assert set(_verdicts(found)) == {Verdict.ROBOT}
    assert not {"not_steady", "outliers", "two_stopping_points", "steadiness_not_tested"} & set(_codes(found))
    assert found.steadiness.effective_cycles == 30.0


def test_a_moving_mount_is_no_robot() -> None:
    found = assess_repeatability(made.measured_session(made.common_step(np.random.default_rng(1), 30)))
    assert set(_verdicts(found)) == {Verdict.NOT_STEADY}
    warning = next(one for one in found.warnings if one.code == "not_steady")
    assert "All poses move together" in warning.detail
    assert "at cycle 21" in warning.detail
    assert "P1, P2, P3, P4, P5" in warning.detail
    assert warning.advice is not None


def test_one_slipping_pose_is_named_and_the_others_stay() -> None:
    x = made.one_drift(np.random.default_rng(2), 30, length_mm=0.4)
    found = assess_repeatability(made.measured_session(x))
    assert found.steadiness.moved == ("P2",)
    assert _verdicts(found)[1] is Verdict.NOT_STEADY
    assert _verdicts(found)[0] is Verdict.ROBOT
    warning = next(one for one in found.warnings if one.code == "not_steady")
    assert "Pose P2 moved 0.4" in warning.detail or "Pose P2 moved 0.3" in warning.detail


def test_wandering_cycles_have_fewer_effective_ones_and_wider_intervals() -> None:
    wandering = assess_repeatability(made.measured_session(made.correlated(np.random.default_rng(3), 30)))
    steady = assess_repeatability(made.measured_session(made.gaussian(np.random.default_rng(3), 30)))
    assert 3.0 < wandering.steadiness.effective_cycles < 15.0

    def width(found: Any) -> float:
        bounds = [row.figures.interval.position_mm for row in found.poses]
        return float(np.mean([np.log(high / low) for low, high in bounds]))

    assert width(wandering) > 1.4 * width(steady)


def test_two_stopping_points_are_named() -> None:
    found = assess_repeatability(made.measured_session(made.two_points(np.random.default_rng(4), 30)))
    assert _verdicts(found)[2] is Verdict.NOT_STEADY
    warning = next(one for one in found.warnings if one.code == "two_stopping_points")
    assert "Pose P3" in warning.detail


def test_slips_count_and_are_named() -> None:
    """Two slips of .4 mm in 30 cycles of a robot with RP .04 mm: RP is over all cycles."""
    x = 0.4 * made.gaussian(np.random.default_rng(5), 30)
    x[7, 0, 0] += 0.4
    x[19, 0, 0] += 0.4
    found = assess_repeatability(made.measured_session(x))
    slipped = found.poses[0].figures
    assert slipped is not None
    assert slipped.repeatability.position_mm is not None
    assert slipped.repeatability.position_mm > 0.25
    assert slipped.without_outliers is not None
    assert slipped.without_outliers.position_mm is not None
    assert slipped.without_outliers.position_mm < 0.06
    warning = next(one for one in found.warnings if one.code == "outliers")
    assert warning.advice is not None
    assert "readings of these cycles" in warning.advice
    assert "image" not in warning.advice
    assert "P1 cycle 8, P1 cycle 20" in warning.detail


@pytest.mark.parametrize("numbered", [True, False])
def test_what_is_not_tested_is_said(numbered: bool) -> None:
    found = assess_repeatability(
        made.measured_session(
            made.common_drift(np.random.default_rng(6), 4 if numbered else 30), numbered=numbered
        )
    )
    assert found.steadiness.found.steady is None
    assert "steadiness_not_tested" in _codes(found)


def test_poses_of_few_cycles_keep_their_verdict() -> None:
    found = assess_repeatability(
        made.measured_session(made.common_drift(np.random.default_rng(6), 9, length_mm=2.0))
    )
    assert set(_verdicts(found)) == {Verdict.TOO_FEW_CYCLES}
    assert "not_steady" in _codes(found)


def test_the_order_of_the_list_does_not_matter_but_that_of_the_cycles_does() -> None:
    x = made.common_step(np.random.default_rng(1), 30)
    data = made.measured_session(x)
    first = assess_repeatability(data)
    order = np.random.default_rng(0).permutation(30)
    shuffled = replace(
        data,
        measured=tuple(replace(one, cycle=int(order[(one.cycle or 1) - 1]) + 1) for one in data.measured),
    )
    by_cycle = replace(
        shuffled, measured=tuple(sorted(shuffled.measured, key=lambda one: (one.pose_id, one.cycle)))
    )
    again = assess_repeatability(by_cycle)
    assert first.steadiness.found.steady is False
    assert again.steadiness.found.steady is True
    figures = [row.figures.repeatability.position_mm for row in first.poses if row.figures]
    assert figures == pytest.approx(
        [row.figures.repeatability.position_mm for row in again.poses if row.figures]
    )
