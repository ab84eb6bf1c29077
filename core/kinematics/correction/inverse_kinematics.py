"""Joint angles of a chain from the pose of its flange, by damped Newton steps from known configurations.

A commanded pose alone leaves open how the arm reaches it. The solution nearest a configuration at which the arm was
measured is the likeliest: there the identification holds. Steps from a configuration whose end is near may lead to one
whose joints are far, or beyond what was measured: solutions from several are compared by their joint angles.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from core.geometry import rotation_vectors
from core.kinematics.arm_model import THETA
from core.kinematics.dh import Chain, forward, pose_with_jacobian

STARTS = 4
"""Configurations whose ends are nearest, which are tried for each pose."""
_ITERATIONS = 60
_LEVER_MM = 300.0
_MAX_STEP = 0.3  # rad
_ATTAINED_MM = 1e-6
_DAMPING = 1e-8
_TURN = 2.0 * math.pi


@dataclass(frozen=True, slots=True)
class InverseSolution:
    """Joint angles (rad) for each pose, and which poses they attain."""

    joint_angles: Float[np.ndarray, "n j"]
    attained: Bool[np.ndarray, " n"]


def solve_inverse(
    chain: Chain, T_base_flange: Float[np.ndarray, "n 4 4"], known: Float[np.ndarray, "k j"]
) -> InverseSolution:
    """Return joint angles at which the flange has these poses.

    Parameters
    ----------
    T_base_flange
        In the chain's base, mm.
    known
        Configurations to begin at, rad. Of the solutions found for a pose one within their range is taken, and of such
        the one nearest to any of them.
    """
    n = len(T_base_flange)
    q, attained, least = np.zeros((n, len(chain))), np.zeros(n, dtype=np.bool_), np.full((2, n), np.inf)
    order, near = _nearest(T_base_flange, forward(chain, known)), KDTree(known)
    low, high = known.min(axis=0), known.max(axis=0)
    for start in known[order].swapaxes(0, 1):
        found, reached = _descended(chain, T_base_flange, start)
        found -= _TURN * np.round((found - 0.5 * (low + high)) / _TURN)
        off = np.stack(
            [np.maximum(np.maximum(low - found, found - high), 0.0).max(axis=1), near.query(found)[0]]
        )
        nearer = (off[0] < least[0]) | ((off[0] == least[0]) & (off[1] < least[1]))
        better = np.where(reached == attained, nearer, reached)
        q[better], attained[better], least[:, better] = found[better], reached[better], off[:, better]
    return InverseSolution(q, attained)


def _nearest(T: Float[np.ndarray, "n 4 4"], at: Float[np.ndarray, "k 4 4"]) -> Int[np.ndarray, "n s"]:
    """Return, for each of the poses `T`, which of the poses `at` are nearest, the nearest first."""
    off = np.linalg.norm(at[:, :3, 3] - T[:, None, :3, 3], axis=2)
    traces = np.einsum("nij,kij->nk", T[:, :3, :3], at[:, :3, :3])
    turn = np.arccos(np.clip(0.5 * (traces - 1.0), -1.0, 1.0))
    return np.argsort(off + _LEVER_MM * turn, axis=1, kind="stable")[:, :STARTS]


def _descended(
    chain: Chain, T: Float[np.ndarray, "n 4 4"], q: Float[np.ndarray, "n j"]
) -> tuple[Float[np.ndarray, "n j"], Bool[np.ndarray, " n"]]:
    parameters, n = chain.as_array(), len(T)
    columns = 5 * np.arange(len(chain)) + THETA
    scale = np.array([1.0] * 3 + [_LEVER_MM] * 3)
    q = np.array(q, dtype=np.float64)
    off, left = np.full(n, np.inf), np.arange(n)  # most are there after a few steps
    for _ in range(_ITERATIONS):
        base = np.ascontiguousarray(np.broadcast_to(np.eye(4), (len(left), 4, 4)))
        end, J = pose_with_jacobian(parameters, q[left], base, np.eye(4))
        turned = rotation_vectors(T[left, :3, :3], end[:, :3, :3])
        away = np.concatenate([(T[left, :3, 3] - end[:, :3, 3]).T, turned.T])
        away *= scale[:, None]
        off[left] = np.abs(away).max(axis=0)
        far = off[left] >= _ATTAINED_MM
        if not far.any():
            break
        left = left[far]
        rows = (J[columns][:, :, far] * scale[:, None]).transpose(2, 1, 0)
        normal = rows.transpose(0, 2, 1) @ rows
        normal += _DAMPING * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(len(chain))
        step = np.linalg.solve(normal, rows.transpose(0, 2, 1) @ away[:, far].T[:, :, None])[..., 0]
        shorter = np.minimum(1.0, _MAX_STEP / np.maximum(np.abs(step).max(axis=1), 1e-12))
        q[left] += step * shorter[:, None]
    return q, np.asarray(off < 1e3 * _ATTAINED_MM)
