"""Scatter of orientation: rotation vectors about the mean, and what they are as roll, pitch and yaw.

Roll, pitch and yaw are coordinates that fail at pitch = ±90°; the rotation vectors w_j = log(R_j R̄ᵀ) about the mean
R̄ do not. Statistics therefore run on w and are mapped to the angles by their derivative at the mean,
δ(roll, pitch, yaw) = J w, which agrees with the statistics of the angles themselves to second order in the scatter.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from core.transforms import nearest_rotation, rotation_to_rpy, rotation_vectors, rpy_jacobian, so3_exp

UNKNOWN_ANGLE = math.pi / math.sqrt(3.0)
"""Standard deviation of an angle of which nothing is known (uniform over a turn), rad: no angle scatters more."""


def mean_and_vectors(
    rotations: Float[np.ndarray, "n 3 3"],
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "n 3"]]:
    """Return the R̄ with Σ log(R_j R̄ᵀ) = 0, as `core.transforms.rotation_mean` does, and those logarithms."""
    mean = nearest_rotation(rotations.mean(axis=0))
    for _ in range(50):
        vectors = rotation_vectors(rotations, mean)
        step = vectors.mean(axis=0)
        if step @ step < 1e-28:
            break
        mean = so3_exp(step) @ mean
    return mean, vectors


def angles_from_vectors(mean: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
    """Return J: small changes of (roll, pitch, yaw) at the mean are J w."""
    return rpy_jacobian(rotation_to_rpy(mean))


def angles_about_mean(
    rotations: Float[np.ndarray, "n 3 3"], mean: Float[np.ndarray, "3 3"]
) -> Float[np.ndarray, "n 3"]:
    """Return roll, pitch, yaw of each cycle less those of the mean, each taken to (-π, π]: the standard's own way."""
    pitch_cosine = np.hypot(rotations[:, 0, 0], rotations[:, 1, 0])
    angles = np.stack(
        [
            np.arctan2(rotations[:, 2, 1], rotations[:, 2, 2]),
            np.arctan2(-rotations[:, 2, 0], pitch_cosine),
            np.arctan2(rotations[:, 1, 0], rotations[:, 0, 0]),
        ],
        axis=1,
    )
    difference = angles - rotation_to_rpy(mean)
    return np.asarray(np.pi - np.mod(np.pi - difference, 2.0 * np.pi))
