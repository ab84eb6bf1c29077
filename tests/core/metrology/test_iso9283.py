"""The standard's formulas against tables worked by hand; every number below can be checked with pencil and paper."""

from __future__ import annotations

import math

import numpy as np
import pytest

from core.errors import InvalidArgument
from core.geometry.roll_pitch_yaw import rpy_to_rotation
from core.metrology import (
    direction_variation,
    distance_performance,
    drift,
    drift_rate,
    pose_accuracy,
    shift_degrees_of_freedom,
)
from core.metrology.iso9283 import position_repeatability, three_sigma

CENTRE = np.array([1000.0, -500.0, 250.0])
DEVIATIONS = 0.01 * np.array(
    [[1, 2, 2], [-1, -2, -2], [2, 1, -2], [-2, -1, 2], [4, 0, 3], [-4, 0, -3]], dtype=float
)
"""Six cycles about their mean, in mm: lengths 3, 3, 3, 3, 5, 5 hundredths.

    l̄   = 22/6 = 3.66667
    S_l² = (4 (2/3)² + 2 (4/3)²) / 5 = (48/9) / 5 = 1.06667,   S_l = 1.032796
    RP_l = 3.66667 + 3.098387 = 6.765053 hundredths of a millimetre
    x: 1 1 4 4 16 16, sum 42, S² = 8.4, 3 S = 8.694826
    y: 4 4 1 1  0  0, sum 10, S² = 2.0, 3 S = 4.242641
    z: 4 4 4 4  9  9, sum 34, S² = 6.8, 3 S = 7.823043
"""


def test_position_repeatability_of_six_cycles() -> None:
    assert position_repeatability(CENTRE + DEVIATIONS) == pytest.approx(0.06765053, abs=1e-8)


def test_three_sigma_of_six_cycles() -> None:
    expected = [0.08694826, 0.04242641, 0.07823043]
    np.testing.assert_allclose(three_sigma(CENTRE + DEVIATIONS), expected, atol=1e-8)


def test_position_repeatability_of_a_cross() -> None:
    # l = 3, 3, 1, 1; l̄ = 2; S_l² = 4/3; RP_l = 2 + 3 · 1.154701
    cross = np.array([[3.0, 0.0, 0.0], [-3.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
    assert position_repeatability(cross) == pytest.approx(5.4641016, abs=1e-7)


def test_two_cycles_are_equally_far_from_their_mean() -> None:
    assert position_repeatability(np.array([[0.0, 0.0, 0.0], [0.6, 0.0, 0.8]])) == pytest.approx(
        0.5, abs=1e-15
    )


def test_one_cycle_has_no_scatter() -> None:
    with pytest.raises(InvalidArgument, match="two cycles"):
        position_repeatability(np.zeros((1, 3)))


def test_pose_accuracy_is_the_length_and_the_signed_components() -> None:
    # attained less commanded: +.03, +.04, 0 mm; length .05
    commanded = np.array([999.97, -500.04, 250.0])
    R_mean = rpy_to_rotation(np.array([0.1, 0.2, 3.1]))
    R_commanded = rpy_to_rotation(np.array([0.101, 0.198, -3.1]))
    accuracy = pose_accuracy(CENTRE, commanded, R_mean, R_commanded)
    assert accuracy.position_mm == pytest.approx(0.05, abs=1e-12)
    assert (accuracy.x_mm, accuracy.y_mm, accuracy.z_mm) == pytest.approx((0.03, 0.04, 0.0), abs=1e-12)
    # yaw crosses ±π: 3.1 - (-3.1) is 6.2 - 2π
    angles = (accuracy.roll, accuracy.pitch, accuracy.yaw)
    assert angles == pytest.approx((-0.001, 0.002, 6.2 - 2.0 * math.pi), abs=1e-12)


def test_pose_accuracy_without_orientation() -> None:
    accuracy = pose_accuracy(CENTRE, CENTRE)
    assert accuracy.position_mm == 0.0
    assert accuracy.roll is accuracy.pitch is accuracy.yaw is None


def test_direction_variation_is_the_largest_of_three() -> None:
    # sides 5, 12 and 13; along the axes 3, 4 and 12
    means = np.array([[0.0, 0.0, 0.0], [3.0, 4.0, 0.0], [0.0, 0.0, 12.0]])
    rotations = np.array([rpy_to_rotation(np.array([0.0, 0.0, a])) for a in (0.010, -0.005, 0.002)])
    variation = direction_variation(means, rotations)
    assert variation.position_mm == pytest.approx(13.0)
    assert (variation.x_mm, variation.y_mm, variation.z_mm) == pytest.approx((3.0, 4.0, 12.0))
    assert variation.yaw == pytest.approx(0.015, abs=1e-12)


def test_direction_variation_needs_two_directions() -> None:
    with pytest.raises(InvalidArgument, match="two directions"):
        direction_variation(np.zeros((1, 3)))


def test_distance_performance_of_four_cycles() -> None:
    # D = 100.1, 99.9, 100.3, 100.1: D̄ = 100.1, AD = .1; S² = (.04 + .04) / 3, RD = 3 · .1632993
    first = np.zeros((4, 3))
    second = np.column_stack([[100.1, 99.9, 100.3, 100.1], np.zeros(4), np.zeros(4)])
    result = distance_performance(first, second, np.zeros(3), np.array([60.0, 80.0, 0.0]))
    assert result.mean_distance_mm == pytest.approx(100.1)
    assert result.accuracy_mm == pytest.approx(0.1)
    assert result.repeatability_mm == pytest.approx(0.4898979, abs=1e-7)


def test_distance_of_one_cycle_has_no_repeatability() -> None:
    result = distance_performance(np.zeros((1, 3)), np.array([[0.0, 3.0, 4.0]]))
    assert result.mean_distance_mm == 5.0
    assert result.accuracy_mm is result.repeatability_mm is None


def test_distance_needs_both_ends() -> None:
    with pytest.raises(InvalidArgument, match="both its ends"):
        distance_performance(np.zeros((2, 3)), np.zeros((3, 3)))


def test_drift_between_first_and_last_block() -> None:
    # The cross of above, then twice as wide and moved by (.3, .4, 0): RP 5.4641 → 10.9282
    cross = np.array([[3.0, 0.0, 0.0], [-3.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
    positions = np.vstack([cross, 2.0 * cross + [0.3, 0.4, 0.0]])
    yaw = np.repeat([0.001, 0.004], 4)
    rotations = np.array([rpy_to_rotation(np.array([0.0, 0.0, a])) for a in yaw])
    result = drift(positions, rotations, block=4)
    assert result.repeatability_drift_mm == pytest.approx(5.4641016, abs=1e-7)
    np.testing.assert_allclose(result.shift_mm, [0.3, 0.4, 0.0], atol=1e-12)
    assert result.shift_rad is not None
    np.testing.assert_allclose(result.shift_rad, [0.0, 0.0, 0.003], atol=1e-12)
    assert [(b.first_cycle, b.last_cycle) for b in result.blocks] == [(1, 4), (5, 8)]


def test_a_shift_has_the_degrees_of_freedom_of_both_blocks() -> None:
    block = DEVIATIONS[:6]
    equal = drift(np.vstack([block, block + np.array([0.1, 0.0, 0.0])]), block=6)
    along, length = shift_degrees_of_freedom(equal)
    np.testing.assert_allclose(along, 10.0)  # equal variances of six cycles each: 2 (6 - 1)
    assert length == pytest.approx(10.0)
    unequal = drift(np.vstack([block, 3.0 * block]), block=6)
    np.testing.assert_allclose(shift_degrees_of_freedom(unequal)[0], 100.0 / (1.0 / 5.0 + 81.0 / 5.0))
    still = drift(np.tile(CENTRE, (12, 1)), block=6)
    assert shift_degrees_of_freedom(still)[1] == 10.0


def test_the_rate_of_a_drift_is_found_within_its_uncertainty() -> None:
    rng = np.random.default_rng(8)
    hours = np.sort(rng.uniform(0.0, 2.0, 30))
    rate = np.array([0.05, 0.0, -0.02])
    z = []
    for _ in range(300):
        found = drift_rate(hours, np.outer(hours, rate) + rng.normal(0.0, 0.01, (30, 3)))
        assert found is not None
        z.append((found.mm_per_h - rate) / found.standard_error_mm_per_h)
    # t of 28 degrees of freedom has a deviation of 1.04; of 900 values it is known to 2.4 %.
    assert np.std(z) == pytest.approx(1.04, abs=0.08)
    assert drift_rate(np.zeros(5), np.zeros((5, 3))) is None
    assert drift_rate(np.arange(2.0), np.zeros((2, 3))) is None


def test_drift_gives_left_over_cycles_to_the_last_block() -> None:
    result = drift(np.random.default_rng(0).normal(size=(11, 3)), block=4)
    assert [(b.first_cycle, b.last_cycle) for b in result.blocks] == [(1, 4), (5, 11)]
    assert result.shift_rad is None


@pytest.mark.parametrize(("cycles", "block"), [(7, 4), (10, 1), (10, 0)])
def test_drift_needs_two_blocks(cycles: int, block: int) -> None:
    with pytest.raises(InvalidArgument, match="two blocks"):
        drift(np.zeros((cycles, 3)), block=block)
