"""What a refused identification advises: the robot where the session has none, the coupling that the robot states."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from core.errors import EstimationError, JointAnglesInconsistent, JointNotExcited
from core.geometry import so3_exp, transform
from core.kinematics import Chain, ModelChoice
from core.session import MeasuredPose, SessionData, identify_robot
from core.simulation.arm import KR5_ARC, KR5_ARC_HOME, Arm, deviated, free_angles
from core.targets import TargetSpec

BOARD = TargetSpec("chessboard", 9, 6, 25.0)
PALLETIZER = Chain.from_rows(
    [
        (300.0, -90.0, 600.0, 0.0),
        (1050.0, 0.0, 0.0, 0.0),
        (1100.0, 0.0, 0.0, 0.0),
        (250.0, -90.0, 0.0, 0.0),
        (0.0, 0.0, 150.0, 0.0),
    ]
)
PALLETIZER_RANGE = np.radians([(-150.0, 150.0), (-100.0, 0.0), (10.0, 110.0), (-90.0, 90.0), (-170.0, 170.0)])


def palletizer(
    joints: int, coupling: np.ndarray, stated: np.ndarray | None, seed: int, *, level: bool
) -> tuple[SessionData, Chain]:
    """Forty poses of the first joints of a palletizer, whose forearm keeps its direction while joint 2 turns; of one
    whose hand stays `level` the fourth stated angle is 0. Returns the arm as built, too.
    """
    rng = np.random.default_rng(seed)
    nominal = Chain(PALLETIZER.joints[:joints])
    base = transform(so3_exp(rng.normal(0.0, 0.8, 3)), rng.normal(0.0, 800.0, 3))
    tool = transform(so3_exp(np.array([0.3, 0.0, 0.5])), np.array([60.0, -35.0, 90.0]))
    arm = Arm(deviated(nominal, rng, 0.5, math.radians(0.03)), base[None], tool)
    q = rng.uniform(PALLETIZER_RANGE[:joints, 0], PALLETIZER_RANGE[:joints, 1], (40, joints))
    q[:, 2] += q[:, 1]
    if level:
        q[:, 3] = 0.0
    poses = tuple(
        MeasuredPose(
            f"m{k}",
            f"P{k}",
            1,
            np.degrees(q[k]).tolist(),
            T[:3, 3] + rng.normal(0.0, 0.03, 3),
            T[:3, :3] @ so3_exp(rng.normal(0.0, 5e-5, 3)),
            None,
            None,
        )
        for k, T in enumerate(arm.camera_poses(q @ coupling.T))
    )
    data = SessionData((BOARD,), ("t",), measured=poses, nominal=nominal, joint_coupling=stated)
    return data, arm.chain


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


def test_a_coupled_joint_whose_turns_cancel_does_not_slide() -> None:
    """The hand of a palletizer does not turn with joint 2: what is wrong is the coupling that nobody stated."""
    coupling = np.eye(4)
    coupling[2, 1] = -1.0
    data, _ = palletizer(4, coupling, None, 1, level=False)
    with pytest.raises(JointAnglesInconsistent) as refused:
        identify_robot(data)
    assert "--joint-coupling 3:2:-1" in str(refused.value.advice)
    assert "joint 3 follows joint 2 by -1" in refused.value.detail
    assert "slid" not in refused.value.detail


LEVEL = np.eye(5)
LEVEL[2, 1] = LEVEL[3, 2] = -1.0


def test_a_palletizer_whose_hand_stays_level_is_identified_with_its_coupling() -> None:
    ratios = []
    for seed in range(4):
        data, built = palletizer(5, LEVEL, LEVEL, seed, level=True)
        found = identify_robot(data, model=ModelChoice.DH)
        assert "joints_move_together" in {warning.code for warning in found.warnings}
        assert found.residual.position_rms_mm < 0.07
        # a2, a3 and the direction of joints 2 and 3: no convention is in these
        joints = [joint.estimate for joint in found.joints]
        u = [joints[k].standard_uncertainty["a_mm"] for k in (1, 2)]
        assert None not in u
        off = [found.chain.joints[k].a_mm - built.joints[k].a_mm for k in (1, 2)]
        ratios += [d / s for d, s in zip(off, u, strict=True) if s]
    assert np.abs(ratios).max() < 4.0
    assert 0.5 < math.sqrt(float(np.mean(np.square(ratios)))) < 1.5


def test_without_its_coupling_the_level_hand_is_a_joint_at_rest() -> None:
    data, _ = palletizer(5, LEVEL, None, 1, level=True)
    with pytest.raises(JointNotExcited) as refused:
        identify_robot(data)
    assert "joint 4" in refused.value.detail
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
