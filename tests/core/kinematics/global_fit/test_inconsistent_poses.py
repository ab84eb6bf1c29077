"""Poses that identification refuses or warns of: too few, at rest, of other angles, units or scales."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from core.errors import (
    InvalidArgument,
    JointAnglesInconsistent,
    JointAnglesUnitMismatch,
    JointNotExcited,
    TooFewPoses,
)
from core.geometry.se3 import so3_exp
from core.kinematics.dh import Chain
from core.kinematics.identification import identify
from core.simulation.arm import KR5_ARC, kr5_arc
from tests.support.simulation.robots.arms import SEVEN_JOINTS, angles
from tests.support.simulation.robots.measured_arms import ROBOT, measured, poses_without_sweeps
from tests.support.simulation.simulated_poses import Repeatability, measure_poses


def test_a_chain_of_another_number_of_joints_is_refused() -> None:
    _, poses = measured(13)
    with pytest.raises(JointAnglesInconsistent, match=r"6 .* 7"):
        identify(poses, SEVEN_JOINTS)


def test_a_matrix_that_is_no_covariance_is_refused_and_a_singular_one_is_not() -> None:
    _, poses = measured(23, robot=ROBOT)
    assert poses.covariance is not None
    wrong = poses.covariance.copy()
    wrong[5, 0, 1] = wrong[5, 1, 0] = 2.0 * np.sqrt(wrong[5, 0, 0] * wrong[5, 1, 1])
    with pytest.raises(InvalidArgument, match="P006"):
        identify(replace(poses, covariance=wrong), KR5_ARC)
    singular = poses.covariance.copy()
    singular[:, :3, 3:] = singular[:, 3:, :3] = 0.0
    singular[:, :3, :3] = 1e-4  # wholly correlated
    assert identify(replace(poses, covariance=singular), KR5_ARC, folds=0).used.all()


def test_a_joint_that_rests_is_named() -> None:
    _, poses = measured(14)
    q = poses.joint_angles.copy()
    q[:, 2] = 0.3
    with pytest.raises(JointNotExcited, match="joint 3"):
        identify(replace(poses, joint_angles=q), KR5_ARC)


def test_too_few_poses_are_refused() -> None:
    _, poses = measured(15)
    with pytest.raises(TooFewPoses, match=r"5 .* 30 .* 6"):
        identify(poses.take(np.array([0, 20, 40, 70, 90])), KR5_ARC)


def test_joint_angles_of_other_poses_are_found_out() -> None:
    _, poses = measured(16, robot=ROBOT)
    with pytest.raises(JointAnglesInconsistent):
        identify(
            poses_without_sweeps(replace(poses, joint_angles=np.roll(poses.joint_angles, 1, axis=0))), KR5_ARC
        )


@pytest.mark.parametrize("factor", [math.pi / 180.0, 180.0 / math.pi], ids=["radians", "degrees"])
def test_angles_in_another_unit_are_recognised(factor: float) -> None:
    _, poses = measured(22, robot=ROBOT)
    with pytest.raises(JointAnglesUnitMismatch):
        identify(replace(poses, joint_angles=factor * poses.joint_angles), KR5_ARC)


def test_an_arm_described_by_other_angles_is_distinguished_from_the_nominal() -> None:
    _, poses = measured(18, robot=ROBOT)
    q = poses.joint_angles.copy()
    q[:, 3] += math.radians(20.0)
    found = identify(replace(poses, joint_angles=q), KR5_ARC)
    (warning,) = [w for w in found.warnings if w.code == "deviation_from_nominal_large"]
    assert warning.detail.startswith("theta4 offset: over 20 mm or 5°")


@pytest.mark.parametrize(
    ("scale", "named"), [(1.0, False), (1.001, False), (1.01, True), (0.97, True), (1.03, True), (2.0, True)]
)
def test_lengths_that_are_all_off_by_one_factor_are_the_scale_of_the_print(scale: float, named: bool) -> None:
    _, poses = measured(19, robot=ROBOT)
    found = identify(replace(poses, positions_mm=scale * poses.positions_mm), KR5_ARC)
    warnings = [w for w in found.warnings if w.code == "print_scale_mismatch"]
    assert len(warnings) == named
    other = identify(replace(poses, positions_mm=scale * poses.positions_mm, instrument=True), KR5_ARC)
    codes = {w.code for w in other.warnings}
    assert "print_scale_mismatch" not in codes
    assert ("instrument_scale_mismatch" in codes) == named
    if named:
        assert ("longer" if scale > 1.0 else "shorter") in warnings[0].detail
        stated = re.search(r" ([\d.]+) % ", warnings[0].detail)
        assert stated is not None
        assert float(stated[1]) == pytest.approx(100.0 * abs(scale - 1.0), abs=0.2)


def test_a_chain_that_is_no_better_than_the_nominal_says_so() -> None:
    rng = np.random.default_rng(17)
    arm = replace(kr5_arc(rng), chain=Chain(KR5_ARC.joints))
    q = angles(rng, free=0)[::5]
    found = identify(measure_poses(arm, q, rng, robot=Repeatability(0.5, 0.001)), KR5_ARC, folds=4)
    assert "no_better_than_nominal" in {w.code for w in found.warnings}


def test_orientations_that_do_not_follow_are_refused() -> None:
    _, poses = measured(5)
    assert poses.rotations is not None
    turns = np.random.default_rng(1).normal(0.0, math.radians(25.0), (len(poses), 3))
    turned = replace(
        poses, rotations=np.array([so3_exp(w) @ R for w, R in zip(turns, poses.rotations, strict=True)])
    )
    with pytest.raises(JointAnglesInconsistent) as refused:
        identify(turned, KR5_ARC)
    assert "convention of the orientations" in refused.value.advice
