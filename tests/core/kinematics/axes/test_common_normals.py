"""DH parameters by common normals: the conventions, and what becomes of axes that leave something open."""

from __future__ import annotations

import math

import numpy as np
import pytest

from core.geometry.se3 import so3_exp, transform
from core.kinematics.circle_point_analysis.common_normals import (
    Axes,
    LinkForm,
    axes_of,
    choose_signs,
    describe,
    feet,
    reparametrise,
)
from core.kinematics.dh import Chain, forward
from core.simulation.arm import KR5_ARC, deviated
from tests.support.simulation.robots.arms import SEVEN_JOINTS, UR10

T_FRAME_BASE = transform(so3_exp(np.array([0.3, 0.2, -0.5])), np.array([100.0, 200.0, 300.0]))
PARALLEL = {"kr5": (1,), "ur10": (1, 2), "seven": ()}
CHAINS = {"kr5": KR5_ARC, "ur10": UR10, "seven": SEVEN_JOINTS}


def built(name: str) -> Chain:
    """A chain as built, with the nominal's values where these are conventions."""
    nominal = CHAINS[name].as_array()
    P = deviated(CHAINS[name], np.random.default_rng(1), 0.5, 1e-3).as_array()
    P[0, [2, 3]], P[-1] = nominal[0, [2, 3]], nominal[-1]
    for i in PARALLEL[name]:
        P[i, 2] = nominal[i, 2]
    return Chain.from_array(P)


def forms(name: str) -> list[bool]:
    return [i in PARALLEL[name] for i in range(len(CHAINS[name]) - 1)]


@pytest.mark.parametrize("name", CHAINS)
def test_axes_give_back_the_chain(name: str) -> None:
    chain, nominal = built(name), CHAINS[name]
    home = np.random.default_rng(2).uniform(-1.0, 1.0, len(chain))
    axes = axes_of(chain, home, T_FRAME_BASE)
    links = len(chain) - 1
    chosen = choose_signs(axes, home, forms(name), [False] * links, nominal, np.zeros(links))
    found = describe(axes, home, chosen, nominal)
    np.testing.assert_allclose(found.parameters, chain.as_array(), atol=1e-9)
    np.testing.assert_allclose(found.T_frame_base, T_FRAME_BASE, atol=1e-9)


@pytest.mark.parametrize("name", CHAINS)
def test_another_description_moves_the_same_way(name: str) -> None:
    """Without a nominal all conventions differ, and the two arms' ends differ by a constant tool."""
    chain = built(name)
    rng = np.random.default_rng(3)
    home = rng.uniform(-1.0, 1.0, len(chain))
    axes = axes_of(chain, home, T_FRAME_BASE)
    links = len(chain) - 1
    chosen = choose_signs(axes, home, forms(name), [False] * links, None, np.zeros(links))
    found = describe(axes, home, chosen, None)
    q = rng.uniform(-2.0, 2.0, (6, len(chain)))
    ends = T_FRAME_BASE @ forward(chain, q)
    again = found.T_frame_base @ forward(Chain.from_array(found.parameters), q)
    tools = np.linalg.inv(ends) @ again
    np.testing.assert_allclose(tools, np.broadcast_to(tools[0], tools.shape), atol=1e-9)
    assert np.all(found.parameters[:-1, 0] >= 0.0)


def test_restated_chains_compare() -> None:
    chain = deviated(KR5_ARC, np.random.default_rng(4), 0.5, 1e-3)
    again = reparametrise(chain, [False, True, False, False, False, False], KR5_ARC)
    P, nominal = again.as_array(), KR5_ARC.as_array()
    np.testing.assert_array_equal(P[0, [2, 3]], nominal[0, [2, 3]])
    np.testing.assert_array_equal(P[-1], nominal[-1])
    assert P[1, 2] == nominal[1, 2]
    assert np.abs(P - nominal)[:, [0, 2]].max() < 5.0
    q = np.random.default_rng(5).uniform(-1.0, 1.0, (5, 6))
    # Base and tool differ by constants: F_chain = B F_again E for all q.
    first, second = forward(chain, q), forward(again, q)
    turns = [np.linalg.inv(first[0]) @ first[k] for k in range(5)]
    others = [np.linalg.inv(second[0]) @ second[k] for k in range(5)]
    for a, b in zip(turns, others, strict=True):
        assert np.trace(a[:3, :3]) == pytest.approx(np.trace(b[:3, :3]), abs=1e-9)


def two(points: list[list[float]], directions: list[list[float]]) -> Axes:
    n = np.array(directions, dtype=np.float64)
    return Axes(np.array(points, dtype=np.float64), n / np.linalg.norm(n, axis=1, keepdims=True))


def test_intersecting_axes_have_a_normal_without_length() -> None:
    axes = two([[0, 0, 0], [0, 0, 250], [0, 0, 250]], [[0, 0, 1], [0, 1, 0], [0, 0.6, 0.8]])
    home = np.zeros(3)
    for sign in (1.0, -1.0):
        nominal = Chain.from_rows(
            [(0.0, -sign * 90.0, 0.0, 0.0), (0.0, sign * 30.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)]
        )
        chosen = choose_signs(axes, home, [False, False], [False, False], nominal, np.zeros(2))
        P = describe(axes, home, chosen, nominal).parameters
        np.testing.assert_allclose(P[:2, 0], 0.0, atol=1e-12)
        assert math.degrees(P[0, 1]) == pytest.approx(-sign * 90.0)
    # Without a nominal the twist is positive.
    chosen = choose_signs(axes, home, [False, False], [False, False], None, np.full(2, 0.1))
    assert np.all(describe(axes, home, chosen, None).parameters[:2, 1] > 0.0)


def test_parallel_axes_have_no_normal_and_keep_the_nominals_d() -> None:
    axes = two([[0, 0, 5], [300, 0, -70], [300, 0, 40]], [[0, 0, 1], [0, 0, 1], [0, 1, 0]])
    assert feet(axes, 0)[0] == math.inf
    nominal = Chain.from_rows([(300.0, 0.0, 7.0, 0.0), (0.0, -90.0, 20.0, 0.0), (0.0, 0.0, 0.0, 0.0)])
    found = describe(axes, np.zeros(3), [LinkForm(True), LinkForm(False, 1.0)], nominal)
    a, alpha, d, _, beta = found.parameters[0]
    assert (a, d) == (pytest.approx(300.0), 7.0)
    assert (alpha, beta) == (pytest.approx(0.0, abs=1e-12), pytest.approx(0.0, abs=1e-12))
    # Where the first two axes are parallel the base's height is open, and shows in the next d: that keeps the nominal.
    assert found.parameters[1, 2] == pytest.approx(20.0)
    assert not found.identifiable[1, 2]
    assert found.identifiable[0].tolist() == [True, True, False, False, True]


def test_one_line_keeps_the_nominals_angle() -> None:
    axes = two([[0, 0, 0], [0, 50, 0], [0, 90, 0], [80, 90, 0]], [[0, 0, 1], [0, 1, 0], [0, 1, 0], [0, 0, 1]])
    nominal = Chain.from_rows(
        [(0.0, -90.0, 0.0, 0.0), (0.0, 0.0, 30.0, 25.0), (80.0, 90.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)]
    )
    home = np.array([0.0, 0.2, -0.1, 0.3])
    chosen = choose_signs(axes, home, [False, True, False], [False, True, False], nominal, np.zeros(3))
    found = describe(axes, home, chosen, nominal)
    assert found.parameters[1, 3] == pytest.approx(math.radians(25.0))
    assert found.parameters[1, 2] == 30.0
    assert found.identifiable[1].tolist() == [True, True, False, False, True]
    # The next joint's offset takes up what is left, so that the arm stands as it does.
    T = found.T_frame_base @ forward(Chain.from_array(found.parameters[:3]), home[None, :3])[0]
    np.testing.assert_allclose(T[:3, 2], [0.0, 0.0, 1.0], atol=1e-12)
    assert np.linalg.norm(np.cross(T[:3, 3] - axes.points[3], axes.directions[3])) < 1e-9


def test_one_joint_is_all_convention() -> None:
    found = describe(two([[1, 2, 3]], [[0, 0, 1]]), np.zeros(1), [], None)
    assert not found.identifiable.any()
    np.testing.assert_allclose(found.parameters, 0.0)
