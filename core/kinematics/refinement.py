"""Everything at once: chain, tool, bases and shared errors from all poses, robustly, with the robot's own scatter.

Least squares of whitened residuals by `core.least_squares` (plain first, Cauchy weights and rejection at 4 MAD where
something stands out) in turn with the variance components of `scatter`, until the variances rest. Columns that are held
keep the start's value. Shared errors are parameters with unit priors, which makes "one lens, one error" exact: the
poses are independent given the lens.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from core.kinematics.parameters import ArmState
from core.kinematics.problem import Observations, Scatter, as_points, linearised, whitened, whitener
from core.kinematics.scatter import SMALLEST, estimate_scatter
from core.least_squares import MEDIAN_LENGTH, Fit, fit

DEFAULT_SCATTER = Scatter(0.1**2, 1e-4**2)
"""Where nothing is known of the noise: only the ratio counts, and only at first."""
ROUNDS = 12
SETTLED = 0.02  # relative change of a standard deviation between rounds
MANY_ITERATIONS = 100
SMALLEST_SCALE = 1.0
"""Of whitened residuals: no pose within its stated uncertainty is an outlier, however much better others agree."""


@dataclass(frozen=True, slots=True)
class Refined:
    """The arm that explains the poses best, and what that rests on.

    `residuals` of all poses (observed - predicted), `jacobian` by all columns, `used` the poses that count,
    `information` and `covariance` over the `free` columns and the shared errors, at V = C + S.
    """

    arm: ArmState
    free: Bool[np.ndarray, " p"]
    scatter: Scatter
    residuals: Float[np.ndarray, "m n"]
    jacobian: Float[np.ndarray, "p m n"]
    used: Bool[np.ndarray, " n"]
    information: Float[np.ndarray, "f f"]
    covariance: Float[np.ndarray, "f f"]
    status: str


def refine(
    start: ArmState, seen: Observations, free: Bool[np.ndarray, " p"], scatter: Scatter | None = None
) -> Refined:
    """Fit the `free` columns (shared errors always are) from `start`, and the scatter with them.

    `scatter` is where its estimation begins. Without it a plain fit comes first, of which nothing but the size of its
    residuals is kept: before the noise of positions and rotations is known, nothing can be said to stand out.
    """
    free = free.copy()
    free[start.layout.kinematic :] = True
    arm = start
    S = _first_scatter(start, seen, free) if scatter is None else scatter
    for _ in range(ROUNDS):
        result = _fitted(arm, seen, free, S)
        arm = result.state
        n = len(seen)
        used = result.used[:n] if len(result.used) == n else result.used[:n] & result.used[n:]
        r, J = linearised(arm, seen)
        information = information_of(seen, J, free, used, S)
        covariance = inverse_of(information)
        keep = np.flatnonzero(used)
        found = estimate_scatter(seen.take(keep), r[:, keep], _leverage(J[free][:, :, keep], covariance), S)
        rests = _ratio(found, S) < SETTLED
        S = found
        if rests:
            break
    return Refined(arm, free, S, r, J, used, information, covariance, result.status)


def refine_plainly(
    start: ArmState, seen: Observations, free: Bool[np.ndarray, " p"], scatter: Scatter, iterations: int = 3
) -> ArmState:
    """Return the arm after a few plain Gauss-Newton steps from near the minimum, at a known scatter."""
    free = free.copy()
    free[start.layout.kinematic :] = True
    W = whitener(seen, scatter)
    arm = start
    for _ in range(iterations):
        r, J = linearised(arm, seen)
        J = whitened(W, J[free]).reshape(int(free.sum()), -1)
        g = J @ whitened(W, r).ravel()
        H = J @ J.T
        k = arm.layout.shared
        if k:
            H[-k:, -k:] += np.eye(k)
            g[-k:] -= arm.shared
        solved = inverse_of(H) @ g
        step = np.zeros(arm.layout.size)
        step[free] = solved
        arm = arm.moved(step)
        if float(solved @ H @ solved) < 1e-4:
            break
    return arm


def _first_scatter(start: ArmState, seen: Observations, free: Bool[np.ndarray, " p"]) -> Scatter:
    """Return the scatter by the medians of a plain fit's residuals, which some gross errors leave alone."""
    everything = np.ones(len(seen) * (seen.components // 3), dtype=np.bool_)
    r, _ = linearised(_fitted(start, seen, free, DEFAULT_SCATTER, everything).state, seen)
    growth = r.size / max(r.size - int(free.sum()), 1)
    own = np.diagonal(seen.own, axis1=1, axis2=2)
    found: list[float] = []
    for part, least in ((slice(0, 3), SMALLEST.position), (slice(3, 6), SMALLEST.rotation)):
        if part.start >= seen.components:
            return Scatter(found[0], DEFAULT_SCATTER.rotation)
        median = float(np.median(np.sum(r[part] ** 2, axis=0))) / MEDIAN_LENGTH[3] ** 2
        found.append(max(growth * median - float(np.median(own[:, part].mean(axis=1))), least))
    return Scatter(*found)


def _fitted(
    start: ArmState,
    seen: Observations,
    free: Bool[np.ndarray, " p"],
    scatter: Scatter,
    used: Bool[np.ndarray, " q"] | None = None,
) -> Fit[ArmState]:
    W = whitener(seen, scatter)
    k = start.layout.shared
    columns = int(free.sum())

    def evaluate(arm: ArmState) -> tuple[Float[np.ndarray, "3 q"], Float[np.ndarray, "f 3 q"]]:
        r, J = linearised(arm, seen)
        return as_points(whitened(W, r)), as_points(whitened(W, J[free]))

    def retract(arm: ArmState, step: Float[np.ndarray, " f"]) -> ArmState:
        full = np.zeros(arm.layout.size)
        full[free] = step
        return arm.moved(full)

    def prior(arm: ArmState) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, "k f"]]:
        return -arm.shared, np.eye(k, columns, columns - k)

    points = len(seen) * (seen.components // 3)
    return fit(
        evaluate,
        retract,
        start,
        np.ones(points),
        prior=prior if k else None,
        smallest_scale=SMALLEST_SCALE,
        used=used,
        iteration_limit=MANY_ITERATIONS,
    )


def information_of(
    seen: Observations,
    J: Float[np.ndarray, "p m n"],
    free: Bool[np.ndarray, " p"],
    used: Bool[np.ndarray, " n"],
    scatter: Scatter,
) -> Float[np.ndarray, "f f"]:
    """Return the information on the free columns, the shared errors' priors included."""
    Jw = (whitened(whitener(seen, scatter), J[free]) * used).reshape(int(free.sum()), -1)
    H = Jw @ Jw.T
    k = seen.common.shape[2]
    if k:
        H[-k:, -k:] += np.eye(k)
    return np.asarray(H)


def _leverage(
    J: Float[np.ndarray, "f m n"], covariance: Float[np.ndarray, "f f"]
) -> Float[np.ndarray, "n m m"]:
    """Return J Σ Jᵀ of every pose."""
    f, m, n = J.shape
    half = np.ascontiguousarray(J.transpose(2, 1, 0)).reshape(n * m, f)
    return (half @ covariance).reshape(n, m, f) @ half.reshape(n, m, f).transpose(0, 2, 1)


def inverse_of(H: Float[np.ndarray, "f f"]) -> Float[np.ndarray, "f f"]:
    """Invert an information matrix by way of its unit diagonal; what it does not tell gets a huge variance."""
    unit = 1.0 / np.sqrt(np.maximum(np.diag(H), 1e-300))
    values, vectors = np.linalg.eigh(H * np.outer(unit, unit))
    half = unit[:, None] * vectors / np.sqrt(np.maximum(values, 1e-15 * values[-1]))
    return np.asarray(half @ half.T)


def _ratio(a: Scatter, b: Scatter) -> float:
    """Return the largest relative change of a standard deviation."""
    return max(
        abs(a.position - b.position) / (2.0 * a.position), abs(a.rotation - b.rotation) / (2.0 * a.rotation)
    )
