"""Pose accuracy (ISO 9283:1998, 7.2.1) in frames that the commanded poses themselves tie.

The frames follow every pose a little: with e_i what the robot is off at pose i and H the hat matrix of the tie, the
residuals are r = (I - H)(e + n), n being the noise of the mean poses. For deviations of one variance s² an axis the
residual is too short by √(1 - h_i), h_i = tr H_ii / 3, so that the figure is r_i / √(1 - h_i); of a pose that tied no
frames it is r_i / √(1 + h_i). Given the residuals,

    e_i ~ r_i + t_dof,     covariance s² H_ii + u² (I - H)_ii + A_i A_iᵀ,     s² = rᵀr / dof - u²,

dof = Σ (3 - tr H_ii), u² the variance of a mean an axis, A_i what the errors that all poses share (lens, scale and
shape of the print) leave in r_i. A pose that tied no frames has u² I. An interval of the length is that of the lengths
of draws of e_i. The part of e that moves all poses as one rigid body is in no residual: only a tie by other means
shows it.

References: D. A. Belsley, E. Kuh, R. E. Welsch, "Regression diagnostics", 1980, 10.1002/0471725153, 2.1 (leverage).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import ndtri, stdtrit

from core.geometry import GIMBAL_MARGIN, rotation_to_rpy, rpy_jacobian, so3_exp
from core.metrology.iso9283 import pose_accuracy
from core.metrology.pose_cycles import PerComponent
from core.metrology.rp_distribution import CONFIDENCE

MIN_FREE_SHARE = 1e-3
"""Of a pose's deviation: where the frames leave less of it, the pose's accuracy is not determined."""
MIN_DEGREES_OF_FREEDOM = 0.5
NORMAL_FACTOR = float(ndtri(0.5 + 0.5 * CONFIDENCE))
_DRAWS = 10_000
_SEED = 9283


@dataclass(frozen=True, slots=True)
class TiedDeviations:
    """Deviations attained - commanded of n poses after a tie, of positions (mm) or of rotation vectors (rad).

    `leverage` are the blocks H_ii, `common` A_i, `used` the poses that tied the frames; `mean_variance` is u².
    """

    residuals: Float[np.ndarray, "n 3"]
    leverage: Float[np.ndarray, "n 3 3"]
    common: Float[np.ndarray, "n 3 k"]
    used: Bool[np.ndarray, " n"]
    mean_variance: float

    @property
    def degrees_of_freedom(self) -> float:
        """3 - tr H_ii, summed over the poses that tied the frames."""
        return float(np.sum(3.0 - np.trace(self.leverage[self.used], axis1=1, axis2=2)))


@dataclass(frozen=True, slots=True)
class EstimatedDeviation:
    """What the robot was off at one pose: `vector`, studentised; None where the frames follow the pose wholly.

    `residual` is the centre of what is known of it, `own` (times t) and `shared` (normal) its covariance; `own` and
    `length_interval` are None where the tie leaves no degree of freedom. `factor` is half a 95 % interval of t.
    """

    vector: Float[np.ndarray, "3"] | None
    residual: Float[np.ndarray, "3"]
    own: Float[np.ndarray, "3 3"] | None
    shared: Float[np.ndarray, "3 3"]
    factor: float
    length_interval: tuple[float, float] | None

    def half_widths(self, J: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3"] | None:
        """Return half the 95 % intervals of J e; None where they are not known."""
        if self.own is None:
            return None
        own, shared = (np.sqrt(np.maximum(np.diag(J @ C @ J.T), 0.0)) for C in (self.own, self.shared))
        return np.hypot(self.factor * own, NORMAL_FACTOR * shared)


def estimate_deviations(tied: TiedDeviations) -> list[EstimatedDeviation]:
    """Return what the robot was off at each pose, with intervals at `CONFIDENCE`."""
    dof = tied.degrees_of_freedom
    H = 0.5 * (tied.leverage + np.swapaxes(tied.leverage, 1, 2))
    rng = np.random.default_rng(_SEED)
    normal, others = rng.standard_normal((2, _DRAWS, 3))
    variance, student, factor = None, normal, 0.0
    if dof >= MIN_DEGREES_OF_FREEDOM:
        squares = float(np.sum(tied.residuals[tied.used] ** 2))
        variance = max(squares / dof - tied.mean_variance, 0.0)
        student = normal / np.sqrt(rng.chisquare(dof, _DRAWS) / dof)[:, None]
        factor = float(stdtrit(dof, 0.5 + 0.5 * CONFIDENCE))
    found = []
    for r, Hi, A, used in zip(tied.residuals, H, tied.common, tied.used.tolist(), strict=True):
        sign = -1.0 if used else 1.0
        free = 1.0 + sign * float(np.trace(Hi)) / 3.0
        shared = A @ A.T
        vector = r / math.sqrt(free) if free >= MIN_FREE_SHARE else None
        if variance is None or vector is None:
            found.append(EstimatedDeviation(vector, r, None, shared, factor, None))
            continue
        own = variance * Hi + tied.mean_variance * (np.eye(3) - (Hi if used else 0.0))
        lengths = np.linalg.norm(r + student @ _root(own).T + others @ _root(shared).T, axis=1)
        found.append(EstimatedDeviation(vector, r, own, shared, factor, _quantiles(lengths)))
    return found


@dataclass(frozen=True, slots=True)
class PoseAccuracy:
    """AP of one pose, mm and rad.

    `figures` are the studentised best-fit ones, `interval` theirs, `held_out` those with the frames tied by all other
    poses. `rotation` is the deviation of orientation as a rotation vector in the base frame; where `near_singularity`,
    within 5° of pitch = ±90°, it alone is given and the angles, which mean nothing there, are None.
    `degrees_of_freedom` are those of the positions' tie.
    """

    figures: PerComponent[float | None]
    interval: PerComponent[tuple[float, float] | None]
    held_out: PerComponent[float | None]
    rotation: Float[np.ndarray, "3"] | None
    near_singularity: bool
    degrees_of_freedom: float


@dataclass(frozen=True, slots=True)
class HeldOutDeviation:
    """Attained - commanded with the frames tied by the other poses: position (mm), rotation vector (rad) or None."""

    position_mm: Float[np.ndarray, "3"]
    rotation: Float[np.ndarray, "3"] | None = None


def tied_accuracy(
    position: EstimatedDeviation,
    rotation: EstimatedDeviation | None,
    commanded_rotation: Float[np.ndarray, "3 3"] | None,
    held_out: HeldOutDeviation | None,
    degrees_of_freedom: float,
) -> PoseAccuracy | None:
    """Return AP of one pose from what the robot was off there; None where its position is not determined."""
    if position.vector is None:
        return None
    singular = commanded_rotation is not None and (
        abs(float(rotation_to_rpy(commanded_rotation)[1])) > 0.5 * math.pi - GIMBAL_MARGIN
    )
    turned = rotation.vector if rotation is not None else None
    angles = None if singular else commanded_rotation
    intervals: list[tuple[float, float] | None] = [position.length_interval]
    intervals += _intervals(position.residual, position.half_widths(np.eye(3)))
    if rotation is None or turned is None or angles is None:
        intervals += [None] * 3
    else:
        J = rpy_jacobian(rotation_to_rpy(angles))
        intervals += _intervals(J @ rotation.residual, rotation.half_widths(J))
    return PoseAccuracy(
        _figures(position.vector, turned, angles),
        PerComponent(*intervals),
        PerComponent(*[None] * len(intervals))
        if held_out is None
        else _figures(held_out.position_mm, held_out.rotation, angles),
        turned,
        singular and turned is not None,
        degrees_of_freedom,
    )


def _figures(
    position: Float[np.ndarray, "3"],
    turn: Float[np.ndarray, "3"] | None,
    commanded: Float[np.ndarray, "3 3"] | None,
) -> PerComponent[float | None]:
    if turn is None or commanded is None:
        return pose_accuracy(position, np.zeros(3))
    return pose_accuracy(position, np.zeros(3), so3_exp(turn) @ commanded, commanded)


def _intervals(
    centre: Float[np.ndarray, "3"], half: Float[np.ndarray, "3"] | None
) -> list[tuple[float, float] | None]:
    if half is None:
        return [None] * 3
    return [(float(a - b), float(a + b)) for a, b in zip(centre, half, strict=True)]


def _quantiles(lengths: Float[np.ndarray, " n"]) -> tuple[float, float]:
    low, high = np.quantile(lengths, [0.5 - 0.5 * CONFIDENCE, 0.5 + 0.5 * CONFIDENCE])
    return float(low), float(high)


def _root(covariance: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
