"""Methods are compared as descriptions of one arm, whichever of two equal ones each has taken."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from core.geometry import so3_exp, transform
from core.kinematics import (
    JOINT_PARAMETERS,
    Chain,
    find_sweeps,
    identify,
    nearest_description,
    with_reversals,
)
from core.kinematics.pose_observations import PoseData
from core.session import MeasuredPose, RobotIdentification, SessionData, identify_robot
from core.session.robot.method_agreement import (
    AXIS_METHODS,
    MAX_DIFFERENCE,
    compare_methods,
    compare_with_global,
    disagreements,
)
from core.simulation.arm import KR5_ARC, KR5_ARC_HOME, Arm, sweep_angles
from core.targets.specification import TargetSpec
from tests.support.simulation.robots.arms import identifiable_truth
from tests.support.simulation.robots.real_arms import RealArm, measured, real_arm

TWO_AXES = Chain.from_rows([(0.7, 90.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)])
TOLERANCE = math.radians(0.02)


def test_reversed_axes_are_no_disagreement() -> None:
    """A positioner whose axes pass at .7 mm: without a nominal robot a hair decides about the sense of x."""
    rng = np.random.default_rng(4)
    base = transform(so3_exp(rng.normal(0.0, 1.0, 3)), rng.normal(0.0, 500.0, 3))
    arm = Arm(
        TWO_AXES, base[None], transform(so3_exp(rng.normal(0.0, 1.0, 3)), np.array([200.0, 50.0, 150.0]))
    )
    q = np.zeros((26, 2))
    q[:13, 0] = q[13:, 1] = np.linspace(-1.5, 1.5, 13)
    T = arm.camera_poses(q)
    rotations = np.array([so3_exp(rng.normal(0.0, 1e-4, 3)) @ R for R in T[:, :3, :3]])
    poses = PoseData(q, T[:, :3, 3] + rng.normal(0.0, 0.1, (26, 3)), rotations)
    found, sweeps = identify(poses, folds=0).joints, find_sweeps(poses)
    P = Chain(tuple(joint.parameters for joint in found)).as_array()
    reversed_chain = Chain.from_array(with_reversals(P, np.array([True])))
    assert nearest_description(reversed_chain.as_array(), P).tolist() == [True]
    others = [
        replace(joint, parameters=parameters)
        for joint, parameters in zip(found, reversed_chain.joints, strict=True)
    ]
    plain = compare_methods(found, poses, None, sweeps, TOLERANCE)
    turned = compare_methods(others, poses, None, sweeps, TOLERANCE)
    assert all(one.largest is not None and one.largest < 3.0 for one in plain)
    assert [one.largest for one in turned] == pytest.approx([one.largest for one in plain], rel=1e-6)
    assert not list(disagreements(turned))


def sweeps_of(seed: int, *, perfect: bool) -> tuple[RealArm, PoseData]:
    rng = np.random.default_rng(seed)
    real = real_arm(rng, perfect=perfect)
    q = sweep_angles(KR5_ARC_HOME, half_arc=math.radians(35.0), steps=9)
    return real, measured(real, q, rng)


def of_session(poses: PoseData) -> SessionData:
    assert poses.rotations is not None
    assert poses.covariance is not None
    readings = tuple(
        MeasuredPose(
            f"mpo_{i}",
            poses.label(i),
            1,
            np.degrees(poses.joint_angles[i]).tolist(),
            poses.positions_mm[i],
            poses.rotations[i],
            poses.covariance[i],
            None,
        )
        for i in range(len(poses))
    )
    board = TargetSpec("chessboard", 9, 6, 12.0)
    return SessionData((board,), ("tgt_1",), measured=readings, nominal=KR5_ARC)


@pytest.mark.parametrize("method", AXIS_METHODS)
def test_a_method_of_sweeps_says_that_gears_make_its_uncertainties_too_small(method: str) -> None:
    found = identify_robot(of_session(sweeps_of(1, perfect=False)[1]), method=method)
    codes = {warning.code for warning in found.warnings}
    assert "terms_beyond_chain" in codes
    (compared,) = found.method_agreement
    assert compared.method == method
    assert compared.largest is not None
    assert ("methods_disagree" in codes) == (compared.largest > MAX_DIFFERENCE)
    perfect = identify_robot(of_session(sweeps_of(1, perfect=True)[1]), method=method)
    assert not {"terms_beyond_chain", "methods_disagree"} & {warning.code for warning in perfect.warnings}
    assert perfect.method_agreement[0].largest is not None


def test_where_the_global_fit_fails_its_code_is_stated() -> None:
    """Two sweeps of one joint leave too few poses for an arm of six joints."""
    _, poses = sweeps_of(2, perfect=True)
    found, warnings = compare_with_global(
        "screw", identify(poses, KR5_ARC, folds=0).joints, poses.take(np.arange(5)), KR5_ARC, ()
    )
    assert found.failure is not None
    assert found.largest is None
    assert not warnings


def ratios(found: RobotIdentification, truth: np.ndarray) -> list[float]:
    """Errors of all parameters that are identified, in their stated uncertainties."""
    errors = []
    for joint, row in zip((figures.estimate for figures in found.joints), truth, strict=True):
        for name, value in zip(JOINT_PARAMETERS, row.tolist(), strict=True):
            u = joint.standard_uncertainty[name]
            if u is not None:
                off = getattr(joint.parameters, name) - value
                errors.append((math.remainder(off, 2.0 * math.pi) if name.endswith("_rad") else off) / u)
    return errors


@pytest.mark.slow
def test_intervals_of_sweeps_are_too_short_where_that_is_said() -> None:
    """Of the table in docs/kinematics.md: 4 arms of 16, some 75 parameters a method."""
    z: dict[str, list[float]] = {"screw": [], "combined": [], "global": []}
    for seed in range(1, 5):
        real, poses = sweeps_of(seed, perfect=False)
        truth = identifiable_truth(real.arm, poses.joint_angles)
        for method, of_method in z.items():
            found = identify_robot(of_session(poses), method=method)
            of_method += ratios(found, truth)
            codes = {warning.code for warning in found.warnings}
            assert ("terms_beyond_chain" in codes) == (method != "global")
    held = {method: float(np.mean(np.abs(of_method) < 1.96)) for method, of_method in z.items()}
    assert held["global"] > 0.88
    assert max(held["screw"], held["combined"]) < held["global"] - 0.05
