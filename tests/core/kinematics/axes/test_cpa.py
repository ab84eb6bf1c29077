"""Identification from sweeps: exact on exact poses, whatever the arm, the settings of its arcs and the targets."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from core.errors import JointAnglesInconsistent, JointAnglesUnitMismatch, JointNotExcited, MotionInsufficient
from core.geometry.se3 import invert
from core.kinematics.circle_point_analysis.common_normals import reparametrise
from core.kinematics.circle_point_analysis.identification import AxesIdentification, identify_from_axes
from core.kinematics.dh import Chain
from core.kinematics.pose_observations import PoseData
from core.kinematics.sweeps import named_sweeps
from core.simulation import KR5_ARC, KR5_ARC_HOME, Arm, kr5_arc, sweep_angles
from core.simulation.arm import deviated
from tests.support.simulation.robots.arms import SEVEN_JOINTS, UR10
from tests.support.simulation.simulated_poses import measure_poses

ARM = kr5_arc(np.random.default_rng(0))
SWEEPS = sweep_angles(KR5_ARC_HOME)


def exact(angles: np.ndarray = SWEEPS, arm: Arm = ARM, target: np.ndarray | None = None) -> PoseData:
    return measure_poses(arm, angles, np.random.default_rng(1), estimator="exact", target=target)


def truth(found: AxesIdentification, arm: Arm, nominal: Chain | None) -> np.ndarray:
    return reparametrise(arm.chain, [j.parallel_to_next for j in found.joints], nominal).as_array()


def arm_of(nominal: Chain) -> Arm:
    return dataclasses.replace(ARM, chain=deviated(nominal, np.random.default_rng(2), 0.3, 5e-4))


@pytest.mark.parametrize("method", ["cpa", "screw", "combined"])
def test_exact_sweeps_give_the_robot(method: str) -> None:
    found = identify_from_axes(exact(), KR5_ARC, method)
    np.testing.assert_allclose(found.chain.as_array(), truth(found, ARM, KR5_ARC), atol=1e-7)
    assert found.residual_mm < 1e-8
    assert found.residual_rad is not None
    assert found.residual_rad < 1e-8
    np.testing.assert_allclose(found.home, KR5_ARC_HOME, atol=1e-9)
    again = found.T_target_base[0] @ invert(ARM.T_target_base[0])
    assert np.linalg.norm(again[:3, :3] - np.eye(3)) < 0.01  # but for conventions


def test_what_no_pose_determines_is_the_nominals_and_said_in_words() -> None:
    found = identify_from_axes(measure_poses(ARM, SWEEPS, np.random.default_rng(3)), KR5_ARC)
    for joint, nominal in ((found.joints[0], KR5_ARC.joints[0]), (found.joints[5], KR5_ARC.joints[5])):
        for name, determined in joint.identifiable.items():
            assert determined == (joint.standard_uncertainty[name] is not None)
            if not determined and name != "beta_rad":
                assert getattr(joint.parameters, name) == getattr(nominal, name)
    assert found.joints[0].identifiable["a_mm"]
    assert not found.joints[0].identifiable["d_mm"]
    assert not any(found.joints[5].identifiable.values())
    assert found.joints[1].parallel_to_next
    assert found.joints[1].identifiable["beta_rad"]
    assert found.joints[1].parameters.d_mm == 0.0
    assert [j.parallel_to_next for j in found.joints].count(True) == 1
    assert int(found.identifiable.sum()) == 18
    assert "d2 and d3 cannot be determined separately: joints 2 and 3 are parallel." in [
        group.sentence for group in found.null_space
    ]
    assert math.degrees(found.joints[3].arc_rad) == pytest.approx(80.0)
    assert found.joints[3].poses == 16


@pytest.mark.parametrize("nominal", [UR10, SEVEN_JOINTS], ids=["ur10", "seven"])
@pytest.mark.parametrize("given", [True, False], ids=["nominal", "none"])
def test_other_arms(nominal: Chain, given: bool) -> None:
    arm = arm_of(nominal)
    home = np.random.default_rng(4).uniform(-0.8, 0.8, len(nominal)) + 0.4
    poses = measure_poses(arm, sweep_angles(home), np.random.default_rng(5), sigma_px=1e-5)
    convention = nominal if given else None
    found = identify_from_axes(poses, convention)
    true = truth(found, arm, convention)
    uncertainty = np.sqrt(np.diag(found.covariance)).reshape(-1, 5)
    off = np.abs(found.chain.as_array() - true)
    off[:, [1, 3]] = np.abs((off[:, [1, 3]] + np.pi) % (2.0 * np.pi) - np.pi)
    assert np.all(off <= 5.0 * uncertainty + 1e-9)
    assert off.max() < 0.01


def test_parallel_axes_are_decided_by_uncertainty() -> None:
    """Axes 2 and 3 half a degree from parallel: d2 is determined where the measurement is good enough, β2 where not."""
    P = KR5_ARC.as_array()
    P[1, [1, 4]] = math.radians(0.4), math.radians(0.3)
    arm = dataclasses.replace(ARM, chain=Chain.from_array(P))
    coarse = identify_from_axes(measure_poses(arm, SWEEPS, np.random.default_rng(6)), KR5_ARC)
    fine = identify_from_axes(measure_poses(arm, SWEEPS, np.random.default_rng(6), sigma_px=1e-6), KR5_ARC)
    assert coarse.joints[1].parallel_to_next
    assert not fine.joints[1].parallel_to_next
    assert abs(fine.joints[1].parameters.d_mm) > 1000.0  # the common normal is far off
    uncertainty = np.sqrt(np.diag(fine.covariance)).reshape(-1, 5)
    off = np.abs(fine.chain.as_array() - truth(fine, arm, KR5_ARC))
    assert np.all(off <= 5.0 * uncertainty + 1e-9)


def test_positions_alone() -> None:
    poses = dataclasses.replace(exact(), rotations=None)
    for method in ("cpa", "combined"):
        found = identify_from_axes(poses, KR5_ARC, method)
        np.testing.assert_allclose(found.chain.as_array(), truth(found, ARM, KR5_ARC), atol=1e-6)
        assert found.residual_rad is None
        assert found.residual_mm < 1e-6


def test_arcs_at_several_settings_are_brought_home() -> None:
    """Each joint is swept where the camera sees the target best: later joints' settings differ from arc to arc."""
    rng = np.random.default_rng(7)
    settings = KR5_ARC_HOME + rng.uniform(-0.4, 0.4, (9, 6))
    angles = np.concatenate([sweep_angles(s, joints=[k % 6], steps=9) for k, s in enumerate(settings)])
    found = identify_from_axes(exact(angles[rng.permutation(len(angles))]), KR5_ARC)
    np.testing.assert_allclose(found.chain.as_array(), truth(found, ARM, KR5_ARC), atol=1e-6)
    assert len(found.fits.arcs) == 9
    assert found.residual_mm < 1e-6


def test_resting_joints_that_did_not_quite_rest_are_corrected() -> None:
    rng = np.random.default_rng(8)
    angles = SWEEPS + rng.uniform(-1.0, 1.0, SWEEPS.shape) * math.radians(0.009)
    found = identify_from_axes(exact(angles), KR5_ARC)
    # Uncorrected, .009° at a metre are .15 mm.
    assert np.abs(found.chain.as_array() - truth(found, ARM, KR5_ARC))[:, [0, 2]].max() < 0.002
    assert found.residual_mm < 0.002


def test_two_targets_by_images_that_see_both() -> None:
    """Joints 1-3 are swept before the first target, 4-6 before the second; the home image shows both."""
    angles = np.concatenate([SWEEPS, KR5_ARC_HOME[None]])
    target = np.array([0] * 33 + [1] * 33 + [0])
    found = identify_from_axes(exact(angles, target=target), KR5_ARC)
    np.testing.assert_allclose(found.chain.as_array(), truth(found, ARM, KR5_ARC), atol=1e-6)
    T = ARM.T_target_base[0] @ invert(ARM.T_target_base[1])
    np.testing.assert_allclose(found.links[1].T_first_target, T, atol=1e-6)
    assert found.links[1].pairs == 3  # there are as many home images of the second target


def test_two_targets_by_arcs_seen_on_each() -> None:
    """No image shows both; joints 1 and 2 are swept before either."""
    away = KR5_ARC_HOME + np.radians([0.0, 0.0, -20.0, 5.0, 30.0, 0.0])
    angles = np.concatenate([SWEEPS, sweep_angles(away, joints=[0, 1], steps=9)])
    target = np.array([0] * 44 + [1] * 22 + [1] * 18)
    angles[44:66, [2, 3, 4]] += (
        away[[2, 3, 4]] - KR5_ARC_HOME[[2, 3, 4]]
    )  # joints 5 and 6 at the other setting
    found = identify_from_axes(exact(angles, target=target), KR5_ARC)
    np.testing.assert_allclose(found.chain.as_array(), truth(found, ARM, KR5_ARC), atol=1e-6)
    T = ARM.T_target_base[0] @ invert(ARM.T_target_base[1])
    np.testing.assert_allclose(found.links[1].T_first_target, T, atol=1e-6)
    assert found.links[1].covariance is not None
    np.testing.assert_allclose(found.T_target_base[1], invert(T) @ found.T_target_base[0], atol=1e-6)
    assert found.residual_mm < 1e-6


def test_targets_that_nothing_ties_are_refused() -> None:
    target = np.array([0] * 33 + [1] * 33)
    poses = exact(np.concatenate([SWEEPS[:33], SWEEPS[33:] + 1e-4]), target=target)
    with pytest.raises(MotionInsufficient, match="target 2"):
        identify_from_axes(poses, KR5_ARC)
    # Parallel axes on either target do not tie them.
    angles = np.concatenate([SWEEPS, sweep_angles(KR5_ARC_HOME + 1e-4, joints=[0], steps=9)])
    with pytest.raises(MotionInsufficient, match="parallel"):
        identify_from_axes(exact(angles, target=np.array([0] * 66 + [1] * 9)), KR5_ARC)


def test_named_sweeps_are_taken() -> None:
    poses = exact()
    assert poses.labels[:2] == ("P001", "P002")
    named = {joint: [poses.labels[11 * joint : 11 * joint + 11]] for joint in range(6)}
    found = identify_from_axes(poses, KR5_ARC, sweeps=named_sweeps(poses, named))
    assert [j.poses for j in found.joints] == [11] * 6
    np.testing.assert_allclose(found.chain.as_array(), truth(found, ARM, KR5_ARC), atol=1e-6)


def test_two_joints_determine_angle_and_distance() -> None:
    arm = dataclasses.replace(ARM, chain=Chain.from_rows([(85.0, -70.0, 300.0, 0.0), (10.0, 5.0, 20.0, 0.0)]))
    found = identify_from_axes(exact(sweep_angles(np.array([0.2, -0.3])), arm))
    joint = found.joints[0].parameters
    assert joint.a_mm == pytest.approx(85.0)
    assert abs(math.degrees(joint.alpha_rad)) == pytest.approx(70.0)
    assert [name for name, determined in found.joints[0].identifiable.items() if determined] == [
        "a_mm",
        "alpha_rad",
    ]


def test_bad_input_is_refused() -> None:
    with pytest.raises(JointAnglesInconsistent, match=r"6 .* 7"):
        identify_from_axes(exact(), SEVEN_JOINTS)
    with pytest.raises(JointNotExcited, match="joint 5"):
        identify_from_axes(exact(sweep_angles(KR5_ARC_HOME, joints=[0, 1, 2, 3, 5])), KR5_ARC)
    poses = exact()
    with pytest.raises(JointAnglesUnitMismatch):
        identify_from_axes(dataclasses.replace(poses, joint_angles=np.radians(poses.joint_angles)), KR5_ARC)
