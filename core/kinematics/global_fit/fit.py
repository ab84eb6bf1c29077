"""Robust fit of chain, tool, bases and shared errors to all poses at once, with the robot's own scatter.

Least squares of whitened residuals by `core.numerics.least_squares` (plain first, Cauchy weights and rejection at 4 MAD
where there are outliers) alternate with the variance components of the robot, until the variances converge. Columns
that are held keep the start's value. Shared errors are parameters with unit priors, which makes "one lens, one error"
exact: the poses are independent given the lens.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from core.kinematics.arm_model import ArmState
from core.kinematics.global_fit.residuals import Observations, as_points, linearised, whitened, whitener
from core.numerics import (
    MEDIAN_LENGTH,
    SMALLEST,
    Fit,
    LinearResiduals,
    Variances,
    covariance_of,
    estimate_variances,
    fit,
)

DEFAULT_SCATTER = Variances.of_deviations(0.1, 1e-4)
"""Where nothing is known of the noise: only the ratio counts, and only at first."""
MAX_ROUNDS = 12
SETTLED = 0.02  # relative change of a standard deviation between rounds
MANY_ITERATIONS = 100
SMALLEST_SCALE = 1.0
"""Of whitened residuals: no pose within its stated uncertainty is an outlier, however much better others agree."""


@dataclass(frozen=True, slots=True)
class FitResult:
    """The arm that fits the poses best, with its residuals, weights and covariance.

    `residuals` of all poses (observed - predicted), `jacobian` by all columns, `used` the poses that count,
    `covariance` over the `free` columns and the shared errors, at V = C + S.
    """

    arm: ArmState
    free: Bool[np.ndarray, " p"]
    scatter: Variances
    residuals: Float[np.ndarray, "m n"]
    jacobian: Float[np.ndarray, "p m n"]
    used: Bool[np.ndarray, " n"]
    covariance: Float[np.ndarray, "f f"]
    status: str


def refine(
    start: ArmState, seen: Observations, free: Bool[np.ndarray, " p"], scatter: Variances | None = None
) -> FitResult:
    """Fit the `free` columns (shared errors always are) from `start`, and the scatter with them.

    `scatter` is where its estimation begins. Without it a plain fit comes first, of which nothing but the size of its
    residuals is kept: before the noise of positions and rotations is known, nothing can be said to stand out.
    """
    free = free.copy()
    free[start.layout.kinematic :] = True
    arm = start
    S = _first_scatter(start, seen, free) if scatter is None else scatter
    for _ in range(MAX_ROUNDS):
        result = _fitted(arm, seen, free, S)
        arm = result.state
        n = len(seen)
        used = result.used[:n] if len(result.used) == n else result.used[:n] & result.used[n:]
        r, J = linearised(arm, seen)
        covariance = covariance_of(information_of(seen, J, free, used, S))
        keep = np.flatnonzero(used)
        left = LinearResiduals(
            seen.own[keep],
            r[:, keep].T,
            np.ascontiguousarray(J[free][:, :, keep].T),
            covariance=covariance,
        )
        found = estimate_variances([left], S)
        rests = found.near(S, SETTLED)
        S = found
        if rests:
            break
    return FitResult(arm, free, S, r, J, used, covariance, result.status)


def fit_unweighted(
    start: ArmState,
    seen: Observations,
    free: Bool[np.ndarray, " p"],
    scatter: Variances,
    iterations: int = 3,
    nominal: Float[np.ndarray, "j 5"] | None = None,
) -> ArmState:
    """Return the arm after a few plain Gauss-Newton steps from near the minimum, at a known scatter; its joints'
    parameters are normal about the `nominal`, or flat without one.
    """
    free = free.copy()
    layout = start.layout
    free[layout.kinematic :] = True
    weights = np.zeros(layout.size)
    if nominal is not None:
        weights[: layout.tool.start] = layout.nominal_deviations() ** -2.0
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
        if nominal is not None:
            off = np.zeros(layout.size)
            off[: layout.tool.start] = (nominal - arm.parameters).ravel()
            H += np.diag(weights[free])
            g += (weights * off)[free]
        solved = covariance_of(H) @ g
        step = np.zeros(arm.layout.size)
        step[free] = solved
        arm = arm.moved(step)
        if float(solved @ H @ solved) < 1e-4:
            break
    return arm


def _first_scatter(start: ArmState, seen: Observations, free: Bool[np.ndarray, " p"]) -> Variances:
    """Return the scatter by the medians of a plain fit's residuals, which some gross errors leave alone."""
    everything = np.ones(len(seen) * (seen.components // 3), dtype=np.bool_)
    r, _ = linearised(_fitted(start, seen, free, DEFAULT_SCATTER, everything).state, seen)
    growth = r.size / max(r.size - int(free.sum()), 1)
    own = np.diagonal(seen.own, axis1=1, axis2=2)
    found: list[float] = []
    for part, least in ((slice(0, 3), SMALLEST.position), (slice(3, 6), SMALLEST.rotation)):
        if part.start >= seen.components:
            return Variances(found[0], DEFAULT_SCATTER.rotation)
        median = float(np.median(np.sum(r[part] ** 2, axis=0))) / MEDIAN_LENGTH[3] ** 2
        found.append(max(growth * median - float(np.median(own[:, part].mean(axis=1))), least))
    return Variances(*found)


def _fitted(
    start: ArmState,
    seen: Observations,
    free: Bool[np.ndarray, " p"],
    scatter: Variances,
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
    scatter: Variances,
) -> Float[np.ndarray, "f f"]:
    """Return the information on the free columns, the shared errors' priors included."""
    Jw = (whitened(whitener(seen, scatter), J[free]) * used).reshape(int(free.sum()), -1)
    H = Jw @ Jw.T
    k = seen.common.shape[2]
    if k:
        H[-k:, -k:] += np.eye(k)
    return np.asarray(H)
