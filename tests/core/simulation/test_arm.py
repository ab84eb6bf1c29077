"""The simulated arm: frames that cancel, noise of the size that it states."""

from __future__ import annotations

import math

import numpy as np
import pytest

from core.geometry.se3 import so3_log, transform
from core.kinematics.dh import forward
from core.simulation import KR5_ARC, KR5_ARC_HOME, KR5_ARC_LIMITS, free_angles, kr5_arc, sweep_angles
from core.simulation.arm import joint_motions, reach
from tests.support.simulation.simulated_poses import Repeatability, camera_noise, measure_poses

ARM = kr5_arc(np.random.default_rng(0))
ANGLES = np.tile(sweep_angles(KR5_ARC_HOME, steps=3), (40, 1))


def test_frames_cancel() -> None:
    angles = free_angles(np.random.default_rng(1), KR5_ARC_HOME, 4)
    target = np.array([0, 1, 1, 0])
    found = ARM.camera_poses(angles, target)
    for T, q, t in zip(found, angles, target, strict=True):
        np.testing.assert_allclose(
            T, ARM.T_target_base[t] @ forward(ARM.chain, q[None])[0] @ ARM.T_flange_camera
        )


def test_it_is_nearly_the_nominal_and_within_its_limits() -> None:
    off = ARM.chain.as_array() - KR5_ARC.as_array()
    assert 0.1 < np.abs(off[:, [0, 2]]).max() < 1.5
    assert 0.005 < math.degrees(np.abs(off[:, [1, 3]]).max()) < 0.15
    assert np.count_nonzero(off[:, 4]) == 1  # only between the axes that are meant to be parallel
    swept = sweep_angles(KR5_ARC_HOME)
    assert np.all((swept >= KR5_ARC_LIMITS[:, 0]) & (swept <= KR5_ARC_LIMITS[:, 1]))
    assert swept.shape == (66, 6)
    z = [ARM.T_target_base[t, :3, :3].T[:, 2] for t in (0, 1)]
    assert abs(z[0] @ z[1]) < 1e-9  # mutually perpendicular


@pytest.mark.parametrize("target", [0, 1])
def test_joints_move_the_camera_as_differences_say(target: int) -> None:
    h = 1e-5
    T, motions = joint_motions(ARM, KR5_ARC_HOME, target)
    which = np.full(6, target)
    np.testing.assert_allclose(T, ARM.camera_poses(KR5_ARC_HOME[None], which[:1])[0], atol=1e-9)
    before, after = (ARM.camera_poses(KR5_ARC_HOME + s * h * np.eye(6), which) for s in (-1.0, 1.0))
    np.testing.assert_allclose(motions[:3], (after - before)[:, :3, 3].T / (2.0 * h), atol=1e-5)
    turns = [so3_log(R @ S.T) for R, S in zip(after[:, :3, :3], before[:, :3, :3], strict=True)]
    np.testing.assert_allclose(motions[3:], np.array(turns).T / (2.0 * h), atol=1e-9)


@pytest.mark.parametrize("target", [0, 1])
def test_reach_is_the_inverse_of_forward(target: int) -> None:
    angles = KR5_ARC_HOME + np.radians([8.0, -6.0, 5.0, 12.0, -9.0, 20.0])
    T = ARM.camera_poses(angles[None], np.array([target]))[0]
    found = reach(ARM, T, KR5_ARC_HOME, target, within_mm=1e-9)
    assert found is not None
    np.testing.assert_allclose(found, angles, atol=1e-9)
    roughly = reach(ARM, T, KR5_ARC_HOME, target)
    assert roughly is not None
    np.testing.assert_allclose(roughly, angles, atol=1e-7)


def test_what_is_too_far_or_too_many_steps_away_is_not_reached() -> None:
    T = ARM.camera_poses(KR5_ARC_HOME[None])[0]
    assert reach(ARM, transform(T[:3, :3], T[:3, 3] + 5000.0), KR5_ARC_HOME) is None
    turned = ARM.camera_poses(KR5_ARC_HOME[None] + 0.25)[0]
    assert reach(ARM, turned, KR5_ARC_HOME, steps=1) is None
    assert reach(ARM, turned, KR5_ARC_HOME) is not None


@pytest.mark.parametrize("estimator", ["pooled", "per_image", "given"])
def test_noise_is_as_stated(estimator: str) -> None:
    poses = measure_poses(ARM, ANGLES, np.random.default_rng(2), estimator=estimator)
    T = ARM.camera_poses(ANGLES)
    assert poses.rotations is not None
    assert poses.covariance is not None
    turns = [so3_log(R @ S.T) for R, S in zip(poses.rotations, T[:, :3, :3], strict=True)]
    errors = np.hstack([poses.positions_mm - T[:, :3, 3], np.array(turns)])
    if poses.common is not None:  # one draw for all: what is left once it is fitted
        whitener = np.linalg.inv(np.linalg.cholesky(poses.covariance))
        C = (whitener @ poses.common).reshape(-1, 9)
        flat = np.einsum("nij,nj->ni", whitener, errors).ravel()
        drawn = np.linalg.solve(np.eye(9) + C.T @ C, C.T @ flat)
        assert np.abs(drawn).max() < 4.0
        errors = errors - poses.common @ drawn
    square = np.einsum("ni,nij,nj->n", errors, np.linalg.inv(poses.covariance), errors)
    # 720 poses of six numbers: 2.2 % of the mean; three of those.
    assert np.mean(square) / 6.0 == pytest.approx(1.0, abs=0.065)


def test_the_camera_is_as_good_as_published() -> None:
    """Camera position, in mm, at 30° and .05 px: .89 a lens for each image, .018 intrinsics known."""
    turns = np.tile(np.eye(3), (24, 1, 1))
    for estimator, least, most in (("per_image", 0.7, 1.3), ("given", 0.014, 0.025)):
        covariance, _ = camera_noise(turns, estimator=estimator)
        position = math.sqrt(float(np.trace(covariance[:, :3, :3].mean(axis=0))))
        assert least < position < most


def test_the_robots_own_scatter() -> None:
    rng = np.random.default_rng(3)
    scattered = measure_poses(ARM, ANGLES, rng, estimator="exact", robot=Repeatability(0.1, 1e-4))
    T = ARM.camera_poses(ANGLES)
    assert scattered.rotations is not None
    # 2,160 numbers each: 1.5 % of a standard deviation; three of those.
    assert np.std(scattered.positions_mm - T[:, :3, 3]) == pytest.approx(0.1, rel=0.05)
    turns = [so3_log(R @ S.T) for R, S in zip(scattered.rotations, T[:, :3, :3], strict=True)]
    assert np.std(turns) == pytest.approx(1e-4, rel=0.05)
    by_joints = measure_poses(ARM, ANGLES, rng, estimator="exact", robot=Repeatability(joint_rad=1e-4))
    # Each joint's turn moves the camera by its lever: .1 mm at a metre.
    assert 0.02 < np.std(by_joints.positions_mm - T[:, :3, 3]) < 0.15


def test_an_unknown_estimator_is_an_error() -> None:
    with pytest.raises(ValueError, match="zhang"):
        camera_noise(np.eye(3)[None], estimator="zhang")
