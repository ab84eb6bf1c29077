"""What a robot was off at each pose, in frames that the commanded poses themselves tie.

The frames follow every pose a little: with e_i what the robot is off at pose i, n_i the noise of its mean pose, of
variance u_i² an axis, and H the hat matrix of the tie, the residuals are r = (I - H)(e + n). For deviations of one
variance s² an axis the residual is too short by √(1 - h_i), h_i = tr H_ii / 3, so that the figure is r_i / √(1 - h_i).
Given the residuals, what the robot is off is

    e_i = a_i + b_i,     b_i ~ t_dof with covariance s² H_ii,     r_i = a_i + ν_i,

dof = Σ (3 - tr H_ii), s² = rᵀr / dof less what the means add to it. ν_i has the covariance of n_i - (H n)_i and
A_i A_iᵀ, what the errors that all poses share (lens, scale and shape of the print) leave in r_i. A pose that tied no
frames has r_i = e_i + ν_i, with s² H_ii in ν_i: nothing is presumed of how far it is off, and r_i is the figure.

That holds where all e_i are of one kind. A pose that alone is far off draws the frames to itself: its residual is too
short, and its share of s² widens nobody's interval enough. In the frames of the others, with K = H_ii (I - H_ii)⁻¹,

    (I - H_ii)⁻¹ r_i = e_i + ν_i,     s² K in ν_i, s² from r without pose i,

which presumes nothing of e_i. Poses of one command share what the robot is off. They are one station of the tie, their
mean, and count once in H, s² and dof. Pose k of station i is off by e_i + d_k: the offset d_k from the station is
measured, so it is added to residual and figure as it is, and the pose's own mean is the noise of what it adds to.

The part of e that moves all poses as one rigid body is in no residual: only a tie by
other means shows it.

References: D. A. Belsley, E. Kuh, R. E. Welsch, "Regression diagnostics", 1980, 10.1002/0471725153, 2.1 (leverage).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import stdtrit

from core.metrology.accuracy.deviation_parts import DeviationParts, DeviationSpread, length_limits
from core.metrology.rp_distribution import CONFIDENCE, NORMAL_FACTOR

MIN_FREE_SHARE = 1e-3
"""Of a pose's deviation: where the frames leave less of it, the pose's accuracy is not determined."""
MIN_DEGREES_OF_FREEDOM = 0.5


@dataclass(frozen=True, slots=True)
class MeanNoise:
    """Of the mean of each pose's visits: variance along an axis (mm²) or about one (rad²), and its degrees of freedom,
    which are infinite where it is stated.
    """

    variance: Float[np.ndarray, " n"]
    degrees_of_freedom: Float[np.ndarray, " n"]

    def freedom_of(self, i: int) -> float | None:
        """Return the degrees of freedom of one pose; None where they are infinite."""
        found = float(self.degrees_of_freedom[i])
        return found if math.isfinite(found) else None


@dataclass(frozen=True, slots=True)
class PosesOfStations:
    """m poses of n stations, a station being one pose or the mean of several of one command.

    Of each pose: its `station`, the `offsets` of its deviation from the station's, what the errors that all poses share
    leave in it (`common`), the `noise` of its mean, and the `weight` of this mean in the station's; weights of a
    station have the sum 1.
    """

    station: Int[np.ndarray, " m"]
    offsets: Float[np.ndarray, "m 3"]
    common: Float[np.ndarray, "m 3 k"]
    noise: MeanNoise
    weight: Float[np.ndarray, " m"]

    @property
    def noise_of_stations(self) -> MeanNoise:
        """That of the stations' means; the degrees of freedom are the least of a station's poses."""
        least = np.full(int(self.station.max()) + 1, np.inf)
        np.minimum.at(least, self.station, self.noise.degrees_of_freedom)
        return MeanNoise(np.bincount(self.station, self.weight**2 * self.noise.variance), least)


@dataclass(frozen=True, slots=True)
class TiedDeviations:
    """Deviations attained - commanded of n stations after a tie, of positions (mm) or of rotation vectors (rad).

    `leverage` are the blocks H_ii, `common` A_i, `used` the stations that tied the frames; `noise` has the u_i².
    `poses` are those of the stations; None where each station is one pose.
    """

    residuals: Float[np.ndarray, "n 3"]
    leverage: Float[np.ndarray, "n 3 3"]
    common: Float[np.ndarray, "n 3 k"]
    used: Bool[np.ndarray, " n"]
    noise: MeanNoise
    poses: PosesOfStations | None = None

    @property
    def each(self) -> PosesOfStations:
        """The poses, also where each station is one."""
        if self.poses is not None:
            return self.poses
        n = len(self.residuals)
        return PosesOfStations(np.arange(n), np.zeros((n, 3)), self.common, self.noise, np.ones(n))

    @property
    def degrees_of_freedom(self) -> float:
        """3 - tr H_ii, summed over the stations that tied the frames."""
        return float(np.sum(3.0 - np.trace(self.leverage[self.used], axis1=1, axis2=2)))


@dataclass(frozen=True, slots=True)
class EstimatedDeviation:
    """What the robot was off at one pose: `vector`, studentised; None where the frames follow the pose wholly.

    `residual` is the centre of what is known of it, `parts` what leaves it open; `parts` and `length_interval` are None
    where the tie leaves no degree of freedom. `factor` is half a 95 % interval of t. `held_out_interval` is that of the
    length in the frames of the other poses; None where these leave no degree of freedom. Both intervals are None where
    lengths were not asked for.
    """

    vector: Float[np.ndarray, "3"] | None
    residual: Float[np.ndarray, "3"]
    parts: DeviationParts | None
    factor: float
    length_interval: tuple[float, float] | None
    held_out_interval: tuple[float, float] | None

    def half_widths(self, J: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3"] | None:
        """Return half the 95 % intervals of J e; None where they are not known."""
        if self.parts is None:
            return None
        A = J @ self.parts.shared
        own = np.sqrt(np.maximum(np.diag(J @ self.parts.own @ J.T), 0.0))
        return np.hypot(self.factor * own, NORMAL_FACTOR * np.linalg.norm(A, axis=1))


def estimate_deviations(tied: TiedDeviations, *, lengths: bool = True) -> list[EstimatedDeviation]:
    """Return what the robot was off at each pose, with intervals at `CONFIDENCE`; those of lengths, which take nearly
    all of the time, only where asked for.
    """
    dof = tied.degrees_of_freedom
    H = 0.5 * (tied.leverage + np.swapaxes(tied.leverage, 1, 2))
    squares = np.sum(tied.residuals**2, axis=1)
    of_means = _variance_of_means(tied, tied.used)
    spread = _spread(tied, squares, tied.used, of_means, dof)
    each = tied.each
    found = []
    for k, (i, offset, A) in enumerate(zip(each.station.tolist(), each.offsets, each.common, strict=True)):
        Hi, used = H[i], bool(tied.used[i])
        r = tied.residuals[i] + offset
        free = 1.0 - float(np.trace(Hi)) / 3.0 if used else 1.0
        vector = tied.residuals[i] / math.sqrt(free) + offset if free >= MIN_FREE_SHARE else None
        if dof < MIN_DEGREES_OF_FREEDOM or vector is None:
            found.append(EstimatedDeviation(vector, r, None, 0.0, None, None))
            continue
        share = _as_share(Hi) if used else Hi
        rest = np.eye(3) - share if used else np.eye(3)
        of_visits = tied.noise.variance[i] * rest @ rest + of_means * (share @ rest if used else share)
        of_visits += _of_own_mean(tied, k, share if used else np.zeros((3, 3)))
        parts = DeviationParts(r, share, of_visits, A, each.noise.freedom_of(k), spread, tied=used)
        factor = float(stdtrit(parts.own_degrees_of_freedom, 0.5 + 0.5 * CONFIDENCE))
        if not lengths:
            found.append(EstimatedDeviation(vector, r, parts, factor, None, None))
            continue
        low, high = length_limits(parts)
        # The studentised figure is seldom outside what is known of the length; a figure is in its own interval.
        figure = float(np.linalg.norm(vector))
        within = min(low, figure), max(high, figure)
        alone = _held_out(tied, k, Hi) if used else within
        found.append(EstimatedDeviation(vector, r, parts, factor, within, alone))
    return found


def _of_own_mean(
    tied: TiedDeviations, k: int, followed: Float[np.ndarray, "3 3"]
) -> Float[np.ndarray, "3 3"]:
    """Return by how much the covariance of n_k - S n_i exceeds that of (1 - S) n_i: of pose k's own mean and of its
    station's, S being `followed`; 0 where the pose is the station.
    """
    each = tied.each
    own, station = each.noise.variance[k], tied.noise.variance[each.station[k]]
    return np.asarray((own - station) * np.eye(3) - 2.0 * (each.weight[k] * own - station) * followed)


def _spread(
    tied: TiedDeviations,
    squares: Float[np.ndarray, " n"],
    counted: Bool[np.ndarray, " n"],
    of_means: float,
    degrees_of_freedom: float,
) -> DeviationSpread:
    """Return what is known of s² by the poses counted; their frames share the means' variance among them."""
    h = np.clip(np.trace(tied.leverage, axis1=1, axis2=2) / 3.0, 0.0, 1.0)
    noise = (1.0 - h) * tied.noise.variance + h * of_means
    return DeviationSpread(squares[counted], noise[counted], degrees_of_freedom)


def _variance_of_means(tied: TiedDeviations, counted: Bool[np.ndarray, " n"]) -> float:
    """Return the variance an axis that the means of the poses counted add to their residuals."""
    weights = np.maximum(3.0 - np.trace(tied.leverage[counted], axis1=1, axis2=2), MIN_FREE_SHARE)
    return float(np.average(tied.noise.variance[counted], weights=weights))


def _as_share(leverage: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
    """Return the leverage of a pose that ties the frames, between none and all of it in every direction.

    Poses of which some are measured many times worse than others, or worse along one axis, tie the frames askew, and
    then a leverage may lie outside of that. No covariance follows from one that does.
    """
    shares, directions = np.linalg.eigh(leverage)
    return np.asarray(directions * np.clip(shares, 0.0, 1.0) @ directions.T)


def _held_out(tied: TiedDeviations, k: int, leverage: Float[np.ndarray, "3 3"]) -> tuple[float, float] | None:
    """Return the interval of pose k's deviation in the frames of the other stations; None where they do not tie it."""
    each = tied.each
    i = int(each.station[k])
    free = np.eye(3) - leverage
    dof = tied.degrees_of_freedom - 3.0
    if dof < MIN_DEGREES_OF_FREEDOM or np.linalg.eigvalsh(free)[0] < MIN_FREE_SHARE:
        return None
    residual = tied.residuals[i]
    G = np.linalg.inv(free)
    counted = tied.used.copy()
    counted[i] = False
    squares = np.sum(tied.residuals[counted] ** 2, axis=1)
    # In the frames of the others their residuals are shorter, by what the station drew the frames to itself.
    left = float(np.sum(squares)) + float(residual @ residual) - float(residual @ G @ residual)
    squares = squares * (max(left, 0.0) / max(float(np.sum(squares)), 1e-300))
    of_means = _variance_of_means(tied, counted)
    whole = np.zeros(len(counted))
    whole[counted] = squares
    spread = _spread(tied, whole, counted, of_means, dof)
    K = leverage @ G
    of_visits = each.noise.variance[k] * np.eye(3) + of_means * K
    shared = G @ tied.common[i] + (each.common[k] - tied.common[i])
    alone = G @ residual + each.offsets[k]
    return length_limits(
        DeviationParts(alone, K, of_visits, shared, each.noise.freedom_of(k), spread, tied=False)
    )
