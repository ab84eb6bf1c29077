"""Covariances of the camera on the flange and of targets in the base, against differences of the frames themselves."""

from __future__ import annotations

import numpy as np

from core.geometry.se3 import invert, so3_exp, so3_log, transform
from core.kinematics.arm_model import ArmState
from core.kinematics.frame_covariances import base_target_covariances, flange_camera_covariance
from core.simulation.arm import KR5_ARC

STEP = 1e-6


def arm_and_covariance() -> tuple[ArmState, np.ndarray]:
    rng = np.random.default_rng(3)
    frames = [transform(so3_exp(rng.normal(0.0, 1.0, 3)), rng.normal(0.0, 300.0, 3)) for _ in range(3)]
    arm = ArmState(KR5_ARC.as_array(), frames[0], np.array(frames[1:]), np.zeros(0))
    root = rng.normal(0.0, 1.0, (arm.layout.size, arm.layout.size))
    return arm, root @ root.T


def derivative(arm: ArmState, columns: slice, frame: object) -> np.ndarray:
    """How a frame's position and its rotation from the left change with steps of these columns."""
    J = np.zeros((6, 6))
    before = frame(arm)  # type: ignore[operator]
    for k, column in enumerate(range(columns.start, columns.stop)):
        step = np.zeros(arm.layout.size)
        step[column] = STEP
        after = frame(arm.moved(step))  # type: ignore[operator]
        J[:3, k] = (after[:3, 3] - before[:3, 3]) / STEP
        J[3:, k] = so3_log(after[:3, :3] @ before[:3, :3].T) / STEP
    return J


def test_the_covariances_are_those_of_the_frames() -> None:
    arm, covariance = arm_and_covariance()
    free = np.ones(arm.layout.size, dtype=np.bool_)
    tool = arm.layout.tool
    found = flange_camera_covariance(arm, free, covariance)
    assert found is not None
    J = derivative(arm, tool, lambda a: a.T_flange_camera)
    np.testing.assert_allclose(found, J @ covariance[tool, tool] @ J.T, rtol=1e-3, atol=1e-2)
    for target, of_base in enumerate(base_target_covariances(arm, free, covariance)):
        base = arm.layout.base(target)
        J = derivative(arm, base, lambda a, t=target: invert(a.T_target_base[t]))
        expected = J @ covariance[base, base] @ J.T
        assert of_base is not None
        scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
        np.testing.assert_allclose(of_base / scale, expected / scale, atol=1e-3)


def test_held_columns_have_no_covariance() -> None:
    arm, covariance = arm_and_covariance()
    free = np.ones(arm.layout.size, dtype=np.bool_)
    free[[0, arm.layout.tool.start + 4]] = False
    kept = covariance[np.ix_(free, free)]
    found, everything = (
        flange_camera_covariance(arm, *one) for one in ((free, kept), (free | True, covariance))
    )
    assert found is not None
    assert everything is not None
    assert not found[4].any()
    assert not found[:, 4].any()
    left = np.delete(np.arange(6), 4)
    assert np.array_equal(found[np.ix_(left, left)], everything[np.ix_(left, left)])
    free[arm.layout.tool] = False
    assert flange_camera_covariance(arm, free, covariance[np.ix_(free, free)]) is None
    free[arm.layout.tool] = True
    free[arm.layout.tool.start + 4] = False
    whole = base_target_covariances(arm, np.ones_like(free), covariance)
    for one, other in zip(base_target_covariances(arm, free, kept), whole, strict=True):
        assert one is not None
        assert other is not None
        np.testing.assert_allclose(one, other)
