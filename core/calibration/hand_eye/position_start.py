"""Where the fit to commanded positions begins: the best of some rotations, each improved by rigid alignment."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np
from jaxtyping import Float

from core.calibration.hand_eye.position_model import (
    PositionProblem,
    PositionState,
    observable_directions,
    residuals,
)
from core.geometry import nearest_rotation, transform

_SIGNS = [np.diag(signs) for signs in product((1.0, -1.0), repeat=3)]
_TURNS = [S @ np.eye(3)[list(order)] for order in permutations(range(3)) for S in _SIGNS]
_CUBE = [R for R in _TURNS if np.linalg.det(R) > 0]


def turn_by_positions(
    positions_mm: Float[np.ndarray, "n 3"], T: Float[np.ndarray, "n 4 4"]
) -> Float[np.ndarray, "3 3"]:
    """Return the rotation X with positions = X (t_n + R_n point) + place, point and place unknown: the best start.

    It is near the answer also where t_n itself is R_n v + w, as of a robot whose axes all meet in one point.
    """
    unstated = np.broadcast_to(np.zeros((6, 6)), (len(T), 6, 6))
    problem = PositionProblem(positions_mm, T, unstated, observable_directions(T[:, :3, :3]))
    return best_start(problem).T_base_target[:3, :3]


def best_start(problem: PositionProblem) -> PositionState:
    """Return the best of some rotations, each with the point and place that suit it by linear least squares.

    The rotations are that of the rigid alignment with the point in the camera's centre, which is near where the point
    is near, and the 24 of a cube; each is improved by the same alignment, with the point known, a few times.
    """
    inverse = _placing(problem)
    size = problem.free.shape[1]
    rotations = np.concatenate([_aligned(np.zeros((1, 3)), problem), _CUBE])
    for _ in range(10):
        points = _placed(rotations, problem, inverse)[:, :size] @ problem.free.T
        rotations = _aligned(points, problem)
    found = _placed(rotations, problem, inverse)
    states = [
        PositionState(transform(R, R @ x[size:]), problem.free @ x[:size])
        for R, x in zip(rotations, found, strict=True)
    ]
    costs = [float(np.median(np.linalg.norm(residuals(state, problem), axis=1))) for state in states]
    return states[int(np.argmin(costs))]


def _aligned(points: Float[np.ndarray, "s 3"], problem: PositionProblem) -> Float[np.ndarray, "s 3 3"]:
    """Return for each point in the camera the rotation that best turns its places in the target to the commanded."""
    inside = problem.measured[:, :3, 3] + np.einsum("nij,sj->sni", problem.measured[:, :3, :3], points)
    commanded = problem.commanded - problem.commanded.mean(axis=0)
    return nearest_rotation(commanded.T @ (inside - inside.mean(axis=1, keepdims=True)))


def _placing(problem: PositionProblem) -> Float[np.ndarray, "u m"]:
    """Return what takes the commanded positions, turned into the target's frame, to the point and the place there.

    R_n p + Rᵀ t = Rᵀ c_n - m_n: in that frame the equations are the same for every R, so that one inverse serves all.
    """
    by_point = problem.measured[:, :3, :3] @ problem.free
    A = np.concatenate([by_point, np.broadcast_to(np.eye(3), (len(by_point), 3, 3))], axis=2)
    A = A.reshape(-1, A.shape[2])
    return np.linalg.pinv(A, rcond=max(A.shape) * float(np.finfo(np.float64).eps))


def _placed(
    rotations: Float[np.ndarray, "s 3 3"], problem: PositionProblem, inverse: Float[np.ndarray, "u m"]
) -> Float[np.ndarray, "s u"]:
    """Return for each rotation the point's free coordinates and Rᵀ t of least squares."""
    b = problem.commanded @ rotations - problem.measured[:, :3, 3]
    return b.reshape(len(rotations), -1) @ inverse.T
