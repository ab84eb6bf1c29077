"""Base and tool of a given chain in closed form, from poses.

Rotations: R_obs = X R_B Z is bilinear, and the target with the most poses determines Z (`frame_rotations`); every
target's X follows from Z by Procrustes. Then positions are linear in both translations.

Where all turns R_B share an axis v, rotations leave a turn of X about v open, and positions determine it: X takes v to
the axis u that the poses turn about, X = U Rz(φ) Vᵀ with v and u the third columns of V and U. As X R_B t_Z = R_obs τ,

    p_obs = R_obs τ + t_X + U (c x - s y, s x + c y, z),      (x, y, z) = Vᵀ p_B

is linear in τ, t_X, c and s, and φ = atan2(s, c).

References: M. Shah, J. Mechanisms Robotics 5 (2013) 031007, 10.1115/1.4024473.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from core.calibration import frame_rotations, turn_by_positions
from core.geometry import nearest_rotation, perpendicular, transform
from core.kinematics.arm_model import ArmState
from core.kinematics.global_fit.residuals import Observations, linearised

MIN_SECOND_AXIS = 0.1
"""Of the turns about the first axis: with less about a second one, positions may place the arm better."""
MIN_THICKNESS = 0.01
"""Of the extent of positions: thinner ones lie in a plane, but for noise and tilted axes."""
MIN_APART = 0.01
"""Of the flange's way: the share of it that is no turning about one point. With less all axes meet there, or nearly."""
_MM, _RAD = 1.0, 1e-3  # like weights of what is off, to choose between two placements


def placed(
    parameters: Float[np.ndarray, "j 5"], T_base_flange: Float[np.ndarray, "n 4 4"], seen: Observations
) -> ArmState:
    """Return the arm of a chain with tool and bases in closed form.

    Of positions alone, Xᵀ (p - t_X) - R_B t_Z = p_B is linear in Xᵀ, Xᵀ t_X and t_Z; the tool's rotation, which they do
    not determine, is the identity.
    """
    if seen.rotations is None:
        return placed_with_tool(parameters, T_base_flange, seen, np.eye(3))
    some = np.flatnonzero(seen.target == int(np.argmax(np.bincount(seen.target))))
    R_Z, _ = frame_rotations(T_base_flange[some, :3, :3], seen.rotations[some])
    arm = placed_with_tool(parameters, T_base_flange, seen, R_Z)
    R_shared = _tool_by_shared_axis(T_base_flange[some], seen.positions_mm[some], seen.rotations[some])
    if R_shared is None:
        return arm
    other = placed_with_tool(parameters, T_base_flange, seen, R_shared)
    return min(arm, other, key=lambda one: _off(one, seen))


def placed_with_tool(
    parameters: Float[np.ndarray, "j 5"],
    T_base_flange: Float[np.ndarray, "n 4 4"],
    seen: Observations,
    R_Z: Float[np.ndarray, "3 3"],
) -> ArmState:
    """Return the arm of a chain with a known rotation of the tool, the rest in closed form as in `placed`."""
    layout = seen.layout
    R_B, p_B = T_base_flange[:, :3, :3], T_base_flange[:, :3, 3]
    members = [np.flatnonzero(seen.target == t) for t in range(layout.targets)]
    if seen.rotations is None:
        turns = [_turn_by_positions(T_base_flange[i], seen.positions_mm[i]) for i in members]
    else:
        turns = [
            nearest_rotation(np.einsum("nij,nkj->ik", seen.rotations[i], R_B[i] @ R_Z))
            if len(i)
            else np.eye(3)
            for i in members
        ]
    X = np.array(turns)
    # p_obs = X (p_B + R_B t_Z) + t_X
    A = np.zeros((len(seen), 3, 3 + 3 * layout.targets))
    A[:, :, :3] = X[seen.target] @ R_B
    for t, of_target in enumerate(members):
        A[of_target, :, 3 + 3 * t : 6 + 3 * t] = np.eye(3)
    b = seen.positions_mm - np.einsum("nij,nj->ni", X[seen.target], p_B)
    found = np.linalg.lstsq(A.reshape(-1, A.shape[2]), b.ravel(), rcond=None)[0]
    return ArmState(
        parameters,
        transform(R_Z, found[:3]),
        np.array([transform(X[t], found[3 + 3 * t : 6 + 3 * t]) for t in range(layout.targets)]),
        np.zeros(layout.shared),
    )


def _tool_by_shared_axis(
    T_base_flange: Float[np.ndarray, "n 4 4"], p: Float[np.ndarray, "n 3"], R: Float[np.ndarray, "n 3 3"]
) -> Float[np.ndarray, "3 3"] | None:
    """Return the tool's rotation by the axis that all turns share; None where they have a second one."""
    R_B, p_B = T_base_flange[:, :3, :3], T_base_flange[:, :3, 3]
    turns_B, turns = _turns(R_B), _turns(R)
    _, sizes, Vt = np.linalg.svd(turns_B, full_matrices=False)
    if len(sizes) > 1 and sizes[1] > MIN_SECOND_AXIS * sizes[0]:
        return None
    v = Vt[0]
    u = turns.T @ (turns_B @ v)
    length = float(np.linalg.norm(u))
    if not length > 0.0:
        return None
    V, U = _with_third(v), _with_third(u / length)
    x, y, z = V.T @ p_B.T
    n = len(p)
    A = np.zeros((n, 3, 8))
    A[:, :, :3] = R
    A[:, :, 3:6] = np.eye(3)
    A[:, :, 6] = np.stack([x, y, np.zeros(n)], axis=1) @ U.T
    A[:, :, 7] = np.stack([-y, x, np.zeros(n)], axis=1) @ U.T
    b = p - z[:, None] * U[:, 2]
    c, s = np.linalg.lstsq(A.reshape(-1, 8), b.ravel(), rcond=None)[0][6:].tolist()
    phi = math.atan2(s, c)
    about = np.array(
        [[math.cos(phi), -math.sin(phi), 0.0], [math.sin(phi), math.cos(phi), 0.0], [0.0, 0.0, 1.0]]
    )
    X = U @ about @ V.T
    return nearest_rotation(np.einsum("nji,kj,nkl->il", R_B, X, R))


def _turns(R: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "n 3"]:
    """Return the axes of turns from the first rotation on, as long as the sine of each."""
    S = R @ R[0].T
    return np.stack([S[:, 2, 1] - S[:, 1, 2], S[:, 0, 2] - S[:, 2, 0], S[:, 1, 0] - S[:, 0, 1]], axis=1) / 2.0


def _with_third(axis: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Return a rotation whose third column is the axis."""
    first = perpendicular(axis)
    return np.column_stack([first, np.cross(axis, first), axis])


def _off(arm: ArmState, seen: Observations) -> float:
    r, _ = linearised(arm, seen)
    return float(np.sum((r[:3] / _MM) ** 2) + np.sum((r[3:] / _RAD) ** 2))


def _turn_by_positions(
    T_base_flange: Float[np.ndarray, "n 4 4"], p: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "3 3"]:
    """Return X of p = X (p_B + R_B t_Z) + t_X by linear least squares.

    Positions count from their mean. Where they lie nearly in a plane, what is across it is taken for zero: the fit of
    least length then leaves that part of X to the other two. Where all axes meet in one point, p_B is itself R_B v + w,
    and X = 0 solves the linear equations: X is then searched for among rotations.
    """
    if not len(p):
        return np.eye(3)
    R_B, p_B = T_base_flange[:, :3, :3], T_base_flange[:, :3, 3]
    apart = p - p.mean(axis=0)
    _, sizes, Vt = np.linalg.svd(apart, full_matrices=False)
    if len(sizes) == 3 and sizes[2] < MIN_THICKNESS * sizes[0]:
        apart = apart @ Vt[:2].T @ Vt[:2]
    A = np.zeros((len(p), 3, 15))
    for k in range(3):
        A[:, k, 3 * k : 3 * k + 3] = apart
    A[:, :, 9:12] = -R_B
    A[:, :, 12:] = -np.eye(3)
    equations, b = A.reshape(-1, 15), p_B.ravel()
    turning = equations[:, 9:]
    left = b - turning @ np.linalg.lstsq(turning, b, rcond=None)[0]
    if np.linalg.norm(left) <= MIN_APART * np.linalg.norm(p_B - p_B.mean(axis=0)):
        return turn_by_positions(p, T_base_flange)
    found = np.linalg.lstsq(equations, b, rcond=None)[0]
    return nearest_rotation(found[:9].reshape(3, 3)).T
