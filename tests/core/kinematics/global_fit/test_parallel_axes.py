"""Arms whose axes are all parallel, or nearly: the start is unique, the result is as the nominal robot is described,
and refers to the height of the measured point.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from core.geometry import so3_exp, transform
from core.kinematics.circle_point_analysis import identify_from_axes
from core.kinematics.circle_point_analysis.common_normals import axes_of, choose_signs, describe
from core.kinematics.dh import Chain, forward
from core.kinematics.equal_descriptions import height_over_flange, turn, with_reversals
from core.kinematics.global_fit import linearised, observations_of, placed
from core.kinematics.identification import Identification, identify
from core.kinematics.pose_observations import PoseData
from core.simulation.arm import KR5_ARC, Arm, kr5_arc
from tests.support.simulation.robots.arms import angles, stated
from tests.support.simulation.simulated_poses import measure_poses

SCARA = Chain.from_rows([(325.0, 0.0, 400.0, 0.0), (275.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)])
DOWNWARD = Chain.from_rows([(325.0, 0.0, 400.0, 0.0), (275.0, 180.0, 0.0, 0.0), (0.0, 0.0, 0.0, 20.0)])
RANGE = np.array([2.2, 2.4, 3.0])
SIGMA_MM, SIGMA_RAD = 0.02, 5e-5


def built(rng: np.random.Generator, tool_z_mm: float = -60.0, nominal: Chain = SCARA) -> Arm:
    """An arm off its nominal by some tenths of a millimetre, its axes tilted by some hundredths of a degree."""
    off = np.zeros((3, 5))
    off[:2, 0], off[:2, 1], off[1, 3] = (
        rng.normal(0.0, 0.4, 2),
        rng.normal(0.0, 4e-4, 2),
        rng.normal(0.0, 1e-3),
    )
    base = transform(so3_exp(rng.normal(0.0, 1.0, 3)), rng.normal(0.0, 500.0, 3))
    tool = transform(so3_exp(np.array([math.pi, 0.0, 0.0])), np.array([30.0, 0.0, tool_z_mm]))
    return Arm(Chain.from_array(nominal.as_array() + off), base[None], tool)


def measured(arm: Arm, q: np.ndarray, rng: np.random.Generator, scale: float = 1.0) -> PoseData:
    T = arm.camera_poses(q)
    rotations = np.array([so3_exp(rng.normal(0.0, scale * SIGMA_RAD, 3)) @ R for R in T[:, :3, :3]])
    return PoseData(q, T[:, :3, 3] + rng.normal(0.0, scale * SIGMA_MM, (len(q), 3)), rotations)


def free(rng: np.random.Generator, count: int = 40) -> np.ndarray:
    return np.asarray(rng.uniform(-RANGE, RANGE, (count, 3)))


def sweeps() -> np.ndarray:
    q = np.tile([0.3, 0.8, -0.2], (39, 1))
    for joint in range(3):
        q[13 * joint : 13 * joint + 13, joint] += np.linspace(-1.2, 1.2, 13)
    return q


def truth(arm: Arm, nominal: Chain | None) -> np.ndarray:
    """The arm's parameters with its flange level with the measured point: by its axes, from where they are."""
    home = np.zeros(3)
    axes, end = axes_of(arm.chain, home, arm.T_target_base[0]), arm.camera_poses(home[None])[0]
    forms = choose_signs(axes, home, [True, True], [False, False], nominal, np.zeros(2))
    height = 0.0
    for _ in range(3):
        found = describe(axes, home, forms, nominal, height)
        flange = found.T_frame_base @ forward(Chain.from_array(found.parameters), home[None])[0]
        tool = (np.linalg.inv(flange) @ end)[:3, 3]
        height += height_over_flange(found.parameters, tool)[0]
    return found.parameters


def assert_true(found: Identification, expected: np.ndarray) -> np.ndarray:
    """Return the errors in stated uncertainties, none of which is beyond chance."""
    off = found.chain.as_array() - expected
    off[:, [1, 3, 4]] = turn(off[:, [1, 3, 4]])
    ratio = off / stated(found)
    ratio = ratio[np.isfinite(ratio)]
    assert len(ratio) == 7  # a, α, β of two links and θ of the second joint
    assert np.abs(ratio).max() < 4.5
    return np.asarray(ratio)


@pytest.mark.parametrize("nominal", [SCARA, DOWNWARD], ids=["upward", "downward"])
@pytest.mark.parametrize("seed", range(4))
def test_the_start_is_there_in_closed_form(seed: int, nominal: Chain) -> None:
    rng = np.random.default_rng(seed)
    arm = replace(built(rng, nominal=nominal), chain=nominal)
    q = free(rng, 12)
    seen = observations_of(measured(arm, q, rng, scale=0.01))
    begin = placed(nominal.as_array(), forward(nominal, q), seen)
    assert np.abs(linearised(begin, seen)[0][:3]).max() < 0.01
    alone = replace(seen, rotations=None, own=seen.own[:, :3, :3], common=seen.common[:, :3])
    begin = placed(nominal.as_array(), forward(nominal, q), alone)
    assert np.abs(linearised(begin, alone)[0]).max() < 0.01


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("tool_z_mm", [-60.0, 200.0])
def test_uncertainties_hold_whatever_the_tool(seed: int, tool_z_mm: float) -> None:
    rng = np.random.default_rng(seed)
    arm = built(rng, tool_z_mm)
    found = identify(measured(arm, free(rng), rng), SCARA, folds=0)
    assert_true(found, truth(arm, SCARA))
    assert found.T_flange_camera[2, 3] == 0.0
    assert "flange_camera.z_mm" not in found.names


@pytest.mark.slow
@pytest.mark.parametrize("nominal", [SCARA, DOWNWARD], ids=["upward", "downward"])
def test_no_arm_is_mirrored_and_intervals_are_true(nominal: Chain) -> None:
    ratios = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        arm = built(rng, nominal=nominal)
        found = identify(measured(arm, free(rng), rng), nominal, folds=0)
        assert found.chain.joints[0].a_mm > 0.0
        assert found.chain.joints[1].a_mm > 0.0
        ratios.append(assert_true(found, truth(arm, nominal)))
    # 210 ratios: the standard deviation of their rms is .05, of seven that hang together no more than .13.
    assert 0.75 < math.sqrt(float(np.mean(np.square(ratios)))) < 1.25


@pytest.mark.slow
def test_methods_agree_and_lengths_are_positive_without_a_nominal() -> None:
    for seed in range(6):
        rng = np.random.default_rng(seed)
        arm = built(rng, 200.0)
        poses = measured(arm, sweeps(), rng)
        found, axes = identify(poses, folds=0), identify_from_axes(poses)
        assert_true(found, truth(arm, None))
        a, b = found.chain.as_array(), axes.chain.as_array()
        assert np.all(a[:2, 0] > 0.0)
        assert axes.T_flange_camera[2, 3] == pytest.approx(0.0, abs=0.05)
        off = (a - b)[:2, [0, 1, 3]] / stated(found)[:2, [0, 1, 3]]
        assert np.nanmax(np.abs(off)) < 6.0  # the axes' own errors are several times those of the global fit


@pytest.mark.parametrize("nominal", [KR5_ARC, None], ids=["nominal", "no nominal"])
@pytest.mark.parametrize(
    "seed", [0, pytest.param(1, marks=pytest.mark.slow), pytest.param(2, marks=pytest.mark.slow)]
)
def test_from_any_equal_description_the_same_result(seed: int, nominal: Chain | None) -> None:
    """Values, covariance, tool and base; of an arm with parallel, inclined and meeting axes."""
    rng = np.random.default_rng(seed)
    arm = kr5_arc(rng)
    poses = measure_poses(arm, angles(rng, free=10)[::2], rng)
    reversals = rng.integers(0, 2, 5).astype(np.bool_)
    reversals[seed] = True
    other = Chain.from_array(with_reversals(KR5_ARC.as_array(), reversals))
    plain, found = (identify(poses, nominal, start=start, folds=0) for start in (KR5_ARC, other))
    sigma = np.sqrt(np.diag(plain.covariance))
    assert found.names == plain.names
    off = found.chain.as_array() - plain.chain.as_array()
    assert np.nanmax(np.abs(off / stated(plain))) < 0.01
    np.testing.assert_allclose(found.covariance, plain.covariance, atol=0.02 * np.outer(sigma, sigma).max())
    assert found.correlation == pytest.approx(plain.correlation, abs=0.02)
    np.testing.assert_allclose(found.T_flange_camera, plain.T_flange_camera, atol=1e-3)
    np.testing.assert_allclose(found.T_target_base, plain.T_target_base, atol=1e-3)
    if nominal is None:
        joints = zip(found.chain.joints[:-1], found.joints[:-1], strict=True)
        assert all(
            one.a_mm > 0.0 or abs(one.a_mm) < 3.1 * (joint.standard_uncertainty["a_mm"] or 0.0)
            for one, joint in joints
        )
