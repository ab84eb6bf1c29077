"""Restricted likelihood of the linearised fit, its gradient, and the posterior of all coefficients.

    y = X b + noise,   columns of b flat (base, tool), or normal with known (DH, lens) or estimated (terms) variances v

Rows are whitened by the noise as known; what is left has a variance κ for positions and one for rotations. With
A = Σ_k X_kᵀX_k / κ_k + diag(0, 1/v), twice the negative logarithm of the restricted likelihood is

    Σ N_k ln κ_k + ln |A| + Σ ln v + yᵀPy,     yᵀPy = Σ |y_k|²/κ_k + μᵀμ/v - bᵀ A b

and its derivatives follow from the diagonal of A⁻¹ and b: by ln v_i, 1 - C_ii/v_i - (b_i - μ_i)²/v_i; by ln κ_k,
N_k - tr(X_kᵀX_k C)/κ_k - |y_k - X_k b|²/κ_k. Columns are scaled by √v, so that a variance may go to zero.

References: H. D. Patterson, R. Thompson, Biometrika 58 (1971) 545-554, 10.1093/biomet/58.3.545; C. E. Rasmussen,
C. K. I. Williams, Gaussian Processes for Machine Learning, MIT Press 2006, section 2.7.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import lapack

from core.kinematics.error_model.priors import Hyperparameters
from core.kinematics.error_model.terms import Terms

_ENOUGH = 0.05
"""Of twice the logarithm of the likelihood: no decision is changed by less."""
_MAX_EVALUATIONS = 60
_FLAT = 0.05
_NOISE_RANGE = 60.0
_NOWHERE = 1e6  # times the objective at the start
_RANGE = 25.0
"""Logarithms of variances stay so near to where they begin: e⁻²⁵ is nothing."""


@dataclass(frozen=True, slots=True)
class Sums:
    """Whitened rows summed, positions and rotations apart (k kinds): X_kᵀX_k, X_kᵀy_k, |y_k|², and numbers of rows."""

    normal: Float[np.ndarray, "k p p"]
    gradient: Float[np.ndarray, "k p"]
    squares: Float[np.ndarray, " k"]
    rows: Float[np.ndarray, " k"]

    def __sub__(self, other: Sums) -> Sums:
        """Return the sums without some rows."""
        return Sums(
            self.normal - other.normal,
            self.gradient - other.gradient,
            self.squares - other.squares,
            self.rows - other.rows,
        )


@dataclass(frozen=True, slots=True)
class Prior:
    """Of the columns before the terms: variances v (∞ where flat) and means μ."""

    variances: Float[np.ndarray, " f"]
    means: Float[np.ndarray, " f"]


@dataclass(frozen=True, slots=True)
class LevelProblem:
    """What a level is fitted to: the rows summed, the prior of the columns before the terms, and the terms chosen."""

    sums: Sums
    prior: Prior
    terms: Terms
    chosen: Bool[np.ndarray, " c"]

    @property
    def columns(self) -> Bool[np.ndarray, " p"]:
        """Those that the level has, of all."""
        return np.concatenate([np.ones(len(self.prior.variances), dtype=np.bool_), self.chosen])

    def taken(self) -> Sums:
        """Return the sums of the level's columns."""
        columns = self.columns
        if columns.all():
            return self.sums
        places = np.flatnonzero(columns)
        return Sums(
            np.ascontiguousarray(self.sums.normal[:, places[:, None], places]),
            np.ascontiguousarray(self.sums.gradient[:, places]),
            self.sums.squares,
            self.sums.rows,
        )


@dataclass(frozen=True, slots=True)
class Fitted:
    """Coefficients b of all columns with their covariance C, zero for the terms that are not part of the level.

    `minus_2_log` is twice the negative logarithm of the restricted likelihood, the hyperparameters' prior included.
    """

    coefficients: Float[np.ndarray, " p"]
    covariance: Float[np.ndarray, "p p"]
    noise: Float[np.ndarray, " k"]
    hyperparameters: Hyperparameters
    minus_2_log: float


@dataclass(frozen=True, slots=True)
class _State:
    """The objective and its derivatives; how far the rows determine each coefficient (0 to 1), how many rows of each
    kind the coefficients take, and the posterior, of its covariance the lower triangle.
    """

    value: float
    by_log_variance: Float[np.ndarray, " p"]
    by_log_noise: Float[np.ndarray, " k"]
    determined: Float[np.ndarray, " p"]
    taken: Float[np.ndarray, " k"]
    coefficients: Float[np.ndarray, " p"]
    half_covariance: Float[np.ndarray, "p p"]


def solve(problem: LevelProblem, hyperparameters: Hyperparameters, noise: Float[np.ndarray, " k"]) -> Fitted:
    """Return the coefficients at known hyperparameters and noise."""
    variances = hyperparameters.variances(problem.terms)[0][problem.chosen]
    state = _evaluated(problem.taken(), problem.prior, variances, noise)
    return _spread_out(state, problem.columns, hyperparameters, noise, state.value)


def coefficients(
    problem: LevelProblem, hyperparameters: Hyperparameters, noise: Float[np.ndarray, " k"]
) -> Float[np.ndarray, " p"]:
    """Return the coefficients of `solve` without their covariance, which takes most of its time."""
    columns = problem.columns
    variances = hyperparameters.variances(problem.terms)[0][problem.chosen]
    at = _factored(problem.taken(), problem.prior, variances, noise)
    b = np.zeros(len(columns))
    b[columns] = at.root * at.scaled
    return b


def minus_2_log(
    problem: LevelProblem, hyperparameters: Hyperparameters, noise: Float[np.ndarray, " k"]
) -> float:
    """Return that of `solve` alone, without the covariance."""
    variances = hyperparameters.variances(problem.terms)[0][problem.chosen]
    return _factored(problem.taken(), problem.prior, variances, noise).minus_2_log


def maximise(
    problem: LevelProblem,
    start: tuple[Hyperparameters, Float[np.ndarray, " k"]],
    spread: Float[np.ndarray, "7"],
    least_noise: Float[np.ndarray, " k"],
) -> Fitted:
    """Return the fit at the hyperparameters and noise of the greatest restricted likelihood times their prior.

    `spread` are the standard deviations of that prior about the defaults; hyperparameters with 0 stay at the default.
    """
    prior, terms, chosen, taken = problem.prior, problem.terms, problem.chosen, problem.taken()
    middle = Hyperparameters.defaults().log_values
    kinds = len(taken.rows)
    moving = (spread > 0.0) & np.any(start[0].variances(terms)[1][:, chosen] != 0.0, axis=1)
    h = int(moving.sum())

    def unpacked(x: Float[np.ndarray, " x"]) -> tuple[Hyperparameters, Float[np.ndarray, " k"]]:
        values = middle.copy()
        values[moving] = x[:h]
        return Hyperparameters(values), np.exp(x[h:])

    @lru_cache(maxsize=1)  # the first point is asked for three times, the last one twice
    def state_at(point: bytes) -> tuple[_State, Float[np.ndarray, "h c"]]:
        found, kappa = unpacked(np.frombuffer(point))
        variances, by = found.variances(terms)
        return _evaluated(taken, prior, variances[chosen], kappa), by[moving][:, chosen]

    def objective(x: Float[np.ndarray, " x"]) -> tuple[float, Float[np.ndarray, " x"]]:
        state, by = state_at(x.tobytes())
        off = (x[:h] - middle[moving]) / spread[moving]
        gradient = np.empty(h + kinds)
        gradient[:h] = by @ state.by_log_variance[len(prior.variances) :]
        gradient[:h] += 2.0 * off / spread[moving]
        gradient[h:] = state.by_log_noise
        return state.value + float(off @ off), gradient

    begin = np.concatenate([start[0].log_values[moving], np.log(np.maximum(start[1], least_noise))])
    lowest = np.concatenate([middle[moving] - _RANGE, np.log(least_noise)])
    highest = np.concatenate([middle[moving] + _RANGE, np.log(least_noise) + _NOISE_RANGE])
    unit = 1.0 / np.sqrt(_curvatures(taken, prior, *state_at(begin.tobytes()), spread[moving]))
    scale = max(abs(objective(begin)[0]), 1.0)

    def scaled(x: Float[np.ndarray, " x"]) -> tuple[float, Float[np.ndarray, " x"]]:
        try:
            value, gradient = objective(np.clip(begin + unit * x, lowest, highest))
        except np.linalg.LinAlgError:  # a line search went where rounding decides: it comes back from there
            return _NOWHERE, np.zeros(len(x))
        return value / scale, gradient * unit / scale

    from scipy.optimize import minimize  # takes a tenth of a second to load, and few processes fit robots

    answer = minimize(
        scaled,
        np.zeros(len(begin)),
        jac=True,
        method="L-BFGS-B",
        bounds=list(zip((lowest - begin) / unit, (highest - begin) / unit, strict=True)),
        options={"ftol": _ENOUGH / scale, "gtol": _FLAT / scale, "maxfun": _MAX_EVALUATIONS},
    )
    best = np.clip(begin + unit * np.asarray(answer.x), lowest, highest)
    found, kappa = unpacked(best)
    state, _ = state_at(best.tobytes())
    return _spread_out(state, problem.columns, found, kappa, scale * float(answer.fun))


def _curvatures(
    sums: Sums, prior: Prior, state: _State, by: Float[np.ndarray, "h c"], spread: Float[np.ndarray, " h"]
) -> Float[np.ndarray, " x"]:
    """Return about how the objective curves along each logarithm: what determines it, and its prior."""
    known = by**2 @ state.determined[len(prior.variances) :]
    return np.concatenate([known + 2.0 / spread**2, sums.rows - state.taken + 1.0])


def _spread_out(
    state: _State,
    columns: Bool[np.ndarray, " p"],
    hyperparameters: Hyperparameters,
    noise: Float[np.ndarray, " k"],
    value: float,
) -> Fitted:
    places, size = np.flatnonzero(columns), len(columns)
    b = np.zeros(size)
    b[places] = state.coefficients
    C = np.zeros((size, size))
    C[np.ix_(places, places)] = state.half_covariance + np.tril(state.half_covariance, -1).T
    return Fitted(b, C, noise, hyperparameters, value)


@dataclass(frozen=True, slots=True)
class _Factors:
    """The equations in units of the priors' deviations: Cholesky's factor, prior means, roots, solution; and what
    `Fitted` calls `minus_2_log`, without the hyperparameters' prior.
    """

    lower: Float[np.ndarray, "p p"]
    mean: Float[np.ndarray, " p"]
    root: Float[np.ndarray, " p"]
    known: Bool[np.ndarray, " p"]
    scaled: Float[np.ndarray, " p"]
    minus_2_log: float


def _factored(
    sums: Sums, prior: Prior, variances: Float[np.ndarray, " t"], noise: Float[np.ndarray, " k"]
) -> _Factors:
    v = np.concatenate([prior.variances, variances])
    known = np.isfinite(v)
    A = np.tensordot(1.0 / noise, sums.normal, axes=1)
    flat = 1.0 / np.sqrt(np.maximum(np.diag(A), 1e-300))
    root = np.where(known, np.sqrt(np.where(known, v, 1.0)), flat)
    mean = np.zeros(len(v))
    of_chain = known[: len(prior.variances)]
    mean[: len(of_chain)][of_chain] = prior.means[of_chain] / np.sqrt(prior.variances[of_chain])
    A *= root[:, None]
    A *= root
    A[np.diag_indices_from(A)] += known
    lower, failed = lapack.dpotrf(A.T, lower=1, overwrite_a=1)  # symmetric; A.T is as LAPACK has matrices
    if failed:
        raise np.linalg.LinAlgError("The columns of the error model are not independent.")
    right = root * ((1.0 / noise) @ sums.gradient) + mean
    scaled = np.asarray(lapack.dpotrs(lower, right, lower=1)[0])
    value = float(sums.rows @ np.log(noise)) + 2.0 * float(np.sum(np.log(np.diag(lower))))
    # Of flat columns ln |A| is by their own units, whatever they are scaled by here.
    value -= 2.0 * float(np.sum(np.log(root[~known])))
    value += float(np.sum(sums.squares / noise)) + float(mean @ mean) - float(right @ scaled)
    return _Factors(lower, mean, root, known, scaled, value)


def _evaluated(
    sums: Sums, prior: Prior, variances: Float[np.ndarray, " t"], noise: Float[np.ndarray, " k"]
) -> _State:
    at = _factored(sums, prior, variances, noise)
    scaled, root, known = at.scaled, at.root, at.known
    # Its lower triangle; above it zeros, as the factor has.
    half = lapack.dpotri(at.lower, lower=1, overwrite_c=1)[0]
    unit = np.diag(half).copy()
    half *= root[:, None]
    half *= root
    b = root * scaled
    left = sums.squares - 2.0 * sums.gradient @ b + (sums.normal @ b) @ b
    traces = np.array([2.0 * np.vdot(N, half.T) - np.diag(N) @ np.diag(half) for N in sums.normal])
    off = (scaled - at.mean) ** 2
    return _State(
        at.minus_2_log,
        np.where(known, 1.0 - unit - off, 0.0),
        sums.rows - traces / noise - left / noise,
        np.where(known, (1.0 - unit) ** 2, 0.0),
        traces / noise,
        b,
        half,
    )
