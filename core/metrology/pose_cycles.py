"""Cycles of one commanded pose, checked once on entry; names of its figures; scatter of orientation.

Figures: ISO 9283:1998 defines those of the position as a whole (AP_p 7.2.1, RP_l 7.2.2, vAP_p 7.2.3) and of the angles
(RP_a, RP_b, RP_c and so on, ibidem); figures along the axes are given in addition, by the angles' formula.

Scatter of orientation: rotation vectors about the mean, mapped to roll, pitch and yaw. These angles are coordinates
that fail at pitch = ±90°; the rotation vectors w_j = log(R_j R̄ᵀ) about the mean R̄ do not. Statistics therefore run on
w and are mapped to the angles by their derivative at the mean, δ(roll, pitch, yaw) = J w, which agrees with the
statistics of the angles themselves to second order in the scatter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Generic, TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int

from core.errors import InvalidArgument
from core.geometry import (
    are_rotations,
    nearest_rotation,
    rotation_to_rpy,
    rotation_vectors,
    rpy_jacobian,
    so3_exp,
)

_SEMIDEFINITE = 1e-9  # relative to the largest eigenvalue: what writing and reading a covariance costs
LARGEST_MM = 1e9
"""No robot reaches so far (a thousand km); fourth powers of what lies within are still far from the end of floats."""
LARGEST_RAD = 1e3
"""An angle is unknown long before its uncertainty is so large."""


@dataclass(frozen=True, slots=True)
class PoseCycles:
    """All visits to one commanded pose, in the order they were made, whatever instrument measured them.

    Parameters
    ----------
    positions_mm
        One row a cycle, in one frame.
    rotations
        Orientation in the same frame, or None where the instrument gives positions alone.
    covariances
        Of each measurement: (x, y, z in mm, then a small rotation w in rad with R_true = exp(w) R_measured, all in
        that frame). What counts for repeatability is the part that differs from cycle to cycle: for a camera take
        the *conditional* covariance, intrinsics held, because an error of the lens is common to all cycles of a pose
        and leaves with the mean. None: nothing is known of the instrument.

    Raises InvalidArgument, naming the cycle (counted from 1), where a value is not finite or absurd (`LARGEST_MM`,
    `LARGEST_RAD`), a rotation is not orthonormal and right-handed, or a covariance is not symmetric and positive
    semidefinite; and where there are not as many rotations or covariances as positions.
    """

    positions_mm: Float[np.ndarray, "n 3"]
    rotations: Float[np.ndarray, "r 3 3"] | None = None
    covariances: Float[np.ndarray, "c 6 6"] | None = None

    def __post_init__(self) -> None:
        if len(self.positions_mm) == 0:
            raise InvalidArgument(
                "A pose needs at least one cycle.", "Exclude poses that were never measured."
            )
        _require(np.isfinite(self.positions_mm).all(axis=1), "a position that is not finite")
        _require(
            (np.abs(self.positions_mm) <= LARGEST_MM).all(axis=1),
            f"a position more than {LARGEST_MM:.0e} mm from the origin",
        )
        if self.rotations is not None:
            self._same_length(self.rotations, "rotations")
            _require(np.isfinite(self.rotations).all(axis=(1, 2)), "a rotation that is not finite")
            _require(are_rotations(self.rotations), "a matrix that is no rotation")
        if self.covariances is not None:
            self._same_length(self.covariances, "covariances")
            _require(np.isfinite(self.covariances).all(axis=(1, 2)), "a covariance that is not finite")
            variance = np.diagonal(self.covariances, axis1=1, axis2=2)
            limit = np.array([LARGEST_MM**2] * 3 + [LARGEST_RAD**2] * 3)
            _require(
                np.asarray((variance <= limit).all(axis=1)),
                f"a standard uncertainty above {LARGEST_MM:.0e} mm or {LARGEST_RAD:.0e} rad",
            )
            _require(
                _semidefinite(self.covariances), "a covariance that is not symmetric positive semidefinite"
            )

    def __len__(self) -> int:
        return len(self.positions_mm)

    def take(self, cycles: Int[np.ndarray, " k"]) -> PoseCycles:
        """Return the cycles of these indices alone."""
        return PoseCycles(
            self.positions_mm[cycles],
            None if self.rotations is None else self.rotations[cycles],
            None if self.covariances is None else self.covariances[cycles],
        )

    def _same_length(self, values: np.ndarray, name: str) -> None:
        if len(values) != len(self.positions_mm):
            raise InvalidArgument(
                f"There are {len(self.positions_mm)} positions and {len(values)} {name}; each cycle needs both."
            )


def _require(passes: Bool[np.ndarray, " n"], what: str) -> None:
    if not passes.all():
        cycle = int(np.argmin(passes)) + 1
        raise InvalidArgument(f"Cycle {cycle} has {what}.", "Correct this cycle, or leave it out and say so.")


def _semidefinite(covariances: Float[np.ndarray, "n 6 6"]) -> Bool[np.ndarray, " n"]:
    # mm² and rad² differ by orders of magnitude, so the test runs on correlations.
    variance = np.diagonal(covariances, axis1=1, axis2=2)
    scale = np.sqrt(np.where(variance > 0.0, variance, 1.0))
    correlation = covariances / (scale[:, :, None] * scale[:, None, :])
    symmetric = np.abs(correlation - correlation.transpose(0, 2, 1)).max(axis=(1, 2)) < 1e-6
    about_symmetric = (correlation + correlation.transpose(0, 2, 1)) / 2.0
    try:  # a fifth of the time of eigenvalues, which say where the trouble is
        np.linalg.cholesky(about_symmetric + _SEMIDEFINITE * 6.0 * np.eye(6))
        positive = np.ones(len(covariances), dtype=np.bool_)
    except np.linalg.LinAlgError:
        positive = np.linalg.eigvalsh(about_symmetric)[:, 0] > -_SEMIDEFINITE * 6.0
    return np.asarray((variance >= 0.0).all(axis=1) & symmetric & positive)


T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class PerComponent(Generic[T]):
    """One value for the position as a whole, one an axis, one a rotation angle; mm and rad."""

    position_mm: T
    x_mm: T
    y_mm: T
    z_mm: T
    roll: T
    pitch: T
    yaw: T

    def items(self) -> list[tuple[str, T]]:
        """Return (name, value), in the order above."""
        return [(field.name, getattr(self, field.name)) for field in fields(self)]


COMPONENTS = tuple(field.name for field in fields(PerComponent))


def as_triple(values: Float[np.ndarray, "3"]) -> tuple[float, float, float]:
    """Return three numbers as plain ones."""
    return float(values[0]), float(values[1]), float(values[2])


UNKNOWN_ANGLE = math.pi / math.sqrt(3.0)
"""Standard deviation of an angle of which nothing is known (uniform over a turn), rad: no angle scatters more."""


def mean_and_vectors(
    rotations: Float[np.ndarray, "n 3 3"],
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "n 3"]]:
    """Return the R̄ with Σ log(R_j R̄ᵀ) = 0, as `core.geometry.se3.rotation_mean` does, and those logarithms."""
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
