"""Arms drawn as built, measured with noise of known size, identified: errors as small as promised, intervals true.

The share of parameters within their 95 % interval scatters from arm to arm with a standard deviation of .06, since an
arm's errors are correlated; over n arms that is .06/√n, and bounds stand 3.5 of these from .95.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from core.kinematics.identification import Identification, identify
from core.simulation.arm import KR5_ARC, Arm, kr5_arc
from tests.support.simulation.robots.arm_grid_points import image_poses, session
from tests.support.simulation.robots.arms import angles, identifiable_truth, stated
from tests.support.simulation.simulated_poses import Repeatability, measure_poses

ROBOT = Repeatability(0.1 / 3.616, math.radians(0.005))  # RP_l .1 mm by ISO 9283
SPREAD_OF_ARMS = 0.06

pytestmark = pytest.mark.slow


def compared(arm: Arm, q: np.ndarray, found: Identification) -> tuple[np.ndarray, np.ndarray]:
    return found.chain.as_array() - identifiable_truth(arm, q), stated(found)


def assert_covered(pairs: list[tuple[np.ndarray, np.ndarray]]) -> None:
    ratio = np.array([error / uncertainty for error, uncertainty in pairs])
    share = float(np.mean(np.abs(ratio[np.isfinite(ratio)]) < 1.96))
    bound = 3.5 * SPREAD_OF_ARMS / math.sqrt(len(pairs))
    assert 0.95 - bound < share < min(0.95 + bound, 0.995), share


def rms(pairs: list[tuple[np.ndarray, np.ndarray]], columns: list[int]) -> float:
    errors = np.array(
        [np.where(np.isfinite(uncertainty), error, np.nan)[:, columns] for error, uncertainty in pairs]
    )
    return math.sqrt(float(np.nanmean(errors**2)))


@pytest.mark.parametrize(
    ("free", "robot", "limit_mm", "limit_deg"),
    [(0, ROBOT, 0.045, 0.0055), (30, ROBOT, 0.025, 0.003), (0, Repeatability(), 0.01, 0.001)],
    ids=["sweeps", "sweeps and free poses", "perfect robot"],
)
def test_pooled_poses(free: int, robot: Repeatability, limit_mm: float, limit_deg: float) -> None:
    pairs = []
    for trial in range(8):
        rng = np.random.default_rng([trial, free, 4])
        arm = kr5_arc(rng)
        q = angles(rng, free=free)
        pairs.append(compared(arm, q, identify(measure_poses(arm, q, rng, robot=robot), KR5_ARC, folds=0)))
    assert_covered(pairs)
    # Eight arms of 30 parameters: the rms itself is good to some 12 %.
    assert rms(pairs, [0, 2]) < 1.2 * limit_mm
    assert math.degrees(rms(pairs, [1, 3, 4])) < 1.2 * limit_deg


def test_grid_points_of_a_robot_that_scatters() -> None:
    pairs = []
    for trial in range(4):
        arm, q, views, _ = session(
            100 + trial, count=40, position_mm=ROBOT.position_mm, rotation_rad=ROBOT.rotation_rad
        )
        found = identify(image_poses(views, q), KR5_ARC, folds=0)
        pairs.append(compared(arm, q, found))
    assert_covered(pairs)
