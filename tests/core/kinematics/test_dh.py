"""Forward kinematics against known arms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from core.errors import InvalidArgument
from core.geometry.se3 import so3_exp, so3_log
from core.kinematics.dh import (
    Chain,
    JointParameters,
    forward,
    frames,
    nearly_parallel,
)
from tests.support.simulation.robots.arms import UR10


def test_planar_arm_by_hand() -> None:
    arm = Chain.from_rows([(300.0, 0.0, 50.0, 0.0), (200.0, 0.0, 0.0, 90.0)])
    T = forward(arm, np.radians([[30.0, -60.0], [0.0, 0.0]]))
    first, second = math.radians(30.0), math.radians(60.0)
    assert T[0, :3, 3] == pytest.approx(
        [
            300.0 * math.cos(first) + 200.0 * math.cos(second),
            300.0 * math.sin(first) + 200.0 * math.sin(second),
            50.0,
        ]
    )
    assert T[1, :3, 3] == pytest.approx([300.0, 200.0, 50.0])
    assert so3_log(T[0, :3, :3]) == pytest.approx([0.0, 0.0, second])


def test_ur10_stretched_out_reaches_the_sum_of_its_links() -> None:
    T = forward(UR10, np.zeros((1, 6)))
    assert T[0, :3, 3] == pytest.approx([-612.0 - 572.3, -163.941 - 92.2, 127.3 - 115.7])


def test_frames_begin_at_the_base_and_end_at_the_flange() -> None:
    q = np.random.default_rng(3).uniform(-2.0, 2.0, (7, 6))
    T = frames(UR10, q)
    assert T.shape == (7, 7, 4, 4)
    assert np.array_equal(T[:, 0], np.broadcast_to(np.eye(4), (7, 4, 4)))
    assert np.array_equal(T[:, -1], forward(UR10, q))
    assert T[:, 1, 2, 3] == pytest.approx(127.3)


def test_beta_turns_about_y_after_alpha() -> None:
    alpha, beta = 0.4, 0.3
    T = forward(Chain((JointParameters(10.0, alpha, 20.0, 0.0, beta),)), np.array([[0.5]]))
    expected = (
        so3_exp(np.array([0.0, 0.0, 0.5]))
        @ so3_exp(np.array([alpha, 0.0, 0.0]))
        @ so3_exp(np.array([0.0, beta, 0.0]))
    )
    assert T[0, :3, :3] == pytest.approx(expected)


def test_arrays_and_chains_are_the_same_thing() -> None:
    assert Chain.from_array(UR10.as_array()) == UR10


def test_a_wrong_number_of_joint_angles_is_refused() -> None:
    with pytest.raises(InvalidArgument, match=r"5 .* 6"):
        forward(UR10, np.zeros((2, 5)))


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_parameters_are_finite_numbers(value: float) -> None:
    with pytest.raises(InvalidArgument):
        JointParameters(value, 0.0, 0.0, 0.0)
    with pytest.raises(InvalidArgument):
        Chain(())


def test_parallel_is_a_matter_of_predicted_uncertainty() -> None:
    assert nearly_parallel(0.0, math.inf)
    assert nearly_parallel(math.pi, math.nan)
    assert nearly_parallel(0.01, 3.0)
    assert not nearly_parallel(0.01, 0.2)
    assert not nearly_parallel(math.pi / 2, 3.0)
