"""Parameters that are not identifiable, in words, for arms of several kinds."""

from __future__ import annotations

import numpy as np
import pytest

from core.kinematics.arm_model import ALPHA, BETA, THETA, ArmState, D, ParameterLayout
from core.kinematics.dh import Chain, forward
from core.kinematics.global_fit.fit import DEFAULT_SCATTER
from core.kinematics.global_fit.identifiability import fix_gauge, null_space
from core.kinematics.global_fit.null_space import held_by_axes, unidentifiable
from core.kinematics.global_fit.observability import conditioning
from core.kinematics.global_fit.placement import placed
from core.kinematics.global_fit.residuals import linearised, observations_of
from core.kinematics.pose_observations import PoseData
from core.simulation.arm import KR5_ARC
from tests.support.simulation.robots.arms import SEVEN_JOINTS, UR10

BASE = "theta1 offset and d1 cannot be separated from the base transform."
TOOL = "theta{0} offset, d{0}, a{0} and alpha{0} cannot be separated from the tool transform."


def at_random(
    chain: Chain, *, rotations: bool = True, spread: float = 1.2, targets: int = 1
) -> tuple[ArmState, PoseData]:
    rng = np.random.default_rng(1)
    q = rng.uniform(-spread, spread, (60, len(chain)))
    T = forward(chain, q)
    T[:, :3, 3] += T[:, :3, :3] @ np.array([50.0, -40.0, 90.0])
    poses = PoseData(
        q, T[:, :3, 3], T[:, :3, :3].copy() if rotations else None, target=np.arange(60) % targets
    )
    return placed(chain.as_array(), forward(chain, q), observations_of(poses)), poses


def gauge_of(chain: Chain, **how: object) -> tuple[int, tuple[str, ...]]:
    arm, poses = at_random(chain, **how)  # type: ignore[arg-type]
    gauge = fix_gauge(arm, observations_of(poses), DEFAULT_SCATTER)
    return int(gauge.free.sum()), tuple(group.sentence for group in gauge.unidentifiable)


def test_six_joints_with_two_parallel() -> None:
    free, sentences = gauge_of(KR5_ARC)
    assert free == 30
    assert sentences == (
        BASE,
        TOOL.format(6),
        "d2 and d3 cannot be determined separately: joints 2 and 3 are parallel.",
    )


@pytest.mark.parametrize(
    ("parallel", "coincident", "expected"),
    [
        (
            (1,),
            (),
            (BASE, TOOL.format(6), "d2 and d3 cannot be determined separately: joints 2 and 3 are parallel."),
        ),
        (
            (1, 2),
            (),
            (
                BASE,
                TOOL.format(6),
                "d2, d3 and d4 cannot be determined separately: joints 2, 3 and 4 are parallel.",
            ),
        ),
        (
            (0, 1),
            (),
            ("theta1 offset, d1, d2 and d3 cannot be separated from the base transform.", TOOL.format(6)),
        ),
        (
            (2,),
            (2,),
            (
                BASE,
                TOOL.format(6),
                "theta3 offset and theta4 offset cannot be determined separately: the axes of joints 3 and 4 coincide.",
                "d3 and d4 cannot be determined separately: joints 3 and 4 are parallel.",
            ),
        ),
    ],
)
def test_axes_leave_open_what_poses_do(
    parallel: tuple[int, ...], coincident: tuple[int, ...], expected: tuple[str, ...]
) -> None:
    identifiable = np.ones((6, 5), dtype=np.bool_)
    identifiable[0, [D, THETA]] = identifiable[5] = False
    identifiable[:, BETA] = [i in parallel for i in range(6)]
    identifiable[list(parallel), D] = identifiable[list(coincident), THETA] = False
    if 0 in parallel:
        identifiable[max(parallel) + 1, D] = False
    flags = np.array([[i in which for i in range(6)] for which in (parallel, coincident)])
    held = held_by_axes(identifiable, *flags)
    found = unidentifiable(held, ParameterLayout(6, 1, 0), flags[0], False)
    assert tuple(group.sentence for group in found) == expected


def test_three_parallel_joints_share_one_distance() -> None:
    free, sentences = gauge_of(UR10)
    assert free == 30
    assert "d2, d3 and d4 cannot be determined separately: joints 2, 3 and 4 are parallel." in sentences


def test_seven_joints() -> None:
    free, sentences = gauge_of(SEVEN_JOINTS)
    assert (free, sentences) == (34, (BASE, TOOL.format(7)))


def test_each_target_has_a_base_of_its_own() -> None:
    free, sentences = gauge_of(KR5_ARC, targets=2)
    assert free == 36
    assert sentences[0] == "theta1 offset and d1 cannot be separated from the base transforms."


def test_positions_say_nothing_of_the_tools_orientation() -> None:
    free, sentences = gauge_of(KR5_ARC, rotations=False)
    assert free == 27
    assert sentences[-1] == "The tool's orientation cannot be determined: the poses are positions alone."


def test_axes_that_coincide() -> None:
    rows = [
        (180.0, -90.0, 400.0, 0.0),
        (0.0, 0.0, 50.0, 0.0),
        (120.0, 90.0, 0.0, 0.0),
        (0.0, -90.0, 300.0, 0.0),
    ]
    _, sentences = gauge_of(Chain.from_rows(rows))
    assert any("the axes of joints 2 and 3 coincide" in sentence for sentence in sentences)


def test_a_planar_arm_leaves_more_open() -> None:
    rows = [(300.0, 0.0, 50.0, 0.0), (250.0, 0.0, 0.0, 0.0), (200.0, 0.0, 0.0, 0.0)]
    arm, poses = at_random(Chain.from_rows(rows))
    gauge = fix_gauge(arm, observations_of(poses), DEFAULT_SCATTER)
    assert gauge.parallel.tolist() == [True, True, False]
    assert any(
        "d1" in s and "d2" in s and "d3" in s for s in (group.sentence for group in gauge.unidentifiable)
    )
    J = linearised(arm, observations_of(poses))[1]
    scaled = J[gauge.free] * arm.layout.units(arm.reach_mm)[gauge.free][:, None, None]
    values = np.linalg.svd(scaled.reshape(len(scaled), -1), compute_uv=False)
    assert values[-1] > 1e-6 * values[0]


def test_small_motions_leave_directions_open_and_say_which() -> None:
    free, sentences = gauge_of(KR5_ARC, spread=2e-4)
    assert free < 30
    assert any("can hardly be" in sentence for sentence in sentences)


def test_held_columns_leave_full_rank_and_all_freedom() -> None:
    arm, poses = at_random(KR5_ARC)
    seen = observations_of(poses)
    gauge = fix_gauge(arm, seen, DEFAULT_SCATTER)
    layout = arm.layout
    J = linearised(arm, seen)[1]
    used = np.array([c for c in range(layout.size) if gauge.free[c] or c % 5 != BETA or c >= 30])
    units = layout.units(arm.reach_mm)
    rank_of_all = len(used) - null_space((J * units[:, None, None])[used].reshape(len(used), -1)).shape[1]
    free = np.flatnonzero(gauge.free)
    assert null_space((J * units[:, None, None])[free].reshape(len(free), -1)).shape[1] == 0
    assert rank_of_all == len(free)
    for joint, parameter in ((0, THETA), (0, D), (1, D), (5, THETA), (5, D), (5, ALPHA)):
        assert not gauge.free[layout.column(joint, parameter)]


def test_conditioning_knows_good_poses_from_poor_ones() -> None:
    figures = []
    for spread in (1.2, 0.1):
        arm, poses = at_random(KR5_ARC, spread=spread)
        seen = observations_of(poses)
        gauge = fix_gauge(arm, seen, DEFAULT_SCATTER)
        everything = np.ones(60, dtype=np.bool_)
        figures.append(conditioning(arm, linearised(arm, seen)[1], gauge.free, everything))
    good, poor = figures
    assert good.condition_number < 100.0 < poor.condition_number
    assert good.observability_o1 > 2.0 * poor.observability_o1
    values = good.singular_values
    assert good.observability_o1 == pytest.approx(np.exp(np.log(values).mean()) / np.sqrt(60))
