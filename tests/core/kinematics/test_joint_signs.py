"""Joints that count the other way than the nominal robot's are named, by poses and by positions alone."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from core.errors import JointSignReversed
from core.geometry import transform
from core.kinematics.dh import Chain, forward
from core.kinematics.identification import identify
from core.kinematics.nominal_checks import check_against_nominal
from core.kinematics.pose_observations import PoseData
from core.simulation.arm import KR5_ARC, T_FLANGE_CAMERA
from tests.support.simulation.robots.arms import free_poses


def counting_backwards(poses: PoseData, *joints: int) -> PoseData:
    signs = np.where(np.isin(np.arange(poses.joints), joints), -1.0, 1.0)
    return replace(poses, joint_angles=signs * poses.joint_angles)


@pytest.mark.parametrize("joint", range(6))
def test_a_joint_that_counts_backwards_is_named(joint: int) -> None:
    poses = free_poses().take(np.arange(0, 60, 5))
    with pytest.raises(JointSignReversed) as caught:
        check_against_nominal(counting_backwards(poses, joint), KR5_ARC)
    assert f"{joint + 1}:{joint + 1}:-1" in (caught.value.advice or "")


@pytest.mark.parametrize("joint", [1, 2, 3])
def test_a_joint_that_counts_backwards_is_named_by_positions_alone(joint: int) -> None:
    poses = replace(free_poses().take(np.arange(0, 60, 5)), rotations=None)
    with pytest.raises(JointSignReversed):
        identify(counting_backwards(poses, joint), KR5_ARC, folds=0)


def test_a_last_joint_that_counts_backwards_is_named_by_a_reflector_near_its_axis() -> None:
    """At 20 mm from the axis positions are off by 16 mm, 1.2 % of their extent."""
    poses = free_poses()
    assert poses.rotations is not None
    to_reflector = T_FLANGE_CAMERA[:3, :3].T @ (np.array([20.0, 0.0, 80.0]) - T_FLANGE_CAMERA[:3, 3])
    reflector = poses.positions_mm + poses.rotations @ to_reflector
    with pytest.raises(JointSignReversed, match="joint 6 counts"):
        identify(
            counting_backwards(replace(poses, positions_mm=reflector, rotations=None), 5), KR5_ARC, folds=0
        )


def test_a_first_joint_that_counts_backwards_is_no_left_handed_frame_of_an_arm_that_is_hardly_symmetric() -> (
    None
):
    """All links lie in one upright plane, the reflector 30 mm off it: the mirror image is near, the sign nearer."""
    nominal = Chain.from_rows(
        [
            (33.0, -90.0, 147.0, 0.0),
            (155.0, 0.0, 0.0, -90.0),
            (135.0, 0.0, 0.0, 0.0),
            (0.0, -90.0, 0.0, -90.0),
            (0.0, 0.0, 217.0, 0.0),
        ]
    )
    rng = np.random.default_rng(5)
    q = rng.uniform(-1.2, 1.2, (60, 5))
    T = forward(nominal, q) @ transform(np.eye(3), np.array([0.0, 30.0, 50.0]))
    poses = PoseData(q, T[:, :3, 3] + rng.normal(0.0, 0.05, (60, 3)))
    with pytest.raises(JointSignReversed, match="joint 1 counts"):
        check_against_nominal(counting_backwards(poses, 0), nominal)


def test_several_joints_that_count_backwards_are_named() -> None:
    with pytest.raises(JointSignReversed) as caught:
        check_against_nominal(counting_backwards(free_poses().take(np.arange(0, 60, 5)), 1, 4), KR5_ARC)
    assert "2:2:-1 --joint-coupling 5:5:-1" in (caught.value.advice or "")


IIWA = Chain.from_rows(
    [
        (0.0, -math.pi / 2, 360.0, 0.0),
        (0.0, math.pi / 2, 0.0, 0.0),
        (0.0, math.pi / 2, 420.0, 0.0),
        (0.0, -math.pi / 2, 0.0, 0.0),
        (0.0, -math.pi / 2, 400.0, 0.0),
        (0.0, math.pi / 2, 0.0, 0.0),
        (0.0, 0.0, 126.0, 0.0),
    ]
)


@pytest.mark.parametrize(("nominal", "reversed_joint"), [(KR5_ARC, None), (IIWA, None), (IIWA, 2)])
@pytest.mark.parametrize("count", [7, 30])
def test_signs_of_sound_poses_are_accepted(nominal: Chain, reversed_joint: int | None, count: int) -> None:
    rng = np.random.default_rng(count)
    q = rng.uniform(-1.0, 1.0, (count, len(nominal)))
    near = nominal.as_array() + rng.normal(0.0, 1.0, (len(nominal), 5)) * [0.4, 5e-4, 0.4, 5e-4, 0.0]
    T = forward(Chain.from_array(near), q)
    poses = PoseData(q, T[:, :3, 3] + rng.normal(0.0, 0.05, (count, 3)), T[:, :3, :3])
    if reversed_joint is None:
        check_against_nominal(poses, nominal)
        return
    with pytest.raises(JointSignReversed):
        check_against_nominal(counting_backwards(poses, reversed_joint), nominal)
