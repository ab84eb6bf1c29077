"""Axes brought to one configuration: arcs at other settings of the joints before, arcs seen on other targets.

At a setting q the axis of joint i is where the joints before it have taken it from its place at home h:

    axis_i(q) = E_1 E_2 … E_{i-1} axis_i(h),      E_j the turn by q_j - h_j about axis j at home,

(product of exponentials), so axes can be brought home one after the other from the base outward. Joints after i do not
move it. Arcs of one joint are then averaged, weighted by their covariances.

References: R. W. Brockett, "Robotic manipulators and the product of exponentials formula", Mathematical Theory of
Networks and Systems, 1984, 120-129, 10.1007/BFb0031048.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from core.kinematics.arc import rotations_about
from core.kinematics.common_normals import Axes
from core.kinematics.sweeps import Sweep
from core.transforms import hat, so3_exp


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


def common_home(sweeps: Sequence[Sweep], joints: int, tolerance: float) -> Float[np.ndarray, " j"]:
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
        R, t = T[:, :3, :3], T[:, :3, 3]
        for j in range(joint):
            turns = home[j] - lines.settings[arcs, j]
            if turns.any():
                E = rotations_about(directions[j], turns)
                R, t = E @ R, points[j] + np.einsum("nij,nj->ni", E, t - points[j])
        points[joint], directions[joint] = _averaged(
            np.einsum("nij,nj->ni", R, lines.points[arcs]) + t,
            np.einsum("nij,nj->ni", R, lines.directions[arcs]),
            R @ lines.bases[arcs],
            lines.roots[arcs],
        )
    return Axes(points, directions)


def _averaged(
    points: Float[np.ndarray, "k 3"],
    directions: Float[np.ndarray, "k 3"],
    bases: Float[np.ndarray, "k 3 2"],
    roots: Float[np.ndarray, "k 4 4"],
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Return the line that lies best among several, each weighted by its own information."""
    point, direction, E = points[0], directions[0], bases[0]
    if len(points) == 1:
        return point, direction
    for _ in range(3):
        out = points - point
        along = out @ direction
        # Next to an arc's own point the line passes at p - q; moved by (e, w), E e + along (E w) × n further.
        q = out - along[:, None] * direction
        across = bases.swapaxes(1, 2)
        J = np.zeros((len(points), 4, 4))
        J[:, :2, :2] = J[:, 2:, 2:] = across @ E
        J[:, :2, 2:] = along[:, None, None] * (across @ (-hat(direction) @ E))
        off = np.concatenate([q, directions @ -hat(direction)], axis=1).reshape(-1, 2, 3)  # n × n_k
        right = np.einsum("kij,kcj->kci", across, off).reshape(-1, 4)
        H = roots.swapaxes(1, 2) @ roots
        normal = np.einsum("kai,kab,kbj->ij", J, H, J)
        unit = 1.0 / np.sqrt(np.diag(normal))
        step = unit * np.linalg.solve(
            normal * np.outer(unit, unit), unit * np.einsum("kai,kab,kb->i", J, H, right)
        )
        point = point + E @ step[:2]
        turn = so3_exp(E @ step[2:])
        direction, E = turn @ direction, turn @ E
    return point, direction
