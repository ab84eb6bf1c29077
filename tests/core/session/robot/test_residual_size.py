"""Residuals beyond what robots scatter by are said to be so, and those of real arms are not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from core.geometry.se3 import so3_exp
from core.kinematics import Chain, ModelChoice, PoseData
from core.session import MeasuredPose, RobotIdentification, SessionData, identify_robot
from core.simulation.arm import KR5_ARC, KR5_ARC_HOME, sweep_angles
from core.targets.specification import TargetSpec
from tests.support.simulation.robots.arms import UR10
from tests.support.simulation.robots.fanuc_tracker import FANUC, fanuc_visits
from tests.support.simulation.robots.real_arms import angles_within_limits, measured, real_arm
from tests.support.simulation.robots.ur10_tracker import tracked

CODE = "residuals_large"


def identified(poses: PoseData, nominal: Chain, **settings: object) -> RobotIdentification:
    readings = tuple(
        MeasuredPose(
            f"mpo_{i}",
            poses.label(i),
            None,
            np.degrees(poses.joint_angles[i]).tolist(),
            poses.positions_mm[i],
            None if poses.rotations is None else poses.rotations[i],
            None if poses.covariance is None else poses.covariance[i],
            None,
        )
        for i in range(len(poses))
    )
    board = TargetSpec("chessboard", 9, 6, 12.0)
    data = SessionData((board,), ("tgt_1",), measured=readings, nominal=nominal)
    return identify_robot(data, **settings)  # type: ignore[arg-type]


def said_of(found: RobotIdentification) -> list[str]:
    return [f"{w.detail} {w.advice}" for w in found.warnings if w.code == CODE]


def of_real_arm(seed: int, count: int = 60) -> PoseData:
    rng = np.random.default_rng(seed)
    return measured(real_arm(rng), angles_within_limits(rng, count), rng)


def instrument_moved(poses: PoseData) -> PoseData:
    """By 2 mm and .1° after half of the poses."""
    R, half = so3_exp(np.array([0.0, 0.0, 1.7e-3])), np.arange(len(poses)) >= len(poses) // 2
    assert poses.rotations is not None
    positions, rotations = poses.positions_mm.copy(), poses.rotations.copy()
    positions[half] = positions[half] @ R.T + np.array([2.0, -1.0, 0.6])
    rotations[half] = R @ rotations[half]
    return replace(poses, positions_mm=positions, rotations=rotations)


def outliers(poses: PoseData) -> PoseData:
    """Two poses of five off by 8 mm in each direction: too many to stand out."""
    rng = np.random.default_rng(5)
    positions = poses.positions_mm.copy()
    some = rng.choice(len(poses), 2 * len(poses) // 5, replace=False)
    positions[some] += rng.normal(0.0, 8.0, (len(some), 3))
    return replace(poses, positions_mm=positions, rotations=None)


def angles_of_noise(poses: PoseData) -> PoseData:
    """Joint angles that were read while the robot moved, .05° off."""
    off = np.random.default_rng(6).normal(0.0, np.radians(0.05), poses.joint_angles.shape)
    return replace(poses, joint_angles=poses.joint_angles + off)


@pytest.mark.parametrize("wrong", [instrument_moved, outliers, angles_of_noise])
def test_poses_that_no_robot_explains_are_named(wrong: Callable[[PoseData], PoseData]) -> None:
    good = of_real_arm(1)
    assert not said_of(identified(good, KR5_ARC))
    found = identified(wrong(good), KR5_ARC)
    (said,) = said_of(found)
    assert f"{found.residual.position_rms_mm:.3g} mm" in said
    assert "off most: P" in said


@pytest.mark.parametrize("method", ["screw", "combined", "cpa"])
def test_methods_of_sweeps_say_so_too(method: str) -> None:
    rng = np.random.default_rng(2)
    poses = measured(real_arm(rng), sweep_angles(KR5_ARC_HOME), rng)
    assert not said_of(identified(poses, KR5_ARC, method=method))
    noisy = replace(poses, positions_mm=poses.positions_mm + rng.normal(0.0, 1.0, (len(poses), 3)))
    assert len(said_of(identified(noisy, KR5_ARC, method=method))) == 1


def test_noise_that_the_instrument_states_is_no_finding() -> None:
    good = of_real_arm(3)
    assert good.covariance is not None
    rng = np.random.default_rng(4)
    noisy = replace(
        good, positions_mm=good.positions_mm + rng.normal(0.0, 1.0, (len(good), 3)), rotations=None
    )
    assert said_of(identified(noisy, KR5_ARC))
    stated = good.covariance + np.diag([1.0] * 3 + [0.0] * 3)
    assert not said_of(identified(replace(noisy, covariance=stated), KR5_ARC))


@pytest.mark.parametrize("positions_alone", [False, True])
@pytest.mark.parametrize("model", [ModelChoice.DH, ModelChoice.AUTO])
def test_real_arms_are_within_it(data_folder: Path, model: ModelChoice, positions_alone: bool) -> None:
    """A UR10, whose gears no chain describes (.44 mm at 1.5 m), and a FANUC (.16 mm at 3.2 m)."""
    for poses, nominal in (
        (tracked(data_folder).take(np.arange(0, 1495, 20)), UR10),
        (fanuc_visits(data_folder), FANUC),
    ):
        poses = replace(poses, rotations=None) if positions_alone else poses
        assert not said_of(identified(poses, nominal, model=model))
