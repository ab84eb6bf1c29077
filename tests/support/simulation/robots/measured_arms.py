"""Arms that a camera measures in sweeps and free poses."""

from __future__ import annotations

import math

import numpy as np

from core.kinematics.pose_observations import PoseData
from core.simulation.arm import Arm, kr5_arc
from tests.support.simulation.robots.arms import angles
from tests.support.simulation.simulated_poses import Repeatability, measure_poses

ROBOT = Repeatability(0.03, math.radians(0.005))


def measured(seed: int, **how: object) -> tuple[Arm, PoseData]:
    rng = np.random.default_rng(seed)
    arm = kr5_arc(rng)
    return arm, measure_poses(arm, angles(rng), rng, **how)  # type: ignore[arg-type]


def poses_without_sweeps(poses: PoseData) -> PoseData:
    return poses.take(np.arange(67, 96))
