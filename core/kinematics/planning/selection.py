"""Choice of poses by exchange: the candidates that, together, raise Borm and Menq's observability index O1 most.

O1 is the geometric mean of all singular values, to which poses with Jacobians J add log det(1 + J M⁻¹ Jᵀ) over twice
their number, M being the information of the poses so far. The choice begins with one candidate after another (greedy)
and is improved by excursions: k candidates are added, each the best at its turn, and the k least useful removed; an
excursion that does not raise the determinant is undone, and a longer one tried. What is returned is in the order of
what each adds to those before it.

References: J.-H. Borm, C.-H. Menq, Int. J. Robotics Research 10 (1991) 584-597; T. J. Mitchell, Technometrics 16 (1974)
203-210, 10.1080/00401706.1974.10489175 (DETMAX); Y. Sun, J. M. Hollerbach, ICRA 2008 (active calibration).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from core.kinematics.arm_model import ArmState
from core.kinematics.dh import Chain, forward
from core.kinematics.global_fit import DEFAULT_SCATTER, Observations, fix_gauge, linearised, scaled
from core.kinematics.planning.camera_setup import CameraSetup, count_visible_points

LONGEST_EXCURSION = 4
_MAX_EXCURSIONS = 100
_MIN_GAIN = 1e-9  # of log det: less is rounding
_UNDETERMINED = 1e-9
"""Of the mean information: directions that no pose determines yet count first."""


def suggest_poses(
    chain: Chain,
    joint_angles: Float[np.ndarray, "n j"],
    candidates: Float[np.ndarray, "c j"],
    rig: CameraSetup,
    count: int,
) -> Int[np.ndarray, " s"]:
    """Return which candidates to add to the poses at `joint_angles` (rad), in the order of what they add; fewer than
    `count` where no more of them see the grid.
    """
    arm = ArmState(chain.as_array(), rig.T_flange_camera, rig.T_target_base[None], np.zeros(0))
    open_ones = np.flatnonzero(count_visible_points(chain, candidates, rig))
    seen = _exact(arm, np.concatenate([joint_angles, candidates[open_ones]]))
    gauge = fix_gauge(arm, seen, DEFAULT_SCATTER)
    J = scaled(arm, linearised(arm, seen)[1])[gauge.free].transpose(2, 1, 0)
    base, pool = J[: len(joint_angles)], J[len(joint_angles) :]
    M = np.einsum("nmp,nmq->pq", base, base)
    M = M + _UNDETERMINED * np.trace(M) / len(M) * np.eye(len(M))
    return open_ones[choose_informative(M, pool, count)]


def choose_informative(
    information: Float[np.ndarray, "p p"], pool: Float[np.ndarray, "c m p"], count: int
) -> Int[np.ndarray, " s"]:
    """Return which `count` candidates, with Jacobians `pool`, raise the determinant of the information most, in the
    order of what they add; all of them where there are no more.
    """
    count = min(count, len(pool))
    everything = np.ones(len(pool), dtype=np.bool_)
    chosen, M = _grown(information, pool, everything, count)
    best = float(np.linalg.slogdet(M)[1])
    length = 1
    for _ in range(_MAX_EXCURSIONS):
        if length > min(LONGEST_EXCURSION, len(pool) - count):
            break
        left = everything.copy()
        left[chosen] = False
        added, there = _grown(M, pool, left, length)
        tried, there = _shrunk(there, pool, [*chosen, *added], length)
        value = float(np.linalg.slogdet(there)[1])
        if value > best + _MIN_GAIN:
            chosen, M, best, length = tried, there, value, 1
        else:
            length += 1
    taken = np.zeros(len(pool), dtype=np.bool_)
    taken[chosen] = True
    return np.array(_grown(information, pool, taken, count)[0], dtype=np.intp)


def _grown(
    M: Float[np.ndarray, "p p"], pool: Float[np.ndarray, "c m p"], left: Bool[np.ndarray, " c"], count: int
) -> tuple[list[int], Float[np.ndarray, "p p"]]:
    """Return the candidates that are added one after another, and the information with them."""
    left = left.copy()
    chosen: list[int] = []
    for _ in range(count):
        gained = np.linalg.slogdet(
            np.eye(pool.shape[1]) + pool @ np.linalg.solve(M, pool.transpose(0, 2, 1))
        )[1]
        best = int(np.argmax(np.where(left, gained, -np.inf)))
        chosen.append(best)
        left[best] = False
        M = M + pool[best].T @ pool[best]
    return chosen, M


def _shrunk(
    M: Float[np.ndarray, "p p"], pool: Float[np.ndarray, "c m p"], chosen: list[int], count: int
) -> tuple[list[int], Float[np.ndarray, "p p"]]:
    """Return the candidates without those that are removed one after another, and the information without these."""
    chosen = list(chosen)
    for _ in range(count):
        J = pool[chosen]
        kept = np.linalg.slogdet(np.eye(J.shape[1]) - J @ np.linalg.solve(M, J.transpose(0, 2, 1)))[1]
        worst = chosen.pop(int(np.argmax(kept)))
        M = M - pool[worst].T @ pool[worst]
    return chosen, M


def _exact(arm: ArmState, joint_angles: Float[np.ndarray, "n j"]) -> Observations:
    """Return poses that the arm attains, of an instrument without noise."""
    T = arm.T_target_base[0] @ forward(arm.chain, joint_angles) @ arm.T_flange_camera
    n = len(T)
    return Observations(
        np.ascontiguousarray(joint_angles),
        T[:, :3, 3],
        T[:, :3, :3],
        np.zeros((n, 6, 6)),
        np.zeros((n, 6, 0)),
        np.zeros(n, dtype=np.intp),
    )
