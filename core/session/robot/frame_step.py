"""A frame that moved while poses were measured: the instrument's station, a target or the robot's base.

Poses from some place on in the order of measuring then lie elsewhere by one rigid motion. An identification fits chain
and base to both parts; what is left are residuals of either part that are a rigid motion of their own,

    r_i = δ + w × (p_i - p̄) + noise.

For each place that divides the poses, both parts get their own motion by least squares.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from core.errors import Advisory
from core.geometry import hats

LEAST_POSES = 12
"""Of each part: fewer fit six components of a motion by chance."""
LARGEST_SHARE = 0.5
"""Of the residuals' squares that two motions leave, in place of none: gears and compliance make residuals of either
part differ, too, but no rigid motion explains half of them."""
LEAST_RATIO = 6.0
"""Of the step to its standard uncertainty."""


def frame_step_warnings(
    residuals_mm: Float[np.ndarray, "3 n"],
    positions_mm: Float[np.ndarray, "n 3"],
    order: Int[np.ndarray, " k"],
    labels: Sequence[str],
) -> tuple[Advisory, ...]:
    """Return the warning `frame_moved` where the poses divide into two of different frames.

    `order` are the poses that count, as they were measured, all of one frame; residuals are observed - predicted.
    """
    n = len(order)
    if n < 2 * LEAST_POSES:
        return ()
    r, p = residuals_mm[:, order].T, positions_mm[order]
    motions = np.concatenate([np.broadcast_to(np.eye(3), (n, 3, 3)), -hats(p - p.mean(axis=0))], axis=2)
    normal = np.cumsum(motions.swapaxes(1, 2) @ motions, axis=0)
    gradient = np.cumsum(np.einsum("nki,nk->ni", motions, r), axis=0)
    ends = np.arange(LEAST_POSES - 1, n - LEAST_POSES)  # the last pose of the first part
    before, after = normal[ends], normal[-1] - normal[ends]
    if min(np.linalg.matrix_rank(before[0]), np.linalg.matrix_rank(after[-1])) < 6:
        return ()  # positions on a line say nothing of a turn about it
    to_before, to_after = gradient[ends], gradient[-1] - gradient[ends]
    first = np.linalg.solve(before, to_before[:, :, None])[:, :, 0]
    second = np.linalg.solve(after, to_after[:, :, None])[:, :, 0]
    squares = float(np.sum(r * r))
    left = squares - np.sum(first * to_before, axis=1) - np.sum(second * to_after, axis=1)
    best = int(np.argmin(left))
    if not left[best] < LARGEST_SHARE * squares:
        return ()
    step = second[best] - first[best]
    variance = max(float(left[best]), 0.0) / (3 * n - 12)
    u = np.sqrt(variance * np.diag(np.linalg.inv(before[best]) + np.linalg.inv(after[best])))
    if not np.any(np.abs(step) > LEAST_RATIO * u):
        return ()
    at = int(ends[best]) + 1
    moved, turned = float(np.linalg.norm(step[:3])), float(np.degrees(np.linalg.norm(step[3:])))
    return (
        Advisory(
            "frame_moved",
            f"From pose {labels[order[at]]} on, number {at + 1} of {n} in the order of measuring, poses lie "
            f"{moved:.2g} mm and {turned:.1g}° from where the others have them: the instrument, the target "
            "or the robot's base moved in between, and all parameters are wrong by what that makes of them.",
            "Identify from each part in a session of its own, or measure again with everything fixed.",
        ),
    )
