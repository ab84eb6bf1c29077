"""Axes brought to one configuration: arcs at other settings of the joints before, arcs seen on other targets.

At a setting q the axis of joint i is where the joints before it have taken it from its place at home h:

    axis_i(q) = E_1 E_2 … E_{i-1} axis_i(h),      E_j the turn by q_j - h_j about axis j at home,

(product of exponentials), so axes can be brought home one after the other from the base outward. Joints after i do not
move it. Arcs of one joint are then averaged, weighted by their covariances.

References: R. W. Brockett, "Robotic manipulators and the product of exponentials formula", Mathematical Theory of
Networks and Systems, 1984, 120-129, 10.1007/BFb0031048.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from core.geometry import hat, hats, rotations_about, so3_exp
from core.kinematics.circle_point_analysis.common_normals import Axes
from core.kinematics.sweeps import Sweep


@dataclass(frozen=True, slots=True)
class Lines:
    """The arcs' axes as fitted, each in its own target's frame; `bases` are the directions of their covariance.

    `roots` (a, 4, 4) are R with RᵀR the information on (point along e1, e2; direction about e1, e2).
    """

    points: Float[np.ndarray, "a 3"]
    directions: Float[np.ndarray, "a 3"]
    bases: Float[np.ndarray, "a 3 2"]
    roots: Float[np.ndarray, "a 4 4"]
    joints: Int[np.ndarray, " a"]
    settings: Float[np.ndarray, "a j"]
    targets: Int[np.ndarray, " a"]

    def moved(self, arc: int, step: Float[np.ndarray, "4"]) -> Lines:
        """Return the lines with one of them off by (point, direction) along its basis."""
        points, directions = self.points.copy(), self.directions.copy()
        points[arc] += self.bases[arc] @ step[:2]
        directions[arc] = so3_exp(self.bases[arc] @ step[2:]) @ directions[arc]
        return Lines(points, directions, self.bases, self.roots, self.joints, self.settings, self.targets)


def find_home(sweeps: Sequence[Sweep], joints: int, tolerance: float) -> Float[np.ndarray, " j"]:
    """Return for each joint the angle (rad) at which it rests in most poses of the others' sweeps."""
    home = np.zeros(joints)
    for joint in range(joints):
        resting = [s for s in sweeps if s.joint != joint]
        if not resting:
            home[joint] = 0.5 * (sweeps[0].angles[0] + sweeps[0].angles[-1])
            continue
        at = np.array([s.setting[joint] for s in resting])
        weight = np.array([float(len(s.poses)) for s in resting])
        near = np.abs(at[:, None] - at[None, :]) <= 2.0 * tolerance
        best = near[int(np.argmax(near @ weight))]
        home[joint] = float(np.average(at[best], weights=weight[best]))
    return home


def axes_at_home(
    lines: Lines, home: Float[np.ndarray, " j"], T_first_target: Float[np.ndarray, "t 4 4"]
) -> Axes:
    """Return all joints' axes at home, in the first target's frame; `T_first_target` maps each target's into it."""
    count = len(home)
    points, directions = np.zeros((count, 3)), np.zeros((count, 3))
    for joint in range(count):
        arcs = np.flatnonzero(lines.joints == joint)
        T = T_first_target[lines.targets[arcs]]
        for turns, E in _turns(lines, home, arcs, directions[:joint]):
            T = _turned(T, E, points[turns])
        points[joint], directions[joint] = _averaged(_brought(lines, arcs, T))
    return Axes(points, directions)


def home_derivatives(
    lines: Lines,
    home: Float[np.ndarray, " j"],
    T_first_target: Float[np.ndarray, "t 4 4"],
    by_target: Float[np.ndarray, "t 6 q"],
    axes: Axes,
) -> Float[np.ndarray, "j 6 q"]:
    """Return how the axes at home move: the twist (v, w) of each, x' = v + w × x, by q changes.

    The first four of every arc are its line's, along and about its basis; `by_target` is the twist of every target's
    transform. Where an axis moves by ξ, a turn E about it goes to exp(ξ) E exp(-ξ), so that a twist δ of what is
    turned becomes ξ + Ad_E (δ - ξ). What moves along the axis itself or about it is of no consequence.
    """
    twists = np.zeros((len(home), 6, by_target.shape[2]))
    for joint in range(len(home)):
        arcs = np.flatnonzero(lines.joints == joint)
        T, delta = T_first_target[lines.targets[arcs]], by_target[lines.targets[arcs]]
        for j, E in _turns(lines, home, arcs, axes.directions[:joint]):
            T = _turned(T, E, axes.points[j])
            delta = twists[j] + _adjoint(E, axes.points[j], delta - twists[j])
        near = _brought(lines, arcs, T)
        moved = np.zeros((len(arcs), 4, twists.shape[2]))
        across = near.bases.swapaxes(1, 2)
        moved[:, :2] = across @ (delta[:, :3] - hats(near.points) @ delta[:, 3:])
        moved[:, 2:] = across @ delta[:, 3:]
        for k, arc in enumerate(arcs):
            moved[k, :, 4 * arc : 4 * arc + 4] += np.eye(4)
        E_axis = near.bases[0]
        if len(arcs) > 1:
            E_axis = _next_to(near.bases[0], axes.directions[joint])
            gains, _ = _gains(near, axes.points[joint], axes.directions[joint], E_axis)
            step = np.einsum("kij,kjq->iq", gains, moved)
        else:
            step = moved[0]
        twists[joint, 3:] = E_axis @ step[2:]
        twists[joint, :3] = E_axis @ step[:2] + hat(axes.points[joint]) @ twists[joint, 3:]
    return twists


def _turns(
    lines: Lines,
    home: Float[np.ndarray, " j"],
    arcs: Int[np.ndarray, " k"],
    directions: Float[np.ndarray, "i 3"],
) -> Iterator[tuple[int, Float[np.ndarray, "k 3 3"]]]:
    """Yield the joints before that arcs' settings differ from home in, and how far each arc has to be turned back."""
    for j, direction in enumerate(directions):
        turns = home[j] - lines.settings[arcs, j]
        if turns.any():
            yield j, rotations_about(direction, turns)


def _turned(
    T: Float[np.ndarray, "k 4 4"], E: Float[np.ndarray, "k 3 3"], point: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "k 4 4"]:
    turned = T.copy()
    turned[:, :3, :3] = E @ T[:, :3, :3]
    turned[:, :3, 3] = point + (E @ (T[:, :3, 3] - point)[:, :, None])[:, :, 0]
    return turned


def _adjoint(
    E: Float[np.ndarray, "k 3 3"], point: Float[np.ndarray, "3"], twist: Float[np.ndarray, "k 6 q"]
) -> Float[np.ndarray, "k 6 q"]:
    """Return Ad of the turn about the point."""
    w = E @ twist[:, 3:]
    return np.concatenate([E @ twist[:, :3] + hats(point - E @ point) @ w, w], axis=1)


@dataclass(frozen=True, slots=True)
class _Near:
    """Lines of one joint, brought home."""

    points: Float[np.ndarray, "k 3"]
    directions: Float[np.ndarray, "k 3"]
    bases: Float[np.ndarray, "k 3 2"]
    roots: Float[np.ndarray, "k 4 4"]


def _brought(lines: Lines, arcs: Int[np.ndarray, " k"], T: Float[np.ndarray, "k 4 4"]) -> _Near:
    R, t = T[:, :3, :3], T[:, :3, 3]
    return _Near(
        (R @ lines.points[arcs][:, :, None])[:, :, 0] + t,
        (R @ lines.directions[arcs][:, :, None])[:, :, 0],
        R @ lines.bases[arcs],
        lines.roots[arcs],
    )


def _averaged(near: _Near) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Return the line that lies best among several, each weighted by its own information."""
    point, direction, E = near.points[0], near.directions[0], near.bases[0]
    if len(near.points) == 1:
        return point, direction
    for _ in range(3):
        gains, right = _gains(near, point, direction, E)
        step = np.einsum("kij,kj->i", gains, right)
        point = point + E @ step[:2]
        turn = so3_exp(E @ step[2:])
        direction, E = turn @ direction, turn @ E
    return point, direction


def _gains(
    near: _Near, point: Float[np.ndarray, "3"], direction: Float[np.ndarray, "3"], E: Float[np.ndarray, "3 2"]
) -> tuple[Float[np.ndarray, "k 4 4"], Float[np.ndarray, "k 4"]]:
    """Return what each line's distance from a line (last, along and about its own basis) moves that line by."""
    out = near.points - point
    along = out @ direction
    # Next to an arc's own point the line passes at p - q; moved by (e, w), E e + along (E w) × n further.
    q = out - along[:, None] * direction
    across = near.bases.swapaxes(1, 2)
    J = np.zeros((len(out), 4, 4))
    J[:, :2, :2] = J[:, 2:, 2:] = across @ E
    J[:, :2, 2:] = along[:, None, None] * (across @ (-hat(direction) @ E))
    off = np.concatenate([q, near.directions @ -hat(direction)], axis=1).reshape(-1, 2, 3)  # n × n_k
    right = np.einsum("kij,kcj->kci", across, off).reshape(-1, 4)
    JH = J.swapaxes(1, 2) @ (near.roots.swapaxes(1, 2) @ near.roots)
    normal = (JH @ J).sum(axis=0)
    unit = 1.0 / np.sqrt(np.diag(normal))
    inverse = unit[:, None] * np.linalg.inv(normal * np.outer(unit, unit)) * unit
    return inverse @ JH, right


def _next_to(E: Float[np.ndarray, "3 2"], direction: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 2"]:
    """Return two directions across a line, near those given."""
    first = E[:, 0] - direction * (direction @ E[:, 0])
    first /= np.linalg.norm(first)
    return np.column_stack([first, hat(direction) @ first])
