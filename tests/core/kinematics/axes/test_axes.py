"""Axes of simulated sweeps: exact, sound against wrong poses, refused where an arc determines no axis."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from core.errors import (
    ArcTooShort,
    DegenerateGeometry,
    InvalidArgument,
    JointAnglesInconsistent,
    JointAnglesUnitMismatch,
    PrismaticJoint,
    RotationsMissing,
)
from core.geometry.se3 import so3_exp
from core.kinematics.circle_point_analysis.common_normals import axes_of
from core.kinematics.joint_angle_checks import check_angles
from core.kinematics.joint_axes.axis_fit import METHODS, AxisFits, fit_axes
from core.kinematics.pose_observations import PoseData
from core.kinematics.sweeps import find_sweeps
from core.simulation import KR5_ARC_HOME, Arm, kr5_arc, sweep_angles
from tests.support.simulation.simulated_poses import measure_poses

ARM = kr5_arc(np.random.default_rng(0))


def swept(arc_deg: float = 80.0, estimator: str = "exact", seed: int = 1, steps: int = 11) -> PoseData:
    angles = sweep_angles(KR5_ARC_HOME, half_arc=math.radians(arc_deg / 2.0), steps=steps)
    return measure_poses(ARM, angles, np.random.default_rng(seed), estimator=estimator)


def errors(fits: AxisFits, arm: Arm = ARM) -> np.ndarray:
    """True - found along each arc's own directions: point, then direction."""
    true = axes_of(arm.chain, KR5_ARC_HOME, arm.T_target_base[0])
    found = []
    for arc, basis in zip(fits.arcs, fits.bases, strict=True):
        n = true.directions[arc.sweep.joint]
        out = true.points[arc.sweep.joint] - arc.point_mm
        out = out - n * (out @ arc.direction) / (n @ arc.direction)
        found.append(np.concatenate([basis.T @ out, basis.T @ np.cross(arc.direction, n)]))
    return np.array(found)


@pytest.mark.parametrize("method", METHODS)
def test_exact_poses_give_the_axes(method: str) -> None:
    fits = fit_axes(swept(), find_sweeps(swept()), method)
    off = errors(fits)
    np.testing.assert_allclose(off[:, :2], 0.0, atol=1e-8)
    np.testing.assert_allclose(off[:, 2:], 0.0, atol=1e-10)
    assert fits.warnings == ()
    for arc in fits.arcs:
        assert np.abs(arc.residuals).max() < 1e-8
        assert np.linalg.eigvalsh(arc.covariance).min() > -1e-18


def test_combined_needs_no_rotations_and_little_arc() -> None:
    poses = dataclasses.replace(swept(), rotations=None)
    for method in ("cpa", "combined"):
        np.testing.assert_allclose(errors(fit_axes(poses, find_sweeps(poses), method)), 0.0, atol=1e-7)
    short = swept(12.0)
    for method in ("screw", "combined"):
        np.testing.assert_allclose(errors(fit_axes(short, find_sweeps(short), method)), 0.0, atol=1e-7)


def test_what_a_method_cannot_do_is_refused() -> None:
    short = swept(50.0)
    with pytest.raises(ArcTooShort, match=r"joint 1 .* 50\.0° .* 60°"):
        fit_axes(short, find_sweeps(short), "cpa")
    shorter = swept(8.0)
    with pytest.raises(ArcTooShort, match=r"8\.0°"):
        fit_axes(shorter, find_sweeps(shorter), "combined")
    positions = dataclasses.replace(swept(), rotations=None)
    with pytest.raises(RotationsMissing):
        fit_axes(positions, find_sweeps(positions), "screw")
    with pytest.raises(InvalidArgument, match="global") as failure:
        fit_axes(positions, find_sweeps(positions), "global")
    assert "cpa, screw, combined" in str(failure.value.advice)


def test_a_reflector_on_the_axis_determines_no_circle() -> None:
    arm = dataclasses.replace(ARM, T_flange_camera=np.eye(4))
    angles = sweep_angles(KR5_ARC_HOME)
    per_image = measure_poses(arm, angles, np.random.default_rng(1), estimator="per_image")
    alone = dataclasses.replace(per_image, rotations=None)
    for method in ("cpa", "combined"):
        with pytest.raises(DegenerateGeometry, match="joint 6") as failure:
            fit_axes(alone, find_sweeps(alone), method)
        assert "away from the joint's axis" in str(failure.value.advice)
    # Rotations determine the direction all the same, and which point stays put.
    exact = measure_poses(arm, angles, np.random.default_rng(1), estimator="exact")
    np.testing.assert_allclose(errors(fit_axes(exact, find_sweeps(exact)), arm), 0.0, atol=1e-7)


def test_the_stated_residuals_are_measured_minus_fitted() -> None:
    poses = swept(estimator="given")
    (arc, *_) = fit_axes(poses, find_sweeps(poses)).arcs
    moved = dataclasses.replace(poses, positions_mm=poses.positions_mm.copy())
    pose = int(arc.sweep.poses[0])
    moved.positions_mm[pose] += [0.0, 0.0, 1e-3]
    (again, *_) = fit_axes(moved, find_sweeps(moved)).arcs
    change = again.residuals[0, :3] - arc.residuals[0, :3]
    assert 2e-4 < change[2] < 1e-3  # the fit follows a little
    assert arc.radius_mm == pytest.approx(np.linalg.norm(arc.motion.position - arc.point_mm), rel=1e-6)


@pytest.mark.parametrize("method", METHODS)
def test_wrong_poses_are_named_and_excluded(method: str) -> None:
    poses = swept(estimator="pooled")
    positions, rotations = poses.positions_mm.copy(), poses.rotations
    assert rotations is not None
    rotations = rotations.copy()
    wrong = [3, 14, 15, 36, 61]
    positions[wrong] += np.random.default_rng(2).normal(0.0, 40.0, (5, 3))
    rotations[wrong] = so3_exp(np.array([0.05, -0.1, 0.1])) @ rotations[wrong]
    spoilt = dataclasses.replace(poses, positions_mm=positions, rotations=rotations)
    fits = fit_axes(spoilt, find_sweeps(spoilt), method)
    assert sorted({int(p) for arc in fits.arcs for p in arc.sweep.poses[~arc.used]}) == wrong
    (warning,) = fits.warnings
    assert warning.code == "pose_outliers"
    assert "P004, P015, P016, P037, P062" in warning.detail
    sigma = np.sqrt(np.diag(fits.covariance)).reshape(-1, 4)
    assert np.abs(errors(fits) / sigma).max() < 5.0


def test_a_small_slip_of_one_pose_is_seen() -> None:
    poses = swept(estimator="pooled")
    poses.positions_mm[30] += [0.0, 0.4, 0.0]
    fits = fit_axes(poses, find_sweeps(poses))
    assert {int(p) for arc in fits.arcs for p in arc.sweep.poses[~arc.used]} == {30}


def test_short_arcs_are_excluded_where_there_is_a_longer_one() -> None:
    other = KR5_ARC_HOME + np.radians([0.0, 0.0, 0.0, 20.0, 0.0, 0.0])
    angles = np.concatenate(
        [sweep_angles(KR5_ARC_HOME), sweep_angles(other, joints=[0], half_arc=math.radians(4.0), steps=5)]
    )
    poses = measure_poses(ARM, angles, np.random.default_rng(3), estimator="exact")
    fits = fit_axes(poses, find_sweeps(poses))
    assert len(fits.arcs) == 6
    assert [w.code for w in fits.warnings] == ["arc_excluded"]


def test_units_and_sliding_joints_are_recognised() -> None:
    poses = swept()
    as_radians = dataclasses.replace(poses, joint_angles=np.radians(poses.joint_angles))
    with pytest.raises(JointAnglesUnitMismatch, match="radians"):
        check_angles(as_radians, find_sweeps(as_radians))
    with pytest.raises(JointAnglesUnitMismatch, match="radians"):
        check_angles(dataclasses.replace(as_radians, rotations=None), find_sweeps(as_radians))
    with pytest.raises(JointAnglesUnitMismatch, match="radians"):  # no sweep at all to recognise it by
        check_angles(as_radians, ())
    as_degrees = dataclasses.replace(poses, joint_angles=np.degrees(poses.joint_angles))
    with pytest.raises(JointAnglesUnitMismatch, match="degrees"):
        check_angles(as_degrees, find_sweeps(as_degrees))
    geared = dataclasses.replace(poses, joint_angles=poses.joint_angles * [1, 1, 2, 1, 1, 1])
    with pytest.raises(JointAnglesInconsistent, match=r"joint 3 .* 0\.5"):
        check_angles(geared, find_sweeps(geared))
    check_angles(poses, find_sweeps(poses))
    check_angles(dataclasses.replace(poses, rotations=None), find_sweeps(poses))
    check_angles(poses, ())


@pytest.mark.parametrize("seed", range(3))
def test_short_radii_determine_no_other_turn(seed: int) -> None:
    """A reflector 3 mm off the axis, turned by 40° in all: noise makes the circle through it a third too small."""
    rng = np.random.default_rng(seed)
    angles = np.radians(np.linspace(-20.0, 20.0, 11))
    circle = 3.0 * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(11)])
    poses = PoseData(
        np.column_stack([angles, np.zeros(11)]), circle + rng.normal(0.0, 0.1, circle.shape), None
    )
    check_angles(poses, find_sweeps(poses))


@pytest.mark.parametrize(
    ("half_deg", "factor", "refusal"),
    [
        (10.0, math.pi / 180.0, JointAnglesUnitMismatch),
        (10.0, 0.5, JointAnglesInconsistent),
        (5.0, 2.0, JointAnglesInconsistent),
    ],
)
def test_short_arcs_of_long_radii_determine_the_turn(
    half_deg: float, factor: float, refusal: type[Exception]
) -> None:
    rng = np.random.default_rng(1)
    angles = np.radians(np.linspace(-half_deg, half_deg, 11))
    circle = 400.0 * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(11)])
    positions = circle + rng.normal(0.0, 0.05, circle.shape)
    poses = PoseData(np.column_stack([factor * angles, np.zeros(11)]), positions, None)
    with pytest.raises(refusal):
        check_angles(poses, find_sweeps(poses))


@pytest.mark.parametrize("with_rotations", [True, False])
def test_a_sliding_joint_is_refused(with_rotations: bool) -> None:
    values = np.linspace(-0.5, 0.5, 9)
    slid = np.outer(100.0 * values, [0.0, 0.6, 0.8])
    poses = PoseData(
        np.column_stack([values, np.zeros(9)]),
        slid,
        np.tile(np.eye(3), (9, 1, 1)) if with_rotations else None,
    )
    with pytest.raises(PrismaticJoint, match="joint 1"):
        check_angles(poses, find_sweeps(poses))


def test_without_covariance_the_noise_is_read_from_the_residuals() -> None:
    poses = swept(estimator="exact")
    rng = np.random.default_rng(4)
    noisy = dataclasses.replace(
        poses,
        positions_mm=poses.positions_mm + rng.normal(0.0, 0.2, (66, 3)),
        rotations=np.array([so3_exp(w) for w in rng.normal(0.0, 3e-4, (66, 3))]) @ poses.rotations,
    )
    fits = fit_axes(noisy, find_sweeps(noisy))
    # Some 200 degrees of freedom each (homes serve six arcs): 5 % of a standard deviation, three of those.
    assert fits.scatter_mm == pytest.approx(0.2, rel=0.2)
    assert fits.scatter_rad == pytest.approx(3e-4, rel=0.2)
