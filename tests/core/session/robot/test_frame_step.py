"""A frame that moves while poses are measured is named; robots with gears and frames at rest are not."""

from __future__ import annotations

import numpy as np
import pytest

from core.geometry import so3_exp
from core.kinematics import ModelChoice, PoseData, identify
from core.session.robot.frame_step import frame_step_warnings
from core.simulation.arm import KR5_ARC, KR5_ARC_HOME, free_angles, kr5_arc
from tests.support.simulation.robots.real_arms import angles_within_limits, measured, real_arm

NOISE_MM = 0.03


def stepped(seed: int, *, moved_mm: float, count: int = 60, at: int = 25) -> PoseData:
    """Positions by a tracker whose station moved before pose number `at`."""
    rng = np.random.default_rng(seed)
    arm = kr5_arc(rng)
    q = free_angles(rng, KR5_ARC_HOME, count)
    p = arm.camera_poses(q)[:, :3, 3] + rng.normal(0.0, NOISE_MM, (count, 3))
    direction = rng.normal(0.0, 1.0, 3)
    turn = so3_exp(rng.normal(0.0, 1e-4 * moved_mm, 3))
    p[at:] = p[at:] @ turn.T + moved_mm * direction / np.linalg.norm(direction)
    return PoseData(q, p, labels=tuple(f"P{i + 1}" for i in range(count)))


@pytest.mark.parametrize("model", [ModelChoice.DH, ModelChoice.AUTO])
def test_a_station_that_moved_is_named_with_the_pose_from_which_on(model: ModelChoice) -> None:
    poses = stepped(1, moved_mm=1.0)
    found = identify(poses, KR5_ARC, folds=0, model=model)
    order = np.flatnonzero(found.used)
    (warning,) = frame_step_warnings(found.residuals[:3], poses.positions_mm, order, poses.labels)
    assert warning.code == "frame_moved"
    named = int(warning.detail.split("pose P")[1].split(" ")[0])
    assert abs(named - 26) <= 2
    shuffled = np.random.default_rng(3).permutation(order)
    assert not frame_step_warnings(found.residuals[:3], poses.positions_mm, shuffled, poses.labels)


@pytest.mark.parametrize("model", [ModelChoice.DH, ModelChoice.AUTO])
def test_frames_at_rest_are_not_named(model: ModelChoice) -> None:
    for seed in range(4):
        still = stepped(10 + seed, moved_mm=0.0)
        rng = np.random.default_rng(seed)
        geared = measured(real_arm(rng), angles_within_limits(rng, 60), rng)
        for poses in (still, geared):
            found = identify(poses, KR5_ARC, folds=0, model=model)
            # In the worst order that programs have: from one end of the workspace to the other.
            for order in (np.flatnonzero(found.used), np.argsort(poses.joint_angles[:, 0])):
                assert not frame_step_warnings(
                    found.residuals[:3], poses.positions_mm, order[found.used[order]], poses.labels
                )


def test_few_poses_and_positions_on_a_line_say_nothing() -> None:
    rng = np.random.default_rng(5)
    line = np.outer(np.arange(60.0), [1.0, 2.0, 0.5])
    step = np.where(np.arange(60) < 30, 0.0, 1.0) * np.ones((3, 1))
    labels = [f"P{i}" for i in range(60)]
    assert not frame_step_warnings(step, line, np.arange(60), labels)
    anywhere = rng.uniform(-500.0, 500.0, (60, 3))
    assert frame_step_warnings(step, anywhere, np.arange(60), labels)
    assert not frame_step_warnings(step, anywhere, np.arange(20, 43), labels)
