"""Equal descriptions of one chain: of every x axis along a common normal, or against it, one is chosen.

With G = Rz(π), Rz(θ) Tz(d) Tx(a) Rx(α) Ry(β) G = Rz(θ + π) Tz(d) Tx(-a) Rx(-α) Ry(-β). To reverse x of frame i,
which costs G at its end and G at the next link's start, changes the signs of a_i, α_i, β_i and adds π to θ_i and
θ_{i+1}: every pose stays. z axes have no such freedom, the encoders count about them. Of θ_1 the base takes the turn,
of the last θ the tool, T_flange_camera' = L⁻¹ G L T_flange_camera with L = Tz(d) Tx(a) Rx(α) Ry(β) of the last
joint, so that conventions keep their values. An arm of j joints has 2^(j-1) equal descriptions.

Nearest to a reference is the one of the least

    Σ (α_i - α_i')² + (β_i - β_i')² + ((a_i - a_i') / reach)² + 0.1 (θ_i - θ_i')²

over the links but the last, θ but the first; since θ_i depends on the reversals of frames i-1 and i, the minimum is
found link by link.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from core.geometry import transform
from core.kinematics.arm_model import ALPHA, BETA, THETA, A, ArmState, D
from core.kinematics.dh import link_transform

THETA_WEIGHT = 0.1
"""Offsets of joints count for less than the links: a nominal robot's are often stated for another zero."""
MIDDLE_ANGLE = math.radians(5.0)
"""Of angles without a reference: those of arms are near multiples of a quarter turn, and away from the ends."""
SIGNIFICANT = 3.0
"""Of the uncertainty of a: axes nearer to each other may meet."""
_HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])

Reversals = Bool[np.ndarray, " l"]
"""Of the frames at the ends of all links but the last: whether x is reversed."""


def turn(angles: Float[np.ndarray, "*s"]) -> Float[np.ndarray, "*s"]:
    """Return angles in (-π, π]."""
    return np.asarray(math.pi - np.mod(math.pi - angles, 2.0 * math.pi))


def unwrapped(
    parameters: Float[np.ndarray, "j 5"], reference: Float[np.ndarray, "j 5"] | None
) -> Float[np.ndarray, "j 5"]:
    """Return the parameters with angles within half a turn of the reference's; without one from -175° to 185°, so that
    none jumps whose nominal value is half a turn.
    """
    found = parameters.copy()
    for angle in (ALPHA, THETA, BETA):
        middle = MIDDLE_ANGLE if reference is None else reference[:, angle]
        turns = np.round((middle - parameters[:, angle]) / (2.0 * math.pi))
        found[:, angle] += 2.0 * math.pi * turns
    return found


def nearest_description(
    parameters: Float[np.ndarray, "j 5"],
    reference: Float[np.ndarray, "j 5"],
    tied: Sequence[bool] | None = None,
) -> Reversals:
    """Return the reversals that bring a chain next to the reference, none where both are as near.

    `tied` are joints whose θ has to stay: x before and behind are reversed together, and that before the first never.
    """
    links = len(parameters) - 1
    reach = float(np.abs(reference[:, [A, D]]).sum()) + 1.0
    # cost[s] of the best reversals so far that end with s, and the choice of the frame before
    cost = np.array([0.0, math.inf])
    before = np.zeros((links, 2), dtype=np.intp)
    for i in range(links):
        own, other = parameters[i], reference[i]
        of_link = np.empty(2)
        for s, sign in enumerate((1.0, -1.0)):
            angles = turn(sign * own[[ALPHA, BETA]] - other[[ALPHA, BETA]])
            of_link[s] = float(angles @ angles) + ((sign * own[A] - other[A]) / reach) ** 2
        through = cost[:, None] + of_link
        off = turn(own[THETA] + math.pi * np.array([[0.0, 1.0], [1.0, 0.0]]) - other[THETA])
        if i:
            through += THETA_WEIGHT * off**2
        if tied is not None and tied[i]:
            through[[0, 1], [1, 0]] = math.inf
        before[i] = np.argmin(through, axis=0)
        cost = through.min(axis=0)
    reversals = np.zeros(links, dtype=np.bool_)
    s = int(cost[1] < cost[0]) if links else 0
    for i in reversed(range(links)):
        reversals[i] = bool(s)
        s = int(before[i, s])
    return reversals


def positive_description(
    parameters: Float[np.ndarray, "j 5"],
    sigma_a: Float[np.ndarray, " l"],
    tied: Sequence[bool] | None = None,
) -> Reversals:
    """Return the reversals after which a > 0, or α > 0 where a does not differ from zero significantly.

    `sigma_a` is the uncertainty of each a but the last, mm; `tied` as of `nearest_description`.
    """
    reversals = np.zeros(len(parameters) - 1, dtype=np.bool_)
    for i, sigma in enumerate(sigma_a.tolist()):
        if tied is not None and tied[i]:
            reversals[i] = i > 0 and reversals[i - 1]
        elif abs(parameters[i, A]) > SIGNIFICANT * sigma + 1e-6:
            reversals[i] = parameters[i, A] < 0.0
        else:
            reversals[i] = math.sin(parameters[i, ALPHA]) < 0.0
    return reversals


def with_reversals(parameters: Float[np.ndarray, "j 5"], reversals: Reversals) -> Float[np.ndarray, "j 5"]:
    """Return the parameters of the same chain with these x axes reversed, θ of the first and last joint as they are."""
    found = parameters.copy()
    links = len(reversals)
    found[:links, [A, ALPHA, BETA]] *= np.where(reversals, -1.0, 1.0)[:, None]
    turned = np.flatnonzero(reversals[1:] ^ reversals[:-1]) + 1
    found[turned, THETA] = turn(found[turned, THETA] + math.pi)
    changed = np.flatnonzero(reversals)
    found[changed, ALPHA] = turn(found[changed, ALPHA])
    return found


def described(arm: ArmState, reversals: Reversals, *, tool_turns: bool = True) -> ArmState:
    """Return the same arm with these x axes reversed; base and tool take the turns of the first and the last θ.

    `tool_turns` is false where the poses are positions alone: the tool's rotation, which they do not determine, stays.
    """
    if not reversals.any():
        return arm
    tool, bases = arm.T_flange_camera, arm.T_target_base
    if reversals[-1]:
        a, alpha, d, _, beta = arm.parameters[-1].tolist()
        L = link_transform(a, alpha, d, beta)
        moved = np.linalg.inv(L) @ _HALF_TURN @ L @ tool
        tool = moved if tool_turns else transform(tool[:3, :3], moved[:3, 3])
    if reversals[0]:
        bases = bases @ _HALF_TURN
    return replace(
        arm,
        parameters=with_reversals(arm.parameters, reversals),
        T_flange_camera=tool,
        T_target_base=bases,
    )


def height_over_flange(
    parameters: Float[np.ndarray, "j 5"], tool_mm: Float[np.ndarray, "3"]
) -> tuple[float, Float[np.ndarray, "3"]]:
    """Return how far to move an arm along its first axis, and the tool by its position on the flange, mm, so that the
    flange is level with the measured point and the point stays. Of arms whose axes are all parallel.

    Level: the first coordinate of the tool that such a move changes is zero. No pose determines it, and the planes
    across the axes in which near-parallel links are described move with it.
    """
    _, alpha, _, _, beta = parameters[-1].tolist()
    axis = link_transform(0.0, alpha, 0.0, beta)[2, :3]
    along = int(np.argmax(np.abs(axis) > 1e-3))
    height = float(tool_mm[along] / axis[along])
    senses = np.sign(np.cos(parameters[:-1, ALPHA]))
    return height * float(np.prod(senses)), np.asarray(-height * axis)


def level_with_point(
    arm: ArmState, free: Bool[np.ndarray, " p"], parallel: Bool[np.ndarray, " j"]
) -> ArmState:
    """Return the arm with its flange level with the measured point, where all axes are parallel.

    Base and tool share their position along the axes. Near-parallel axes are described by where they pierce planes
    across one another, and these planes stand at the flange's height: parameters would depend on an arbitrary one.
    """
    position = slice(arm.layout.tool.start, arm.layout.tool.start + 3)
    if not parallel[:-1].all() or free[position].all():
        return arm
    height, by = height_over_flange(arm.parameters, arm.T_flange_camera[:3, 3])
    tool, bases = arm.T_flange_camera.copy(), arm.T_target_base.copy()
    tool[:3, 3] += by
    bases[:, :3, 3] += height * bases[:, :3, 2]
    return replace(arm, T_flange_camera=tool, T_target_base=bases)
