"""The compiled pass against its twin in numpy and against differences."""

from __future__ import annotations

import numpy as np

from core.geometry.se3 import perturbed, so3_exp, so3_log, transform
from core.kinematics.dh import Chain, chain_frames, forward, pose_with_jacobian
from core.kinematics.global_fit import whitened


def drawn(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    parameters = rng.normal(0.0, 1.0, (6, 5)) * [300.0, 1.0, 300.0, 1.0, 0.3]
    bases = np.array(
        [transform(so3_exp(rng.normal(0.0, 1.0, 3)), rng.normal(0.0, 500.0, 3)) for _ in range(5)]
    )
    tool = transform(so3_exp(rng.normal(0.0, 1.0, 3)), rng.normal(0.0, 100.0, 3))
    return parameters, rng.uniform(-3.0, 3.0, (5, 6)), bases, tool


def twin(
    parameters: np.ndarray, joint_angles: np.ndarray, T_target_base: np.ndarray, T_flange_camera: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    count, joints = joint_angles.shape
    T = T_target_base[:, None] @ chain_frames(parameters, joint_angles)
    end = T[:, -1] @ T_flange_camera
    position = end[:, :3, 3]
    J = np.zeros((5 * joints + 12, 6, count))

    def turned(row: int, axis: np.ndarray, origin: np.ndarray) -> None:
        J[row, :3] = np.cross(axis, position - origin).T
        J[row, 3:] = axis.T

    for i in range(joints):
        before, after = T[:, i], T[:, i + 1]
        angle = joint_angles[:, i] + parameters[i, 3]
        x = np.cos(angle)[:, None] * before[:, :3, 0] + np.sin(angle)[:, None] * before[:, :3, 1]
        J[5 * i, :3] = x.T
        turned(5 * i + 1, x, after[:, :3, 3])
        J[5 * i + 2, :3] = before[:, :3, 2].T
        turned(5 * i + 3, before[:, :3, 2], before[:, :3, 3])
        turned(5 * i + 4, after[:, :3, 1], after[:, :3, 3])
    tool, base = 5 * joints, 5 * joints + 6
    for k in range(3):
        J[tool + k, :3] = J[tool + 3 + k, 3:] = T[:, -1, :3, k].T
        J[base + k, k] = 1.0
        turned(base + 3 + k, np.broadcast_to(np.eye(3)[k], (count, 3)), T_target_base[:, :3, 3])
    return end, J


def test_the_kernel_gives_its_twins_numbers() -> None:
    given = drawn(5)
    for ours, theirs in zip(pose_with_jacobian(*given), twin(*given), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=1e-9)


def test_the_pose_is_base_chain_and_tool_in_a_row() -> None:
    parameters, q, bases, tool = drawn(6)
    end, _ = pose_with_jacobian(parameters, q, bases, tool)
    np.testing.assert_allclose(end, bases @ forward(Chain.from_array(parameters), q) @ tool, atol=1e-9)


def test_the_jacobian_is_the_difference_quotient() -> None:
    parameters, q, bases, tool = drawn(7)
    _, J = pose_with_jacobian(parameters, q, bases, tool)

    def moved(step: np.ndarray) -> np.ndarray:
        return pose_with_jacobian(
            parameters + step[:30].reshape(6, 5),
            q,
            np.array([perturbed(T, step[36:]) for T in bases]),
            perturbed(tool, step[30:36]),
        )[0]

    for column in range(len(J)):
        h = np.zeros(len(J))
        h[column] = 1e-5
        plus, minus = moved(h), moved(-h)
        p = (plus[:, :3, 3] - minus[:, :3, 3]) / 2e-5
        w = [so3_log(a[:3, :3] @ b[:3, :3].T) / 2e-5 for a, b in zip(plus, minus, strict=True)]
        np.testing.assert_allclose(J[column].T, np.hstack([p, np.array(w)]), rtol=1e-5, atol=2e-5)


def test_residuals_and_derivatives_are_weighted_pose_by_pose() -> None:
    rng = np.random.default_rng(7)
    for m, columns, poses in ((6, 4, 5), (3, 2, 1), (6, 3, 0)):
        W = np.tril(rng.normal(0.0, 1.0, (poses, m, m))).transpose(1, 2, 0)
        rows = rng.normal(0.0, 1.0, (columns, m, poses))
        np.testing.assert_allclose(whitened(W, rows), np.einsum("abn,pbn->pan", W, rows), atol=1e-12)
        np.testing.assert_allclose(whitened(W, rows[0]), np.einsum("abn,bn->an", W, rows[0]), atol=1e-12)
