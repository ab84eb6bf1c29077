"""What a robot was off at each pose, in frames that the commanded poses themselves tie.

The frames follow every pose a little: with e_i what the robot is off at pose i and H the hat matrix of the tie, the
residuals are r = (I - H)(e + n), n being the noise of the mean poses. For deviations of one variance s² an axis the
residual is too short by √(1 - h_i), h_i = tr H_ii / 3, so that the figure is r_i / √(1 - h_i); of a pose that tied no
frames it is r_i / √(1 + h_i). Given the residuals,

    e_i ~ r_i + t_dof,     covariance s² H_ii + u² (I - H)_ii + A_i A_iᵀ,     s² = rᵀr / dof - u²,

dof = Σ (3 - tr H_ii), u² the variance of a mean an axis, A_i what the errors that all poses share (lens, scale and
shape of the print) leave in r_i. A pose that tied no frames has u² I.

That holds where all e_i are of one kind. A pose that alone is far off draws the frames to itself: its residual is too
short, and its share of s² widens nobody's interval enough. In the frames of the others, with K = H_ii (I - H_ii)⁻¹,

    e_i ~ (I - H_ii)⁻¹ r_i + t_dof-3,     covariance s² K + u² (I + K) + ...,     s² from r without pose i,

which presumes nothing of e_i. An interval of the length is that of the lengths
of draws of e_i. The part of e that moves all poses as one rigid body is in no residual: only a tie by other means
shows it.

References: D. A. Belsley, E. Kuh, R. E. Welsch, "Regression diagnostics", 1980, 10.1002/0471725153, 2.1 (leverage).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import stdtrit

from core.metrology.rp_distribution import CONFIDENCE, NORMAL_FACTOR

MIN_FREE_SHARE = 1e-3
"""Of a pose's deviation: where the frames leave less of it, the pose's accuracy is not determined."""
MIN_DEGREES_OF_FREEDOM = 0.5
_DRAWS = 10_000
_SEED = 9283


@dataclass(frozen=True, slots=True)
class TiedDeviations:
    """Deviations attained - commanded of n poses after a tie, of positions (mm) or of rotation vectors (rad).

    `leverage` are the blocks H_ii, `common` A_i, `used` the poses that tied the frames; `mean_variance` is u², of
    `mean_degrees_of_freedom`; None where it is stated.
    """

    residuals: Float[np.ndarray, "n 3"]
    leverage: Float[np.ndarray, "n 3 3"]
    common: Float[np.ndarray, "n 3 k"]
    used: Bool[np.ndarray, " n"]
    mean_variance: float
    mean_degrees_of_freedom: float | None = None

    @property
    def degrees_of_freedom(self) -> float:
        """3 - tr H_ii, summed over the poses that tied the frames."""
        return float(np.sum(3.0 - np.trace(self.leverage[self.used], axis1=1, axis2=2)))


@dataclass(frozen=True, slots=True)
class DeviationParts:
    """What leaves the deviation of one pose open, mm or rad: `residual` is the centre of what is known of it.

    `of_tie` and `of_visits` are covariances, together times t of `degrees_of_freedom`; the columns of `shared` are what
    one standard uncertainty of each error does that all poses share. `visits_degrees_of_freedom` are those of the
    scatter of the visits; None where it is stated. `variance` is s², of all poses' deviations along an axis.
    """

    residual: Float[np.ndarray, "3"]
    of_tie: Float[np.ndarray, "3 3"]
    of_visits: Float[np.ndarray, "3 3"]
    shared: Float[np.ndarray, "3 k"]
    degrees_of_freedom: float
    visits_degrees_of_freedom: float | None
    variance: float = 0.0

    @property
    def own(self) -> Float[np.ndarray, "3 3"]:
        """The covariance that is times t."""
        return self.of_tie + self.of_visits

    @property
    def visits_share(self) -> float:
        """The share of the variance that more visits narrow, between 0 and 1."""
        visits = float(np.trace(self.of_visits))
        whole = visits + float(np.trace(self.of_tie)) + float(np.sum(self.shared**2))
        return visits / whole if whole > 0.0 else 1.0

    def draws(self, trials: int, own: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "t 3"]:
        """Return draws of the deviation, with random numbers of their own; `own` is the covariance that is times t."""
        rng = np.random.default_rng([_SEED, trials])
        normal, others = rng.standard_normal((2, trials, 3))
        student = (
            normal
            / np.sqrt(rng.chisquare(self.degrees_of_freedom, trials) / self.degrees_of_freedom)[:, None]
        )
        shared = others @ _root(self.shared @ self.shared.T).T
        return np.asarray(self.residual + student @ _root(own).T + shared)

    def lengths(self, trials: int) -> Float[np.ndarray, " t"]:
        """Return lengths of draws of the deviation."""
        return np.asarray(np.linalg.norm(self.draws(trials, self.own), axis=1))


@dataclass(frozen=True, slots=True)
class EstimatedDeviation:
    """What the robot was off at one pose: `vector`, studentised; None where the frames follow the pose wholly.

    `residual` is the centre of what is known of it, `parts` what leaves it open; `parts` and `length_interval` are None
    where the tie leaves no degree of freedom. `factor` is half a 95 % interval of t. `held_out_interval` is that of the
    length in the frames of the other poses; None where these leave no degree of freedom.
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


def estimate_deviations(tied: TiedDeviations) -> list[EstimatedDeviation]:
    """Return what the robot was off at each pose, with intervals at `CONFIDENCE`."""
    dof = tied.degrees_of_freedom
    H = 0.5 * (tied.leverage + np.swapaxes(tied.leverage, 1, 2))
    rng = np.random.default_rng(_SEED)
    normal, others = rng.standard_normal((2, _DRAWS, 3))
    variance, student, factor, others_student = None, normal, 0.0, None
    if dof >= MIN_DEGREES_OF_FREEDOM:
        squares = float(np.sum(tied.residuals[tied.used] ** 2))
        variance = max(squares / dof - tied.mean_variance, 0.0)
        student = normal / np.sqrt(rng.chisquare(dof, _DRAWS) / dof)[:, None]
        factor = float(stdtrit(dof, 0.5 + 0.5 * CONFIDENCE))
    if dof - 3.0 >= MIN_DEGREES_OF_FREEDOM:
        others_student = normal / np.sqrt(rng.chisquare(dof - 3.0, _DRAWS) / (dof - 3.0))[:, None]
    found = []
    for r, Hi, A, used in zip(tied.residuals, H, tied.common, tied.used.tolist(), strict=True):
        sign = -1.0 if used else 1.0
        free = 1.0 + sign * float(np.trace(Hi)) / 3.0
        vector = r / math.sqrt(free) if free >= MIN_FREE_SHARE else None
        if variance is None or vector is None:
            found.append(EstimatedDeviation(vector, r, None, factor, None, None))
            continue
        share = _as_share(Hi) if used else Hi
        of_visits = tied.mean_variance * (np.eye(3) - (share if used else 0.0))
        parts = DeviationParts(r, variance * share, of_visits, A, dof, tied.mean_degrees_of_freedom, variance)
        lengths = np.linalg.norm(r + student @ _root(parts.own).T + others @ _root(A @ A.T).T, axis=1)
        low, high = _quantiles(lengths)
        # The studentised figure is seldom outside what is known of the length; a figure is in its own interval.
        figure = float(np.linalg.norm(vector))
        within = min(low, figure), max(high, figure)
        alone: tuple[float, float] | None = within
        if used:
            alone = None if others_student is None else _held_out(tied, r, Hi, A, others_student, others)
        found.append(EstimatedDeviation(vector, r, parts, factor, within, alone))
    return found


def _as_share(leverage: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
    """Return the leverage of a pose that ties the frames, between none and all of it in every direction.

    Poses of which some are measured many times worse than others, or worse along one axis, tie the frames askew, and
    then a leverage may lie outside of that. No covariance follows from one that does.
    """
    shares, directions = np.linalg.eigh(leverage)
    return np.asarray(directions * np.clip(shares, 0.0, 1.0) @ directions.T)


def _held_out(
    tied: TiedDeviations,
    residual: Float[np.ndarray, "3"],
    leverage: Float[np.ndarray, "3 3"],
    common: Float[np.ndarray, "3 k"],
    student: Float[np.ndarray, "t 3"],
    others: Float[np.ndarray, "t 3"],
) -> tuple[float, float] | None:
    """Return the interval of a pose's deviation in the frames of the other poses; None where they do not tie it.

    `student` are draws of t of the degrees of freedom without the pose, `others` of the normal distribution.
    """
    free = np.eye(3) - leverage
    if np.linalg.eigvalsh(free)[0] < MIN_FREE_SHARE:
        return None
    dof = tied.degrees_of_freedom - 3.0
    G = np.linalg.inv(free)
    squares = float(np.sum(tied.residuals[tied.used] ** 2)) - float(residual @ G @ residual)
    variance = max(squares / dof - tied.mean_variance, 0.0)
    K = leverage @ G
    own = variance * K + tied.mean_variance * (np.eye(3) + K)
    shared = others @ _root(G @ common @ common.T @ G.T).T
    return _quantiles(np.linalg.norm(G @ residual + student @ _root(own).T + shared, axis=1))


def _quantiles(lengths: Float[np.ndarray, " n"]) -> tuple[float, float]:
    low, high = np.quantile(lengths, [0.5 - 0.5 * CONFIDENCE, 0.5 + 0.5 * CONFIDENCE])
    return float(low), float(high)


def _root(covariance: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
