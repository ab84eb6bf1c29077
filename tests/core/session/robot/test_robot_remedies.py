"""What a refused identification advises: the robot where the session has none, the coupling that the robot states."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from core.errors import EstimationError, JointAnglesInconsistent, JointNotExcited
from core.geometry import so3_exp, transform
from core.kinematics import Chain
from core.session import MeasuredPose, SessionData, identify_robot
from core.simulation.arm import KR5_ARC, KR5_ARC_HOME, Arm, free_angles
from core.targets import TargetSpec

BOARD = TargetSpec("chessboard", 9, 6, 25.0)


def session(
    moving: np.ndarray, *, nominal: Chain | None, coupling: np.ndarray | None = None, count: int = 40
) -> SessionData:
    """Free poses of a KR5 whose stated angles are those of its axes."""
    rng = np.random.default_rng(2)
    base = transform(so3_exp(rng.normal(0.0, 1.0, 3)), rng.normal(0.0, 800.0, 3))
    arm = Arm(
        KR5_ARC, base[None], transform(so3_exp(rng.normal(0.0, 1.0, 3)), np.array([60.0, -30.0, 110.0]))
    )
    q = KR5_ARC_HOME + moving * (free_angles(rng, KR5_ARC_HOME, count) - KR5_ARC_HOME)
    poses = tuple(
        MeasuredPose(f"m{k}", f"P{k}", 1, np.degrees(q[k]).tolist(), T[:3, 3], T[:3, :3], None, None)
        for k, T in enumerate(arm.camera_poses(q))
    )
    return SessionData((BOARD,), ("t",), measured=poses, nominal=nominal, joint_coupling=coupling)


def test_free_poses_without_a_robot_need_the_robot() -> None:
    with pytest.raises(JointNotExcited) as refused:
        identify_robot(session(np.ones(6), nominal=None))
    assert "robot_id" in str(refused.value.advice)


def test_no_robot_helps_a_joint_at_rest() -> None:
    at_rest = np.array([1.0, 1.0, 0.0, 1.0, 1.0, 1.0])
    for nominal in (None, KR5_ARC):
        with pytest.raises(JointNotExcited) as refused:
            identify_robot(session(at_rest, nominal=nominal))
        assert "robot_id" not in str(refused.value.advice)


def test_a_wrongly_stated_coupling_is_named() -> None:
    wrong = np.eye(6)
    wrong[2, 1] = 1.0
    with pytest.raises(EstimationError) as refused:
        identify_robot(session(np.ones(6), nominal=KR5_ARC, coupling=wrong))
    assert "joint 3 follows joint 2 by 1" in refused.value.detail
    assert "joint_coupling" in str(refused.value.advice)
    assert "without any coupling" in refused.value.detail


@pytest.mark.slow
def test_another_coupling_is_proposed_for_a_wrong_one() -> None:
    """Stated angles of a coupled arm, and the coupling of the other sense."""
    right, wrong = np.eye(6), np.eye(6)
    right[2, 1], wrong[2, 1] = 1.0, -1.0
    data = session(np.ones(6), nominal=KR5_ARC, coupling=wrong)
    stated = [
        MeasuredPose(
            one.measurement_id,
            one.pose_id,
            one.cycle,
            (np.linalg.inv(right) @ np.asarray(one.joint_angles_deg)).tolist(),
            one.position_mm,
            one.rotation,
            None,
            None,
        )
        for one in data.measured
    ]
    with pytest.raises(EstimationError) as refused:
        identify_robot(
            SessionData((BOARD,), ("t",), measured=tuple(stated), nominal=KR5_ARC, joint_coupling=wrong)
        )
    assert "--joint-coupling 3:2:1" in str(refused.value.advice)


def test_a_stated_coupling_is_a_suspect_where_nothing_suits() -> None:
    rng = np.random.default_rng(0)
    data = session(np.ones(6), nominal=KR5_ARC, coupling=np.eye(6) + 0.5 * np.eye(6, k=-1))
    shuffled = [data.measured[k] for k in rng.permutation(len(data.measured))]
    mixed = tuple(
        MeasuredPose(
            a.measurement_id, a.pose_id, a.cycle, b.joint_angles_deg, a.position_mm, a.rotation, None, None
        )
        for a, b in zip(data.measured, shuffled, strict=True)
    )
    with pytest.raises(JointAnglesInconsistent) as refused:
        identify_robot(
            SessionData((BOARD,), ("t",), measured=mixed, nominal=KR5_ARC, joint_coupling=data.joint_coupling)
        )
    assert "joint_coupling" in str(refused.value.advice)


def test_a_frame_that_moved_between_poses_is_named() -> None:
    data = session(np.ones(6), nominal=KR5_ARC)
    # In the order of their names, as programs visit them.
    moved = tuple(
        replace(p, position_mm=p.position_mm + np.array([0.0, 1.0, 0.5])) if int(p.pose_id[1:]) >= 22 else p
        for p in data.measured
    )
    still, stepped = (
        [w for w in identify_robot(replace(data, measured=some)).warnings if w.code == "frame_moved"]
        for some in (data.measured, moved)
    )
    assert not still
    (warning,) = stepped
    assert "From pose P22 on" in warning.detail
