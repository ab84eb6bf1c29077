"""Base and tool of a given chain, fitted to poses until they converge.

The closed form of `placed` has no unique answer where all rotations share an axis, and what it then gives may be
hundreds of millimetres from the best. Damped Gauss-Newton steps from several starts lead to the least sum of squares.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from core.kinematics.arm_model import ArmState
from core.kinematics.dh import chain_frames
from core.kinematics.global_fit.placement import placed, placed_with_tool
from core.kinematics.global_fit.residuals import Observations, linearised, whitened, whitener
from core.numerics import Variances, damped_step

_MAX_ITERATIONS = 60
_SETTLED = 1e-3  # of a step, in its own standard uncertainty
_FIRST_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-4, 1e-9, 1e6


def fit_frames(
    parameters: Float[np.ndarray, "j 5"],
    identified: ArmState,
    seen: Observations,
    free: Bool[np.ndarray, " p"],
    scatter: Variances,
) -> ArmState:
    """Return the arm with this chain and the base and tool that suit the poses best.

    Starts are the base and tool of the `identified` arm, the closed form, and the closed form with that arm's rotation
    of the tool. Columns of base and tool that are not `free` keep what the start has.
    """
    of_frames = free.copy()
    of_frames[: identified.layout.tool.start] = False
    of_frames[identified.layout.kinematic :] = False
    T_base_flange = np.ascontiguousarray(chain_frames(parameters, seen.joint_angles)[:, -1])
    R_tool = identified.T_flange_camera[:3, :3]
    closed = (
        placed(parameters, T_base_flange, seen),
        placed_with_tool(parameters, T_base_flange, seen, R_tool),
    )
    starts = [replace(identified, parameters=parameters)]
    starts += [replace(start, shared=identified.shared) for start in closed]
    arms = [_converged(start, seen, of_frames, scatter) for start in _distinct(starts)]
    return arms[0] if len(arms) == 1 else _best(arms, seen, scatter)


def _distinct(starts: Sequence[ArmState]) -> list[ArmState]:
    """Return those whose frames no earlier one has: the identified arm is often of the closed form itself."""
    found: list[ArmState] = []
    for start in starts:
        if not any(
            np.array_equal(start.T_flange_camera, one.T_flange_camera)
            and np.array_equal(start.T_target_base, one.T_target_base)
            for one in found
        ):
            found.append(start)
    return found


def _best(arms: Sequence[ArmState], seen: Observations, scatter: Variances) -> ArmState:
    W = whitener(seen, scatter)
    sums = [float(np.sum(whitened(W, linearised(arm, seen)[0]) ** 2)) for arm in arms]
    return arms[int(np.argmin(sums))]


def _converged(
    arm: ArmState,
    seen: Observations,
    free: Bool[np.ndarray, " p"],
    scatter: Variances,
) -> ArmState:
    """Return the arm after damped Gauss-Newton steps of the free columns, until they no longer move it."""
    W = whitener(seen, scatter)
    damping = _FIRST_DAMPING
    r, J = linearised(arm, seen)
    left = whitened(W, r)
    squares = np.sum(left**2)
    rows = whitened(W, J[free]).reshape(int(free.sum()), -1)
    normal, gradient = np.ascontiguousarray(rows @ rows.T), rows @ left.ravel()
    step = np.zeros(arm.layout.size)
    for _ in range(_MAX_ITERATIONS):
        moved, length = damped_step(normal, gradient, damping)
        step[free] = moved
        candidate = arm.moved(step)
        r, derivatives = linearised(candidate, seen)
        now = whitened(W, r)
        squares_now = np.sum(now**2)
        if np.isfinite(length) and squares_now <= squares:
            arm, squares = candidate, squares_now
            damping = max(damping / 10.0, _LEAST_DAMPING)
            if length < _SETTLED:
                break
            rows = whitened(W, derivatives[free]).reshape(len(moved), -1)
            normal, gradient = np.ascontiguousarray(rows @ rows.T), rows @ now.ravel()
        else:
            damping *= 10.0
            if damping > _MOST_DAMPING:
                break
    return arm
