"""Whether joint curves last: does a second session of the robot, with base and tool fitted anew, confirm them.

On arms with harmonic drives curves hold for months; on others they win within a session and lose in the next. The
second session's poses are compared with what the first session's model predicts, once with curves and once without:

    T_2(q) = A · T_1(q) · Y,   A and Y rigid, fitted

Below `MAX_CONFIRMING_RATIO` of the rms distances of positions, the curves are confirmed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from core.geometry import hats, invert, rotations_from_vectors
from core.kinematics.correction.model import CorrectionModel, poses_of
from core.kinematics.error_model import ErrorModel, Level
from core.numerics import MEDIAN_LENGTH

MAX_CONFIRMING_RATIO = 0.95
MIN_CONFIRMING_POSES = 30
_ITERATIONS = 8
_REJECTION = 5.0


def curves_ratio(first: CorrectionModel, second: ErrorModel) -> float | None:
    """Return the second session's position error with the first one's curves by that without them.

    None where it has too few configurations before its first target to say.
    """
    problem = second.fit.design
    some = np.flatnonzero(problem.seen.target == 0)
    if len(some) < MIN_CONFIRMING_POSES:
        return None
    q, arm = problem.seen.joint_angles[some], problem.arm
    # Means over visits: the arm's prediction, and the mean of what was observed beyond it.
    predicted = poses_of(arm, q)
    observed = predicted[:, :3, 3] + problem.residuals[:3, some].T
    A, Y = _frames(first.model, second)
    with_curves, without = (
        _aligned_error(replace(first, level=level).attained(q), observed, A, Y)
        for level in (Level.ALL, Level.COMPLIANCE)
    )
    return with_curves / without


def _frames(
    first: ErrorModel, second: ErrorModel
) -> tuple[Float[np.ndarray, "4 4"], Float[np.ndarray, "4 4"]]:
    """Return A and Y of the two identifications, where the fit begins."""
    a, b = first.fit.design.arm, second.fit.design.arm
    return b.T_target_base[0] @ invert(a.T_target_base[0]), invert(a.T_flange_camera) @ b.T_flange_camera


def _aligned_error(
    T: Float[np.ndarray, "n 4 4"],
    observed: Float[np.ndarray, "n 3"],
    A: Float[np.ndarray, "4 4"],
    Y: Float[np.ndarray, "4 4"],
) -> float:
    """Return the rms distance after the best A and shift of Y; gross errors do not count."""
    y = Y[:3, 3].copy()
    keep = np.ones(len(T), dtype=np.bool_)
    r = np.zeros((len(T), 3))
    for _ in range(_ITERATIONS):
        before = T[:, :3, :3] @ y + T[:, :3, 3]
        end = before @ A[:3, :3].T + A[:3, 3]
        r = observed - end
        lengths = np.linalg.norm(r, axis=1)
        keep = lengths <= _REJECTION * float(np.median(lengths)) / MEDIAN_LENGTH[3]
        J = np.zeros((len(T), 3, 9))
        J[:, :, :3] = np.eye(3)
        J[:, :, 3:6] = -hats(end)
        J[:, :, 6:] = A[:3, :3] @ T[:, :3, :3]
        step = np.linalg.lstsq(J[keep].reshape(-1, 9), r[keep].ravel(), rcond=None)[0]
        move = np.eye(4)
        move[:3, :3] = rotations_from_vectors(step[None, 3:6])[0]
        A = move @ A
        A[:3, 3] += step[:3]
        y = y + step[6:]
    return float(np.sqrt(np.mean(np.sum(r[keep] ** 2, axis=1))))
