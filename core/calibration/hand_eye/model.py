"""The two unknown frames, what they make of the measured poses, and how noise enters.

    T_base_flange = T_base_target @ T_target_camera @ T_camera_flange

Small motions of a frame are d (mm) and w (rad), t ← t + d, R ← exp(w) R, in this order.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from core.transforms import hat, so3_exp, so3_log, transform

SMALLEST_POSITION_MM, SMALLEST_ROTATION = 1e-3, 1e-6
"""Least standard deviations assumed of a robot: exact poses still need weights."""


@dataclass(frozen=True, slots=True)
class Frames:
    """The two unknowns."""

    T_flange_camera: Float[np.ndarray, "4 4"]
    T_base_target: Float[np.ndarray, "4 4"]

    def moved(self, step: Float[np.ndarray, "12"]) -> Frames:
        """Return the frames after small motions of T_flange_camera and of T_base_target."""
        moved = [
            transform(so3_exp(d[3:]) @ T[:3, :3], T[:3, 3] + d[:3])
            for T, d in zip((self.T_flange_camera, self.T_base_target), step.reshape(2, 6), strict=True)
        ]
        return Frames(moved[0], moved[1])

    def attained(self, T_target_camera: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n 4 4"]:
        """Return T_base_flange of measured poses."""
        return self.T_base_target @ T_target_camera @ np.linalg.inv(self.T_flange_camera)


@dataclass(frozen=True, slots=True)
class PoseArrays:
    """Commanded and measured poses, and covariances (zero where one is not known) of the measured ones."""

    T_base_flange: Float[np.ndarray, "n 4 4"]
    T_target_camera: Float[np.ndarray, "n 4 4"]
    covariance: Float[np.ndarray, "n 6 6"]

    def part(self, used: Bool[np.ndarray, " n"]) -> PoseArrays:
        return PoseArrays(self.T_base_flange[used], self.T_target_camera[used], self.covariance[used])


def residuals(frames: Frames, poses: PoseArrays) -> Float[np.ndarray, "n 6"]:
    """Return commanded - attained in the base frame: position (mm) and rotation vector (rad)."""
    attained = frames.attained(poses.T_target_camera)
    turned = poses.T_base_flange[:, :3, :3] @ attained[:, :3, :3].swapaxes(1, 2)
    position = poses.T_base_flange[:, :3, 3] - attained[:, :3, 3]
    return np.concatenate([position, np.array([so3_log(R) for R in turned])], axis=1)


def jacobian(frames: Frames, T_target_camera: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n 6 12"]:
    """Return d(position, rotation vector) of the attained flange by small motions of the frames.

    With R, p attained, those of T_flange_camera move it by -R d - R [t]× w and turn it by -R w; those of
    T_base_target by d - [p - t]× w and w.
    """
    attained = frames.attained(T_target_camera)
    R, from_target = attained[:, :3, :3], attained[:, :3, 3] - frames.T_base_target[:3, 3]
    J = np.zeros((len(R), 6, 12))
    J[:, :3, :3] = J[:, 3:, 3:6] = -R
    J[:, :3, 3:6] = -R @ hat(frames.T_flange_camera[:3, 3])
    J[:, :3, 6:9] = J[:, 3:, 9:] = np.eye(3)
    J[:, :3, 9:] = -hats(from_target)
    return J


def measurement_effect(
    frames: Frames, T_target_camera: Float[np.ndarray, "n 4 4"]
) -> Float[np.ndarray, "n 6 6"]:
    """Return what the measured pose's error (d, w; target frame) does to the attained flange (d, w; base frame)."""
    R_Z, T_X = frames.T_base_target[:3, :3], frames.T_flange_camera
    arm = T_target_camera[:, :3, :3] @ (-T_X[:3, :3].T @ T_X[:3, 3])
    G = np.zeros((len(arm), 6, 6))
    G[:, :3, :3] = G[:, 3:, 3:] = R_Z
    G[:, :3, 3:] = -R_Z @ hats(arm)
    return G


def measurement_covariance(frames: Frames, poses: PoseArrays) -> Float[np.ndarray, "n 6 6"]:
    """Return the covariance of the attained flange due to measurement, base frame."""
    G = measurement_effect(frames, poses.T_target_camera)
    return np.asarray(G @ poses.covariance @ G.swapaxes(1, 2))


def hats(vectors: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 3"]:
    """Return [v]× of every vector."""
    return np.array([hat(v) for v in vectors]).reshape(-1, 3, 3)


def whitening(V: Float[np.ndarray, "n m m"]) -> Float[np.ndarray, "n m m"]:
    """Return upper triangular W with W V Wᵀ = 1: the last rows see the last components alone."""
    lower = np.linalg.cholesky(V[:, ::-1, ::-1])
    return np.ascontiguousarray(np.linalg.inv(lower)[:, ::-1, ::-1])


def variance_components(
    y: Float[np.ndarray, "n m"],
    J: Float[np.ndarray, "n m p"],
    known: Float[np.ndarray, "n m m"],
    start: tuple[float, ...],
    smallest: tuple[float, ...],
    holding: Float[np.ndarray, "p p"] | None = None,
) -> tuple[float, ...]:
    """Estimate standard deviations s of y = J b + noise, V = known + diag(s1² 1, s2² 1, ...), three components each.

    Restricted maximum likelihood: with P = V⁻¹ - V⁻¹J C JᵀV⁻¹ and E the part of V that s² multiplies, the score
    vanishes where yᵀP E P y = tr(P E); s² is multiplied by their ratio until it stays. `holding` is the information on
    b from elsewhere.
    """
    squares, floor = np.square(start), np.square(smallest)
    for _ in range(200):
        V_inverse = np.linalg.inv(known + np.diag(np.repeat(squares, 3)))
        VJ = V_inverse @ J
        information = np.einsum("nij,nik->jk", J, VJ)
        C = np.linalg.pinv(information if holding is None else information + holding, hermitian=True)
        left = y - J @ (C @ np.einsum("nij,ni->j", VJ, y))
        Py = np.einsum("nij,nj->ni", V_inverse, left)
        P_diagonal = np.einsum("nii->ni", V_inverse) - np.einsum("nij,jk,nik->ni", VJ, C, VJ)
        size = len(squares)
        found = np.sum(Py**2, axis=0).reshape(size, 3).sum(axis=1)
        expected = np.sum(P_diagonal, axis=0).reshape(size, 3).sum(axis=1)
        former, squares = squares, np.maximum(squares * found / np.maximum(expected, 1e-300), floor)
        if np.allclose(squares, former, rtol=1e-4):
            break
    return tuple(math.sqrt(square) for square in squares)
