"""The nominal robot is compared at its best base and tool, also where a closed form of them is degenerate."""

from __future__ import annotations

import math

import numpy as np
import pytest

from core.geometry import so3_exp, transform
from core.kinematics.dh import Chain, forward
from core.kinematics.identification import identify
from core.kinematics.pose_observations import PoseData
from core.simulation.arm import deviated

PLANAR = Chain.from_rows([(300.0, 0.0, 100.0, 0.0), (250.0, 0.0, 0.0, 0.0), (150.0, 0.0, 0.0, 0.0)])
T_INSTRUMENT_BASE = transform(so3_exp(np.array([0.3, 1.2, -2.0])), np.array([2000.0, -900.0, 400.0]))
T_FLANGE_PROBE = transform(so3_exp(np.array([-1.0, 0.4, 2.1])), np.array([60.0, -30.0, 110.0]))


def planar_poses(seed: int, count: int = 60) -> PoseData:
    """Poses of an arm whose axes are parallel: all rotations share an axis."""
    rng = np.random.default_rng(seed)
    true = deviated(PLANAR, rng, 0.3, math.radians(0.03))
    q = rng.uniform(-1.0, 1.0, (count, len(PLANAR)))
    T = T_INSTRUMENT_BASE @ forward(true, q) @ T_FLANGE_PROBE
    positions = T[:, :3, 3] + rng.normal(0.0, 0.03, (count, 3))
    rotations = np.array([so3_exp(rng.normal(0.0, 1e-4, 3)) @ R for R in T[:, :3, :3]])
    return PoseData(q, positions, rotations)


@pytest.mark.parametrize("seed", range(5))
def test_the_nominal_is_compared_at_its_best_base_and_tool(seed: int) -> None:
    """The closed form alone leaves 285 mm at seed 2, and 300 mm at seed 1."""
    found = identify(planar_poses(seed), PLANAR).validation
    assert found is not None
    assert found.nominal is not None
    # The arm is .3 mm and .03° off its nominal, at a reach of .7 m: some tenths of a millimetre.
    assert found.identified.position_rms_mm < 0.1
    assert found.identified.position_rms_mm < found.nominal.position_rms_mm < 2.0


TILTING_TABLE = [(0.0, 90.0, 400.0, 0.0), (0.0, 0.0, 250.0, 0.0)]
WRIST = [(0.0, -90.0, 150.0, 0.0), (0.0, 90.0, 0.0, 0.0), (0.0, 0.0, 120.0, 0.0)]


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("rows", [TILTING_TABLE, WRIST])
def test_positions_of_an_arm_whose_axes_meet_in_one_point_are_not_taken_for_another_unit(
    rows: list[tuple[float, float, float, float]], seed: int
) -> None:
    """The flange turns about one point: the linear equations of the base's rotation are then solved by zero."""
    nominal, rng = Chain.from_rows(rows), np.random.default_rng(seed)
    true = deviated(nominal, rng, 0.3, math.radians(0.03))
    q = rng.uniform(-1.2, 1.2, (40, len(nominal)))
    T = T_INSTRUMENT_BASE @ forward(true, q) @ T_FLANGE_PROBE
    found = identify(PoseData(q, T[:, :3, 3] + rng.normal(0.0, 0.03, (40, 3))), nominal).validation
    assert found is not None
    assert found.nominal is not None
    assert found.identified.position_rms_mm < 0.1
    assert found.nominal.position_rms_mm < 2.0
