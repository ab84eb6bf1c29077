"""Rigid motions in space: SO(3) and SE(3) by arrays.

`T_a_b` maps points given in frame b into frame a, so that adjacent frames cancel: T_a_c = T_a_b @ T_b_c.
Perturbations are on the left: R_true = exp(w) R. Angles in radians, lengths in mm.

References: R. M. Murray, Z. Li, S. S. Sastry, "A Mathematical Introduction to Robotic Manipulation", 1994,
ch. 2.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Bool, Float

from core.errors import InvalidArgument

MAX_NOT_ORTHONORMAL = 1e-6
"""Largest element of R Rᵀ - 1: a rotation written with seven digits passes, a scaled or mirrored matrix does not."""


def hat(w: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Return [w]×, so that hat(w) @ a = w × a."""
    x, y, z = w.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def perpendicular(axis: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Return some unit vector across a unit vector, the same one for directions near each other."""
    across = np.eye(3)[int(np.argmin(np.abs(axis)))]
    across = across - axis * (axis @ across)
    return np.asarray(across / np.linalg.norm(across))


def hats(vectors: Float[np.ndarray, "*b 3"]) -> Float[np.ndarray, "*b 3 3"]:
    """Return [v]× of every vector, as `hat` does of one."""
    K = np.zeros((*vectors.shape, 3))
    K[..., 2, 1], K[..., 0, 2], K[..., 1, 0] = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    return np.asarray(K - K.swapaxes(-1, -2))


def so3_exp(w: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Rotate by |w| rad about w (Rodrigues)."""
    x, y, z = float(w[0]), float(w[1]), float(w[2])
    square = x * x + y * y + z * z
    if square < 1e-12:  # series to order 4: exact in double precision below 1e-6 rad
        a, b = 1.0 - square / 6.0, 0.5 - square / 24.0
    else:
        angle = math.sqrt(square)
        a, b = math.sin(angle) / angle, (1.0 - math.cos(angle)) / square
    return np.array(
        [
            [1.0 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y],
            [b * x * y + a * z, 1.0 - b * (x * x + z * z), b * y * z - a * x],
            [b * x * z - a * y, b * y * z + a * x, 1.0 - b * (x * x + y * y)],
        ]
    )


def so3_log(rotation: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3"]:
    """Return the rotation vector w with exp(w) = R and |w| ≤ π; well conditioned from 0 up to π (by
    quaternion).
    """
    w, x, y, z = _quaternion(rotation)
    norm = math.sqrt(x * x + y * y + z * z)
    if norm < 1e-9:
        scale = 2.0 / w
    else:
        # w ≥ 0 by construction, so the angle is in [0, π].
        scale = 2.0 * math.atan2(norm, w) / norm
    return np.array([x * scale, y * scale, z * scale])


def rotation_vectors(
    rotations: Float[np.ndarray, "n 3 3"], about: Float[np.ndarray, "*n 3 3"]
) -> Float[np.ndarray, "n 3"]:
    """Return w with R_j = exp(w_j) R_about, rad, in the frame's axes; about one rotation, or each about its own."""
    relative = rotations @ about.swapaxes(-1, -2)
    axis = 0.5 * np.stack(
        [
            relative[:, 2, 1] - relative[:, 1, 2],
            relative[:, 0, 2] - relative[:, 2, 0],
            relative[:, 1, 0] - relative[:, 0, 1],
        ],
        axis=1,
    )
    sine = np.sqrt(np.einsum("ni,ni->n", axis, axis))
    cosine = 0.5 * (np.trace(relative, axis1=1, axis2=2) - 1.0)
    angle = np.arctan2(sine, cosine)
    # θ / sin θ → 1 + θ²/6 as θ → 0
    w = axis * np.where(sine > 1e-8, angle / np.maximum(sine, 1e-8), 1.0)[:, None]
    for j in np.flatnonzero(angle > 3.0):  # sin θ loses the axis near half a turn; such cycles are rare
        w[j] = so3_log(relative[j])
    return np.asarray(w)


def rotations_from_vectors(vectors: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 3"]:
    """Return exp(w) of each rotation vector, as `so3_exp` does of one."""
    x, y, z = vectors.T
    square = np.einsum("ni,ni->n", vectors, vectors)
    small = square < 1e-12
    angle = np.sqrt(np.where(small, 1.0, square))
    a = np.where(small, 1.0 - square / 6.0, np.sin(angle) / angle)
    b = np.where(small, 0.5 - square / 24.0, (1.0 - np.cos(angle)) / np.where(small, 1.0, square))
    R = np.empty((len(vectors), 3, 3))
    R[:, 0, 0], R[:, 1, 1], R[:, 2, 2] = (
        1.0 - b * (y * y + z * z),
        1.0 - b * (x * x + z * z),
        1.0 - b * (x * x + y * y),
    )
    R[:, 0, 1], R[:, 1, 0] = b * x * y - a * z, b * x * y + a * z
    R[:, 0, 2], R[:, 2, 0] = b * x * z + a * y, b * x * z - a * y
    R[:, 1, 2], R[:, 2, 1] = b * y * z - a * x, b * y * z + a * x
    return R


def rotations_about(
    direction: Float[np.ndarray, "*b 3"], angles: Float[np.ndarray, "*b n"]
) -> Float[np.ndarray, "*b n 3 3"]:
    """Return Rot(n, φ) of every angle (rad) about a direction of unit length, by Rodrigues' formula."""
    K = hats(direction)
    sine, versine = np.sin(angles)[..., None, None], 2.0 * np.sin(0.5 * angles)[..., None, None] ** 2
    return np.asarray(np.eye(3) + sine * K[..., None, :, :] + versine * (K @ K)[..., None, :, :])


def _quaternion(rotation: Float[np.ndarray, "3 3"]) -> tuple[float, float, float, float]:
    """Return the unit quaternion (w, x, y, z), w ≥ 0, by the largest of its four components (Shepperd)."""
    r = rotation
    trace = float(np.trace(r))
    candidates = [trace, float(r[0, 0]), float(r[1, 1]), float(r[2, 2])]
    largest = int(np.argmax(candidates))
    if largest == 0:
        q = np.array([1.0 + trace, r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
    else:
        i = largest - 1
        j, k = (i + 1) % 3, (i + 2) % 3
        q = np.empty(4)
        q[0] = r[k, j] - r[j, k]
        q[1 + i] = 1.0 + r[i, i] - r[j, j] - r[k, k]
        q[1 + j] = r[j, i] + r[i, j]
        q[1 + k] = r[k, i] + r[i, k]
    q /= np.linalg.norm(q)
    if q[0] < 0:
        q = -q
    return float(q[0]), float(q[1]), float(q[2]), float(q[3])


def transform(
    rotation: Float[np.ndarray, "3 3"], translation: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "4 4"]:
    """Return [[R, t], [0, 1]]."""
    T = np.zeros((4, 4))
    T[:3, :3] = rotation
    T[:3, 3] = translation
    T[3, 3] = 1.0
    return T


def compose(*transforms: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """Return the product of the given transforms, left to right."""
    T = np.eye(4)
    for factor in transforms:
        T = T @ factor
    return T


def invert(T_a_b: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """Return T_b_a."""
    rotation = T_a_b[:3, :3].T
    return transform(rotation, -rotation @ T_a_b[:3, 3])


def transform_points(
    T_a_b: Float[np.ndarray, "4 4"], points_b: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3"]:
    """Return the points of frame b in frame a."""
    return points_b @ T_a_b[:3, :3].T + T_a_b[:3, 3]


def perturbed(T: Float[np.ndarray, "4 4"], step: Float[np.ndarray, "6"]) -> Float[np.ndarray, "4 4"]:
    """Return T after a small motion (d, w) of its frame: t + d (mm), exp(w) R (rad)."""
    return transform(so3_exp(step[3:]) @ T[:3, :3], T[:3, 3] + step[:3])


def nearest_rotation(matrices: Float[np.ndarray, "*b 3 3"]) -> Float[np.ndarray, "*b 3 3"]:
    """Return the rotation nearest to each matrix in the Frobenius norm (orthogonal Procrustes)."""
    U, _, Vt = np.linalg.svd(matrices)
    R = U @ Vt
    mirrored = np.linalg.det(R) < 0.0
    if mirrored.any():
        U[mirrored, :, 2] *= -1.0
        R = U @ Vt
    return np.asarray(R)


def are_rotations(matrices: Float[np.ndarray, "n 3 3"]) -> Bool[np.ndarray, " n"]:
    """Return which of finite matrices are orthonormal and right-handed, to `MAX_NOT_ORTHONORMAL`."""
    off = np.abs(matrices @ matrices.swapaxes(1, 2) - np.eye(3)).max(axis=(1, 2), initial=0.0)
    return np.asarray((off < MAX_NOT_ORTHONORMAL) & (np.linalg.det(matrices) > 0.0))


def rotation_mean(rotations: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "3 3"]:
    """Return the Riemannian mean: the R with Σ log(Rᵢ Rᵀ) = 0.

    Raises InvalidArgument for no rotations.

    References: J. H. Manton, "A globally convergent numerical algorithm for computing the centre of mass on
    compact Lie groups", ICARCV 2004.
    """
    if len(rotations) == 0:
        raise InvalidArgument("A mean needs at least one rotation.")
    w = np.full(len(rotations), 1.0 / len(rotations))
    mean = nearest_rotation(np.tensordot(w, rotations, axes=1))
    for _ in range(50):
        step = w @ rotation_vectors(rotations, mean)
        mean = so3_exp(step) @ mean
        if step @ step < 1e-28:
            break
    return mean


def transform_mean(transforms: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "4 4"]:
    """Return the mean pose: rotation mean and mean of the positions, each by itself."""
    w = np.full(len(transforms), 1.0 / len(transforms))
    return transform(rotation_mean(transforms[:, :3, :3]), w @ transforms[:, :3, 3])
