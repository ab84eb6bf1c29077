"""Deviations of commanded poses from attained ones, as fitted and with the frames estimated from the other poses.

Without station i the information is C⁻¹ - JᵀV⁻¹J, and to first order its residual (1 - J C JᵀV⁻¹)⁻¹ e.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from core.calibration.hand_eye.model import (
    Frames,
    PoseArrays,
    jacobian,
    measurement_effect,
    pose_variances,
    residuals,
)
from core.calibration.hand_eye.result import HandEyeObservation, PoseResidual
from core.errors import InvalidArgument
from core.numerics import Variances

MIN_EIGENVALUE = 1e-3
"""Of 1 - J C JᵀV⁻¹: below it the other stations do not determine the frames."""


@dataclass(frozen=True, slots=True)
class FramesFit:
    """A fit over the stations used: frames, covariance of their motions, the robot's variances."""

    frames: Frames
    covariance: Float[np.ndarray, "p p"]
    robot: Variances


def held_out_factors(
    J: Float[np.ndarray, "n m p"],
    covariance: Float[np.ndarray, "p p"],
    V: Float[np.ndarray, "n m m"],
    used: Bool[np.ndarray, " n"],
) -> list[Float[np.ndarray, "m m"] | None]:
    """Return 1 - J C JᵀV⁻¹ of every station, the unit matrix of one that was not used; None where the others do not
    determine the fit.
    """
    m = V.shape[1]
    factors: list[Float[np.ndarray, "m m"] | None] = []
    for i, counts in enumerate(used):
        left = np.eye(m) - (J[i] @ covariance @ J[i].T @ np.linalg.inv(V[i]) if counts else 0.0)
        determined = float(np.min(np.abs(np.linalg.eigvals(left)))) > MIN_EIGENVALUE
        factors.append(left if determined else None)
    return factors


@dataclass(frozen=True, slots=True)
class SharedErrors:
    """Effect of the k errors that all stations share on the frames, and on each attained pose with these frames."""

    frames: Float[np.ndarray, "p k"]
    attained: Float[np.ndarray, "n 6 k"]

    @classmethod
    def of(
        cls,
        found: FramesFit,
        stations: Sequence[HandEyeObservation],
        poses: PoseArrays,
        used: Bool[np.ndarray, " n"],
    ) -> SharedErrors:
        """Attained poses move by G c, the frames by the least squares answer to that."""
        moved = shared_motions(found.frames, stations, poses)
        J = jacobian(found.frames, poses.T_target_camera, poses.target)
        weighted = np.linalg.inv(pose_variances(found.frames, poses, found.robot)) @ moved
        frames = -found.covariance @ np.einsum("nij,nik->jk", J[used], weighted[used])
        return cls(frames, moved + J @ frames)


def shared_motions(
    frames: Frames, stations: Sequence[HandEyeObservation], poses: PoseArrays
) -> Float[np.ndarray, "n 6 k"]:
    """Return what one standard uncertainty of each error that all stations share does to the attained poses."""
    given = [s.common for s in stations]
    sizes = {0 if c is None else c.shape[1] for c in given}
    if len(sizes) != 1:
        raise InvalidArgument("All stations must share the same errors, or none.")
    if sizes == {0}:
        return np.zeros((len(given), 6, 0))
    return np.asarray(measurement_effect(frames, poses.T_target_camera, poses.target) @ np.array(given))


def deviations_of(
    found: FramesFit,
    shared: SharedErrors,
    stations: Sequence[HandEyeObservation],
    poses: PoseArrays,
    used: Bool[np.ndarray, " n"],
) -> tuple[PoseResidual, ...]:
    """Return every station's deviation, as fitted and held out."""
    e = residuals(found.frames, poses)
    J = jacobian(found.frames, poses.T_target_camera, poses.target)
    V = pose_variances(found.frames, poses, found.robot)
    results = []
    lefts = held_out_factors(J, found.covariance, V, used)
    for i, (station, left) in enumerate(zip(stations, lefts, strict=True)):
        leverage = J[i] @ found.covariance @ J[i].T @ np.linalg.inv(V[i])
        position = rotation = None
        if left is not None:
            held_out = np.linalg.solve(left, e[i])
            position, rotation = -held_out[:3], -held_out[3:]
        results.append(
            PoseResidual(
                station.pose_id,
                -e[i, :3],
                -e[i, 3:],
                position,
                rotation,
                bool(used[i]),
                leverage,
                shared.attained[i],
            )
        )
    return tuple(results)
