"""Couplings of joints that poses show are proposed, and none where the robot has none."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from core.kinematics import PoseData, propose_coupling
from core.simulation import KR5_ARC, KR5_ARC_HOME, free_angles, kr5_arc
from tests.support.simulation.simulated_poses import Repeatability, measure_poses


def poses_of(seed: int, count: int = 40) -> PoseData:
    """Free poses of an arm as built, which differs from its nominal."""
    rng = np.random.default_rng(seed)
    q = free_angles(rng, KR5_ARC_HOME, count)
    return measure_poses(
        kr5_arc(rng), q, rng, estimator="given", robot=Repeatability(0.05, math.radians(0.004))
    )


def stated(poses: PoseData, *terms: tuple[int, int, float]) -> PoseData:
    """Return the poses with the angles that a robot with these couplings states, joints from 1."""
    C = np.eye(6)
    for k, j, share in terms:
        C[k - 1, j - 1] = share
    return replace(poses, joint_angles=poses.joint_angles @ np.linalg.inv(C).T)


@pytest.mark.parametrize(
    "terms", [((3, 2, 1.0),), ((3, 2, -1.0),), ((5, 6, 0.5),), ((3, 2, 1.0), (6, 5, -0.25))]
)
def test_the_coupling_that_the_poses_show_is_proposed(terms: tuple[tuple[int, int, float], ...]) -> None:
    found = propose_coupling(stated(poses_of(3), *terms), KR5_ARC)
    assert found is not None
    assert sorted((k, j) for k, j, _ in found.terms) == sorted((k, j) for k, j, _ in terms)
    # The arm is off its nominal by a millimetre and a tenth of a degree, of angles of half a radian.
    for k, j, share in terms:
        assert found.matrix[k - 1, j - 1] == pytest.approx(share, abs=0.01)
    assert found.with_it_mm < 5.0 < found.without_mm


def test_a_robot_without_coupling_or_with_other_faults_gets_no_proposal() -> None:
    poses = poses_of(4)
    assert propose_coupling(poses, KR5_ARC) is None
    shuffled = replace(poses, joint_angles=np.random.default_rng(1).permutation(poses.joint_angles))
    assert propose_coupling(shuffled, KR5_ARC) is None
    assert propose_coupling(poses_of(5, 8), KR5_ARC) is None  # too few


@pytest.mark.parametrize("joint", [3, 4, 6])
def test_a_joint_that_counts_the_other_way_is_not_coupled(joint: int) -> None:
    poses = poses_of(6)
    q = poses.joint_angles.copy()
    q[:, joint - 1] *= -1.0
    assert propose_coupling(replace(poses, joint_angles=q), KR5_ARC) is None
