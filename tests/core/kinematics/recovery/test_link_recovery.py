"""How targets lie to one another, with a robot that comes back a little off: stated covariances are true."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from core.geometry.se3 import invert, so3_exp, so3_log
from core.kinematics.circle_point_analysis.covariance import ArcTree
from core.kinematics.circle_point_analysis.target_registration import TargetLink
from core.kinematics.joint_axes.axis_fit import fit_axes
from core.kinematics.pose_observations import PoseData
from core.kinematics.sweeps import JOINT_TOLERANCE, find_sweeps
from core.simulation.arm import KR5_ARC_HOME, Arm, free_angles, kr5_arc, sweep_angles
from tests.support.simulation.simulated_poses import Repeatability, camera_noise, measure_poses

pytestmark = pytest.mark.slow

ROBOT = Repeatability(0.1, math.radians(0.005))
TRIALS = 12
# Means of TRIALS squares of six numbers each: three and a half of their standard deviations.
BOUND = 3.5 * math.sqrt(2.0 / (6.0 * TRIALS))
SWEEPS = sweep_angles(KR5_ARC_HOME, steps=9)
AWAY = KR5_ARC_HOME + np.radians([0.0, 0.0, -20.0, 5.0, 30.0, 0.0])


def true_link(arm: Arm) -> np.ndarray:
    return arm.T_target_base[0] @ invert(arm.T_target_base[1])


def linked(poses: PoseData, method: str = "combined") -> TargetLink:
    fits = fit_axes(poses, find_sweeps(poses), method)
    return ArcTree.grown(fits, KR5_ARC_HOME, poses, 2.0 * JOINT_TOLERANCE).links[1]


def square(arm: Arm, link: TargetLink) -> float:
    """The squared error in units of the stated covariance, by number."""
    T = true_link(arm)
    turn = so3_log(T[:3, :3] @ link.T_first_target[:3, :3].T)
    error = np.concatenate([T[:3, 3] - link.T_first_target[:3, 3], turn])
    return float(error @ np.linalg.solve(link.covariance, error)) / 6.0


def visited(trial: int, visits: int) -> tuple[Arm, PoseData]:
    """Sweeps before the first target; free poses before either, the robot coming to each twice."""
    rng = np.random.default_rng([trial, 80])
    arm = kr5_arc(rng)
    free = free_angles(rng, KR5_ARC_HOME, visits)
    target = np.repeat([0, 1], [len(SWEEPS) + visits, visits])
    return arm, measure_poses(arm, np.concatenate([SWEEPS, free, free]), rng, robot=ROBOT, target=target)


@pytest.mark.parametrize(("method", "visits"), [("combined", 1), ("combined", 5), ("cpa", 3)])
def test_separate_visits_have_the_robot_s_scatter(method: str, visits: int) -> None:
    squares = []
    for trial in range(TRIALS):
        arm, poses = visited(trial, visits)
        link = linked(poses, method)
        assert link.pairs == visits
        squares.append(square(arm, link))
    assert np.mean(squares) == pytest.approx(1.0, abs=BOUND)


def test_images_that_show_both_have_the_image_s_noise_alone() -> None:
    squares, ratios = [], []
    for trial in range(TRIALS):
        arm, apart = visited(trial, 5)
        rng = np.random.default_rng([trial, 81])
        assert apart.rotations is not None
        # The second target as the same five images show it: from where the camera was, with noise of its own.
        n = len(apart)
        one, two = np.arange(n - 10, n - 5), np.arange(n - 5, n)
        true = measure_poses(
            arm, apart.joint_angles[:-5], np.random.default_rng([trial, 82]), robot=ROBOT, estimator="exact"
        )
        assert true.rotations is not None
        R = np.concatenate([true.rotations, true_link(arm)[:3, :3].T @ true.rotations[one]])
        p = np.concatenate(
            [true.positions_mm, (true.positions_mm[one] - true_link(arm)[:3, 3]) @ true_link(arm)[:3, :3]]
        )
        covariance, _ = camera_noise(R, estimator="given")
        e = np.einsum("nij,nj->ni", np.linalg.cholesky(covariance), rng.normal(size=(n, 6)))
        image = np.arange(n)
        image[two] = one
        poses = replace(
            apart,
            positions_mm=p + e[:, :3],
            rotations=np.array([so3_exp(w) for w in e[:, 3:]]) @ R,
            covariance=covariance,
            common=None,
            image=image,
        )
        link, by_visits = linked(poses), linked(replace(poses, image=None))
        assert link.pairs == by_visits.pairs == 5
        squares.append(square(arm, link))
        ratios.append(np.sqrt(np.diag(link.covariance) / np.diag(by_visits.covariance)))
    assert np.mean(squares) == pytest.approx(1.0, abs=BOUND)
    assert np.max(ratios) < 0.8


def test_visits_and_arcs_are_weighed() -> None:
    """Joints 1 and 2 are swept before either target, and two poses were visited before both."""
    squares = []
    for trial in range(TRIALS):
        rng = np.random.default_rng([trial, 83])
        arm = kr5_arc(rng)
        free = free_angles(rng, KR5_ARC_HOME, 2)
        away = sweep_angles(AWAY, joints=[0, 1], steps=9)
        q = np.concatenate([SWEEPS, free, away, free])
        target = np.repeat([0, 1], [len(SWEEPS) + 2, len(away) + 2])
        poses = measure_poses(arm, q, rng, robot=ROBOT, target=target)
        both = linked(poses)
        squares.append(square(arm, both))
        if trial >= 4:
            continue  # nothing of the following is left to chance
        by_arcs = linked(poses.take(np.arange(len(q) - 2)))
        by_visits = linked(poses.take(np.flatnonzero((target == 0) | (np.arange(len(q)) >= len(q) - 2))))
        assert (both.pairs, by_visits.pairs, by_arcs.by_arcs is None) == (by_arcs.pairs + 2, 2, False)
        # What both determine is determined at least as well as by either, but for the arcs' part in common.
        for one in (by_arcs, by_visits):
            assert np.all(np.diag(both.covariance) < 1.02 * np.diag(one.covariance))
    assert np.mean(squares) == pytest.approx(1.0, abs=BOUND)
