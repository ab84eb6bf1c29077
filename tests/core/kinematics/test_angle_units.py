"""Radians for degrees, joints that slide: recognised by sweeps, and by free poses where the nominal robot is known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from core.errors import (
    FrameMirrored,
    JointAnglesInconsistent,
    JointAnglesUnitMismatch,
    KinematicsError,
    LengthsUnitMismatch,
    PrismaticJoint,
)
from core.geometry import transform
from core.kinematics.dh import Chain, forward
from core.kinematics.identification import identify
from core.kinematics.identification.sliding_joints import check_sliding
from core.kinematics.joint_angle_checks import check_angles
from core.kinematics.nominal_checks import check_against_nominal
from core.kinematics.pose_observations import PoseData
from core.kinematics.sweeps import find_sweeps
from core.simulation.arm import KR5_ARC, KR5_ARC_HOME, free_angles, kr5_arc
from tests.support.simulation.robots.arms import free_poses
from tests.support.simulation.simulated_poses import Repeatability, measure_poses


@pytest.mark.parametrize("with_rotations", [True, False])
@pytest.mark.parametrize(("factor", "words"), [(math.pi / 180.0, "radians"), (180.0 / math.pi, "degrees")])
def test_another_unit_is_recognised_without_sweeps(with_rotations: bool, factor: float, words: str) -> None:
    poses = free_poses()
    poses = replace(poses, joint_angles=factor * poses.joint_angles)
    if not with_rotations:
        poses = replace(poses, rotations=None)
    with pytest.raises(JointAnglesUnitMismatch, match=words):
        check_against_nominal(poses, KR5_ARC)
    with pytest.raises(JointAnglesUnitMismatch):
        identify(poses, KR5_ARC, folds=0)
    near = free_poses(2, math.radians(15.0))  # as degrees these hardly move
    with pytest.raises(JointAnglesUnitMismatch):
        identify(
            replace(
                near,
                joint_angles=factor * near.joint_angles,
                rotations=near.rotations if with_rotations else None,
            ),
            KR5_ARC,
        )


@pytest.mark.parametrize("half_range_deg", [2.0, 40.0])
def test_small_moves_are_no_radians(half_range_deg: float) -> None:
    """A robot about its zero, all angles small as degrees: they are what they are."""
    rng = np.random.default_rng(3)
    arm = kr5_arc(rng)
    q = free_angles(rng, np.zeros(6), 60, half_range=math.radians(half_range_deg))
    for with_rotations in (True, False):
        poses = measure_poses(arm, q, rng, estimator="given", robot=Repeatability(0.1, 1e-4))
        check_against_nominal(poses if with_rotations else replace(poses, rotations=None), KR5_ARC)


@pytest.mark.parametrize("sliding", [0, 2, 5])
def test_a_joint_that_slides_is_recognised_without_sweeps(sliding: int) -> None:
    rng = np.random.default_rng(4)
    q = free_angles(rng, KR5_ARC_HOME, 60)
    # What is sent for the joint are millimetres: it shifts along its axis by them, and the axes after it along.
    rows = KR5_ARC.as_array()
    T = []
    for angles in q:
        of_pose = rows.copy()
        of_pose[sliding, 2] += 200.0 * angles[sliding]
        turned = np.where(np.arange(6) == sliding, 0.0, angles)
        T.append(forward(Chain.from_array(of_pose), turned[None])[0])
    poses = PoseData(q, np.array(T)[:, :3, 3], np.array(T)[:, :3, :3])
    with pytest.raises(PrismaticJoint, match=f"joint {sliding + 1} "):
        check_against_nominal(poses, KR5_ARC)
    with pytest.raises(PrismaticJoint):
        identify(poses, KR5_ARC, folds=0)


SCARA = Chain.from_rows(
    [(350.0, 0.0, 400.0, 0.0), (300.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)]
)


@pytest.mark.parametrize("with_rotations", [True, False])
@pytest.mark.parametrize(("travel_mm", "per_unit"), [(180.0, 1.0), (60.0, -1.0), (0.18, 1000.0)])
def test_the_joint_of_a_scara_that_slides_is_recognised(
    travel_mm: float, per_unit: float, with_rotations: bool
) -> None:
    """Its value in mm along the axis, against it, and in metres; nominal lengths are off by a millimetre."""
    rng = np.random.default_rng(7)
    q = rng.uniform(-2.0, 2.0, (60, 4))
    q[:, 2] = np.radians(rng.uniform(0.0, travel_mm, 60))
    rows = SCARA.as_array() + [1.0, 0.0, 0.0, 0.0, 0.0] * np.array([[1.0], [-0.8], [0.0], [0.0]])
    T = []
    for angles in q:
        of_pose = rows.copy()
        of_pose[2, 2] = per_unit * math.degrees(angles[2])
        turned = np.where(np.arange(4) == 2, 0.0, angles)
        T.append(
            forward(Chain.from_array(of_pose), turned[None])[0]
            @ transform(np.eye(3), np.array([40.0, 10.0, 60.0]))
        )
    positions = np.array(T)[:, :3, 3] + rng.normal(0.0, 0.03, (60, 3))
    poses = PoseData(q, positions, np.array(T)[:, :3, :3] if with_rotations else None)
    if travel_mm > 1.0:  # with orientations a joint of less than a degree is not excited
        with pytest.raises(PrismaticJoint, match="joint 3 ") as caught:
            identify(poses, SCARA, folds=0)
        assert "without it" in (caught.value.advice or "")
    if not with_rotations:
        with pytest.raises(PrismaticJoint, match="joint 3 slides"):
            check_sliding(poses, SCARA)
    # What the advice says: at one travel, of a robot without the joint.
    rest = np.flatnonzero(np.arange(4) != 2)
    at_rest = np.array(
        [
            T_ @ transform(np.eye(3), np.array([0.0, 0.0, -per_unit * math.degrees(a[2])]))
            for T_, a in zip(T, q, strict=True)
        ]
    )
    without = PoseData(
        q[:, rest],
        at_rest[:, :3, 3] + rng.normal(0.0, 0.03, (60, 3)),
        at_rest[:, :3, :3] if with_rotations else None,
    )
    found = identify(without, Chain(tuple(SCARA.joints[i] for i in rest)), folds=0)
    assert found.residual.position_rms_mm < 0.1


def test_other_reasons_are_not_taken_for_a_joint_that_slides() -> None:
    rng = np.random.default_rng(8)
    poses = replace(free_poses(6), rotations=None)
    check_sliding(poses, KR5_ARC)
    swapped = replace(poses, joint_angles=poses.joint_angles[:, [0, 2, 1, 3, 4, 5]])
    shuffled = replace(poses, joint_angles=poses.joint_angles[rng.permutation(len(poses))])
    turned = replace(poses, joint_angles=poses.joint_angles * np.where(np.arange(6) == 2, -1.0, 1.0))
    check_sliding(turned, KR5_ARC)
    for wrong in (swapped, shuffled):
        check_sliding(wrong, KR5_ARC)
        with pytest.raises(JointAnglesInconsistent) as caught:
            identify(wrong, KR5_ARC, folds=0)
        assert "slides" in (caught.value.advice or "")


def test_a_nominal_of_another_robot_is_no_reason_to_refuse() -> None:
    poses = free_poses(5)
    wrong = KR5_ARC.as_array()
    wrong[:, 0] *= 1.6
    wrong[3, 3] += 0.7
    check_against_nominal(poses, Chain.from_array(wrong))
    check_angles(poses, find_sweeps(poses))


UNITS_MM = {"metres": 1000.0, "centimetres": 10.0, "inches": 25.4}


@pytest.mark.parametrize("with_rotations", [True, False])
@pytest.mark.parametrize("unit", UNITS_MM)
def test_other_units_of_length_are_recognised(unit: str, with_rotations: bool) -> None:
    poses, factor = free_poses(), 1.0 / UNITS_MM[unit]
    if not with_rotations:
        poses = replace(poses, rotations=None)
    with pytest.raises(LengthsUnitMismatch, match=f"positions look like {unit}"):
        identify(replace(poses, positions_mm=factor * poses.positions_mm), KR5_ARC, folds=0)
    small = KR5_ARC.as_array()
    small[:, [0, 2]] *= factor
    with pytest.raises(LengthsUnitMismatch, match=f"robot's lengths look like {unit}"):
        identify(poses, Chain.from_array(small), folds=0)
    off = KR5_ARC.as_array()
    off[1, 0] *= 0.5  # a wrong nominal is no wrong unit
    check_against_nominal(poses, Chain.from_array(off))


MIRRORS = {
    "x backwards": np.diag([-1.0, 1.0, 1.0]),
    "x and y exchanged": np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    "all backwards": -np.eye(3),
}


@pytest.mark.parametrize("rotations", ["none", "mirrored", "right-handed"])
@pytest.mark.parametrize("mirror", MIRRORS.values(), ids=MIRRORS)
def test_a_left_handed_frame_is_recognised(mirror: np.ndarray, rotations: str) -> None:
    poses = free_poses()
    assert poses.rotations is not None
    changed = {"none": None, "mirrored": mirror @ poses.rotations @ mirror, "right-handed": poses.rotations}
    with pytest.raises(FrameMirrored):
        identify(
            replace(poses, positions_mm=poses.positions_mm @ mirror.T, rotations=changed[rotations]),
            KR5_ARC,
            folds=0,
        )


@pytest.mark.parametrize("with_rotations", [True, False])
def test_units_of_an_arm_of_parallel_axes_are_recognised(with_rotations: bool) -> None:
    """The closed form of base and tool has no unique answer there."""
    nominal = Chain.from_rows([(325.0, 0.0, 400.0, 0.0), (225.0, 0.0, 0.0, 0.0), (0.0, 0.0, 100.0, 0.0)])
    rng = np.random.default_rng(3)
    q = rng.uniform(-1.0, 1.0, (40, 3))
    T = forward(nominal, q)
    poses = PoseData(
        q, T[:, :3, 3] + rng.normal(0.0, 0.05, (40, 3)), T[:, :3, :3] if with_rotations else None
    )
    check_against_nominal(poses, nominal)
    with pytest.raises(LengthsUnitMismatch):
        check_against_nominal(replace(poses, positions_mm=1e-3 * poses.positions_mm), nominal)
    with pytest.raises(JointAnglesUnitMismatch):
        check_against_nominal(replace(poses, joint_angles=np.radians(q)), nominal)


def test_what_is_said_has_a_code_and_advice() -> None:
    poses = free_poses()
    with pytest.raises(KinematicsError) as caught:
        identify(replace(poses, joint_angles=np.radians(poses.joint_angles)), KR5_ARC)
    assert caught.value.code == "joint_angles_unit_mismatch"
    assert caught.value.advice
