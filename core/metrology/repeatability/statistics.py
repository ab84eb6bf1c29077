"""Mean pose and covariance of a pose's cycles, and the covariance of the instrument's noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from core.metrology.iso9283 import deviations, position_repeatability
from core.metrology.pose_cycles import PoseCycles, angles_from_vectors, mean_and_vectors
from core.metrology.repeatability.intervals import noise_only_lengths


@dataclass(frozen=True, slots=True)
class CycleStatistics:
    """Moments of n cycles; six columns are x, y, z, roll, pitch, yaw; mm and rad.

    `vectors` are the rotation vectors about the mean, `reading` is RP_l, `variance` and `covariance` (of the position)
    have the divisor n - 1. `noise`, `noise_square`, `noise_covariance` are means over the cycles of the measurements'
    variances, their squares and their position covariances, `trace_excess` the variance of tr M_j, `still` what
    `noise_only_lengths` gives. Scatter is zero for one cycle.
    """

    cycles: PoseCycles
    mean_position: Float[np.ndarray, "3"]
    mean_rotation: Float[np.ndarray, "3 3"] | None
    vectors: Float[np.ndarray, "n 3"] | None
    reading: float
    variance: Float[np.ndarray, "6"]
    covariance: Float[np.ndarray, "3 3"]
    noise: Float[np.ndarray, "6"]
    noise_square: Float[np.ndarray, "6"]
    noise_covariance: Float[np.ndarray, "3 3"]
    trace_excess: float
    still: tuple[float, float]


def cycle_statistics(cycles: PoseCycles) -> CycleStatistics:
    """Return the mean pose and the moments about it."""
    n = len(cycles)
    mean = cycles.positions_mm.mean(axis=0)
    about = np.zeros((n, 6))
    about[:, :3] = deviations(cycles.positions_mm)
    rotation = vectors = None
    to_angles = np.eye(3)
    if cycles.rotations is not None:
        rotation, vectors = mean_and_vectors(cycles.rotations)
        to_angles = angles_from_vectors(rotation)
        about[:, 3:] = deviations(vectors, size=1.0) @ to_angles.T
    noise, noise_square, noise_covariance = np.zeros(6), np.zeros(6), np.zeros((3, 3))
    excess, still = 0.0, (0.0, 0.0)
    if cycles.covariances is not None:
        position, turning = cycles.covariances[:, :3, :3], cycles.covariances[:, 3:, 3:]
        variances = np.empty((n, 6))
        variances[:, :3] = np.einsum("nii->ni", position)
        variances[:, 3:] = np.einsum("nij,ij->ni", to_angles @ turning, to_angles)
        noise, noise_square = variances.mean(axis=0), np.mean(variances * variances, axis=0)
        noise_covariance = position.mean(axis=0)
        excess = float(np.var(variances[:, :3].sum(axis=1)))
        still = noise_only_lengths(position) if n > 1 else still
    return CycleStatistics(
        cycles,
        mean,
        rotation,
        vectors,
        position_repeatability(cycles.positions_mm) if n > 1 else 0.0,
        np.einsum("ni,ni->i", about, about) / max(n - 1, 1),
        about[:, :3].T @ about[:, :3] / max(n - 1, 1),
        noise,
        noise_square,
        noise_covariance,
        excess,
        still,
    )
