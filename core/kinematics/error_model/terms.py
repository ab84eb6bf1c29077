"""Terms beyond Denavit-Hartenberg parameters, as columns of the linearised global fit.

With o_j the origin and x_j, y_j, z_j the axes of the frame that joint j turns in, p the end and
t_a = [a × (p - o_j); a] the twist of a small turn about an axis a of that frame:

    curve       t_z Σ_k (c_k cos k q_j + s_k sin k q_j), k = 1..60: gears and encoders
    compliance  t_z (z_j · M_j), with M_j the moment, about o_j, of the weight of the arm beyond the joint
    links       t_z (z_j · m_jl), with m_jl that of each link l from the joint on, the tool included, by itself; of the
                second joint and those beyond it, for the first one's axis is vertical
    radial      t_x (x_j · M_j) and t_y (y_j · M_j): bearings and links bend across the axis
    wobble      t_x, t_y and shifts along x_j, y_j, z_j, times cos q_j and sin q_j: the axis moves as the joint turns
    approach    t_z s_j, with s_j the sign of the joint's last move: play and friction leave it short of where it goes,
                where the order of measuring is known

Masses of links are not known. M_j is that of a unit weight at the centroid of the polyline from o_j to the end (links
of equal density), so that a coefficient is in rad per metre of lever; m_jl is that of one in the middle of the line
from one origin to the next. The former is what arms have in common, the latter how their weights differ from it:
without them the lengths of links take up the difference, by several times their uncertainties. Gravity is along the
base's z axis, or across it where the poses say so (`gravity`); a robot that hangs has the same columns with another
sign, which the prior does not mind.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from jaxtyping import Bool, Float, Int

from core.kinematics.arm_model import ArmState
from core.kinematics.dh import chain_frames

HARMONICS = 60
_MM_PER_M = 1000.0
ALONG_Z: Float[np.ndarray, "3"] = np.array([0.0, 0.0, 1.0])
"""Gravity of a robot that stands or hangs, in its base."""


class Kind(IntEnum):
    """What a column describes."""

    CURVE = 0
    COMPLIANCE = 1
    RADIAL = 2
    WOBBLE_TURN = 3
    WOBBLE_SHIFT = 4
    APPROACH = 5
    LINK_COMPLIANCE = 6


@dataclass(frozen=True, slots=True)
class Terms:
    """What each column is: its kind, its joint (from 0), and of curves the harmonic k (0 otherwise)."""

    kind: Int[np.ndarray, " c"]
    joint: Int[np.ndarray, " c"]
    harmonic: Int[np.ndarray, " c"]

    def __len__(self) -> int:
        return len(self.kind)

    def of(self, *kinds: Kind) -> Bool[np.ndarray, " c"]:
        """Mark the columns of these kinds."""
        return np.isin(self.kind, kinds)

    def curve(self, joint: int) -> Int[np.ndarray, " h"]:
        """Return the columns of a joint's curve: cosines of k = 1..60, then sines."""
        return np.flatnonzero((self.kind == Kind.CURVE) & (self.joint == joint))


def terms_of(joints: int, *, approach: bool = False) -> Terms:
    """Return what the columns of `term_columns` are, in their order; those of the last move where it is known."""
    kinds, of_joint = [], []
    for joint in range(joints):
        one = [Kind.CURVE] * (2 * HARMONICS) + [Kind.COMPLIANCE] + [Kind.RADIAL] * 2
        one += [Kind.WOBBLE_TURN] * 4 + [Kind.WOBBLE_SHIFT] * 6 + [Kind.APPROACH] * approach
        one += [Kind.LINK_COMPLIANCE] * _links_of(joint, joints)
        kinds += one
        of_joint += [joint] * len(one)
    k = np.arange(1, HARMONICS + 1)
    harmonics = np.zeros(len(kinds), dtype=np.intp)
    harmonics[np.array(kinds) == Kind.CURVE] = np.tile(k, 2 * joints)
    return Terms(np.array(kinds, dtype=np.intp), np.array(of_joint), harmonics)


def _links_of(joint: int, joints: int) -> int:
    """Return how many links a joint has levers of, the tool's included: none that turns about the vertical."""
    return joints + 1 - joint if joint else 0


def harmonic_basis(angles: Float[np.ndarray, " n"]) -> Float[np.ndarray, "h n"]:
    """Return cos k q, then sin k q, k = 1..60, of a joint's angles (rad)."""
    powers = np.empty((HARMONICS, len(angles)), dtype=np.complex128)
    powers[0] = np.exp(1j * angles)
    known = 1
    while known < HARMONICS:  # eⁱᵃ to the powers known + 1 .. 2 known: six roundings for the sixtieth
        more = min(known, HARMONICS - known)
        powers[known : known + more] = powers[:more] * powers[known - 1]
        known += more
    return np.concatenate([powers.real, powers.imag])


def term_columns(
    arm: ArmState,
    joint_angles: Float[np.ndarray, "n j"],
    target: Int[np.ndarray, " n"],
    approach: Float[np.ndarray, "n j"] | None = None,
    *,
    gravity: Float[np.ndarray, "3"] = ALONG_Z,
    out: Float[np.ndarray, "c m n"] | None = None,
) -> Float[np.ndarray, "c m n"]:
    """Return what each term does to poses (mm, rad, target frame), by its coefficient in rad, rad/m or mm.

    `approach` are the signs of the joints' last moves; without them there are no columns for these. `gravity` is its
    direction in the base, up or down. The answer is written to `out` where that is given, of positions alone if its m
    is 3.

    Memory grows with n times some 138 columns a joint: give poses in blocks.
    """
    n, joints = joint_angles.shape
    if out is None:
        out = np.empty((len(terms_of(joints, approach=approach is not None)), 6, n))
    m = out.shape[1]
    T = arm.T_target_base[target][:, None] @ chain_frames(arm.parameters, joint_angles)
    R, o = T[:, :, :3, :3], T[:, :, :3, 3]
    end = (T[:, -1] @ arm.T_flange_camera)[:, :3, 3]
    up = arm.T_target_base[target][:, :3, :3] @ gravity
    points = np.concatenate([o, end[:, None]], axis=1)
    middles = 0.5 * (points[:, 1:] + points[:, :-1])
    first = 0
    for joint in range(joints):
        q = joint_angles[:, joint]
        axes = np.moveaxis(R[:, joint], 2, 0)  # x, y, z
        turns = np.stack([_twist(axis, end - o[:, joint])[:m] for axis in axes])
        moment = np.cross(up, _centroid(points[:, joint:]) - o[:, joint]) / _MM_PER_M
        moments = np.einsum("ank,nk->an", axes, moment)
        wave = np.stack([np.cos(q), np.sin(q)])
        shifts = np.zeros_like(turns)
        shifts[:, :3] = axes.transpose(0, 2, 1)
        rest = out[first + 2 * HARMONICS :]
        np.multiply(turns[2], harmonic_basis(q)[:, None], out=out[first : first + 2 * HARMONICS])
        rest[0] = turns[2] * moments[2]
        rest[1:3] = turns[:2] * moments[:2, None]
        rest[3:7] = (turns[:2, None] * wave[None, :, None]).reshape(4, m, -1)
        rest[7:13] = (shifts[:, None] * wave[None, :, None]).reshape(6, m, -1)
        last = 13
        if approach is not None:
            rest[13] = turns[2] * approach[:, joint]
            last = 14
        links = _links_of(joint, joints)
        if links:
            across = np.cross(axes[2], up) / _MM_PER_M  # z · (up × lever) = lever · (z × up)
            levers = np.einsum("nlk,nk->ln", middles[:, joint:] - o[:, joint, None], across)
            rest[last : last + links] = turns[2] * levers[:, None]
        first += 2 * HARMONICS + last + links
    return out


def _twist(axis: Float[np.ndarray, "n 3"], arm: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "6 n"]:
    return np.concatenate([np.cross(axis, arm).T, axis.T])


def _centroid(points: Float[np.ndarray, "n k 3"]) -> Float[np.ndarray, "n 3"]:
    """Return the centroid of the polyline through the points, or the first where it has no length."""
    middles = 0.5 * (points[:, 1:] + points[:, :-1])
    lengths = np.linalg.norm(np.diff(points, axis=1), axis=2)
    total = lengths.sum(axis=1)
    weighted = np.einsum("nk,nkc->nc", lengths, middles)
    safe = np.where(total > 0.0, total, 1.0)
    return np.where(total[:, None] > 0.0, weighted / safe[:, None], points[:, 0])
