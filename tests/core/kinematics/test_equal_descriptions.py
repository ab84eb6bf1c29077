"""Equal descriptions move in the same way, and the one nearest to a reference is found among all of them."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from core.geometry import so3_exp, transform
from core.kinematics.arm_model import ArmState
from core.kinematics.dh import Chain, forward
from core.kinematics.equal_descriptions import (
    THETA_WEIGHT,
    described,
    nearest_description,
    positive_description,
    turn,
    with_reversals,
)


def drawn(rng: np.random.Generator, joints: int) -> np.ndarray:
    """Parameters of an arm of twists of every kind."""
    return np.column_stack(
        [
            rng.uniform(-500.0, 500.0, joints) * rng.integers(0, 2, joints),
            rng.choice(np.radians([0.0, 90.0, -90.0, 180.0, 30.0]), joints) + rng.normal(0.0, 1e-3, joints),
            rng.uniform(-300.0, 300.0, joints),
            rng.uniform(-math.pi, math.pi, joints),
            rng.normal(0.0, 1e-3, joints),
        ]
    )


def placed_at_random(rng: np.random.Generator, parameters: np.ndarray, targets: int = 2) -> ArmState:
    frames = [
        transform(so3_exp(rng.normal(0.0, 1.0, 3)), rng.normal(0.0, 300.0, 3)) for _ in range(targets + 1)
    ]
    return ArmState(parameters, frames[0], np.array(frames[1:]), np.zeros(0))


def poses(arm: ArmState, q: np.ndarray, target: int) -> np.ndarray:
    return np.asarray(arm.T_target_base[target] @ forward(arm.chain, q) @ arm.T_flange_camera)


@pytest.mark.parametrize("seed", range(12))
def test_every_reversal_leaves_every_pose(seed: int) -> None:
    rng = np.random.default_rng(seed)
    joints = 1 + seed % 7
    arm = placed_at_random(rng, drawn(rng, joints))
    q = rng.uniform(-3.0, 3.0, (5, joints))
    for reversals in itertools.islice(itertools.product([False, True], repeat=joints - 1), 16):
        other = described(arm, np.array(reversals, dtype=np.bool_))
        for target in range(2):
            np.testing.assert_allclose(poses(other, q, target), poses(arm, q, target), atol=1e-9)
        # What frames make a convention keeps its value.
        assert np.array_equal(other.parameters[-1], arm.parameters[-1])
        assert np.array_equal(other.parameters[0, 2:4], arm.parameters[0, 2:4])


@pytest.mark.parametrize("seed", range(12))
def test_the_nearest_of_all_descriptions_is_found(seed: int) -> None:
    rng = np.random.default_rng(seed)
    joints = 2 + seed % 6
    P, reference = drawn(rng, joints), drawn(rng, joints)
    reach = np.abs(reference[:, [0, 2]]).sum() + 1.0

    def cost(reversals: tuple[bool, ...]) -> float:
        off = with_reversals(P, np.array(reversals, dtype=np.bool_)) - reference
        angles = turn(off[:-1, [1, 4]])
        thetas = turn(off[1:-1, 3])
        return float(
            np.sum(angles**2) + np.sum((off[:-1, 0] / reach) ** 2) + THETA_WEIGHT * np.sum(thetas**2)
        )

    found = tuple(bool(x) for x in nearest_description(P, reference))
    least = min(map(cost, itertools.product([False, True], repeat=joints - 1)))
    assert cost(found) == pytest.approx(least, rel=1e-12)


@pytest.mark.parametrize("seed", range(6))
def test_a_chain_comes_back_to_its_own_description(seed: int) -> None:
    rng = np.random.default_rng(seed)
    P = drawn(rng, 6)
    P[:, 0] += 20.0  # every x has a direction
    reversals = rng.integers(0, 2, 5).astype(np.bool_)
    other = with_reversals(P, reversals)
    assert np.array_equal(nearest_description(other, P), reversals)
    back = with_reversals(other, reversals)
    assert turn(back - P) == pytest.approx(0.0, abs=1e-12)


def test_a_tied_joint_keeps_its_offset() -> None:
    nominal = Chain.from_rows(
        [(300.0, 0.0, 0.0, 0.0), (200.0, 0.0, 0.0, 0.0), (100.0, 0.0, 0.0, 0.0), (0, 0, 0, 0)]
    )
    P = nominal.as_array()
    P[0, 0], P[1, 3] = -300.0, math.pi
    assert nearest_description(P, nominal.as_array()).tolist() == [True, False, False]
    tied = nearest_description(P, nominal.as_array(), [False, True, False])
    assert tied[0] == tied[1]
    assert not nearest_description(P, nominal.as_array(), [True, False, False])[0]


def test_without_a_nominal_lengths_are_positive_and_twists_where_lengths_vanish() -> None:
    P = Chain.from_rows(
        [(-300.0, 0.0, 0.0, 0.0), (-0.1, -90.0, 0.0, 30.0), (5.0, -90.0, 0.0, 0.0), (0, 0, 0, 0)]
    )
    reversals = positive_description(P.as_array(), np.array([0.1, 0.1, 0.1]))
    found = with_reversals(P.as_array(), reversals)
    assert found[0, 0] == 300.0
    assert math.degrees(found[1, 1]) == pytest.approx(90.0)
    assert (found[2, 0], math.degrees(found[2, 1])) == (5.0, pytest.approx(-90.0))
