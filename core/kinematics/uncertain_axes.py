"""The covariance of joint axes at home, and of what is computed from them.

Everything after the arcs' fits is smooth in the arcs' axes, four numbers each. Bringing axes home and averaging them
has its derivatives in `home`; links of targets by arcs, and common normals, are cheap: central differences by steps far
below any axis' uncertainty and far above rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from core.kinematics.arc import Motion
from core.kinematics.axes import AxisFits
from core.kinematics.common_normals import Axes
from core.kinematics.home import Lines, axes_at_home, hats, home_derivatives
from core.kinematics.link_targets import Given, TargetLink, by_arcs, link_targets, shared_axes
from core.kinematics.poses import PoseData
from core.kinematics.sweeps import Sweep
from core.transforms import so3_exp, so3_log

STEP_MM, STEP_RAD = 1e-4, 1e-7


def lines_of(
    motions: Sequence[Motion], sweeps: Sequence[Sweep], covariances: Sequence[Float[np.ndarray, "4 4"]]
) -> Lines:
    """Return the axes of arcs as lines with their information."""
    roots = []
    for block in covariances:
        unit = np.sqrt(np.diag(block))
        roots.append(np.linalg.inv(np.linalg.cholesky(block / np.outer(unit, unit))) / unit)
    return Lines(
        np.array([motion.point for motion in motions]),
        np.array([motion.direction for motion in motions]),
        np.array([motion.basis[:, :2] for motion in motions]),
        np.array(roots),
        np.array([sweep.joint for sweep in sweeps]),
        np.array([sweep.setting for sweep in sweeps]),
        np.array([sweep.target for sweep in sweeps]),
    )


def lines_of_fits(fits: AxisFits) -> Lines:
    """Return the fitted axes as lines with their information."""
    blocks = [fits.covariance[4 * i : 4 * i + 4, 4 * i : 4 * i + 4] for i in range(len(fits.arcs))]
    return lines_of([arc.motion for arc in fits.arcs], [arc.sweep for arc in fits.arcs], blocks)


def transforms_of(links: Mapping[int, TargetLink]) -> Float[np.ndarray, "t 4 4"]:
    """Return T_first_target of every target by its index; of one without a link that of the first."""
    T = np.tile(np.eye(4), (max(links) + 1, 1, 1))
    for target, link in links.items():
        T[target] = link.T_first_target
    return T


@dataclass(frozen=True, slots=True)
class ArcTree:
    """What follows from the arcs: links of targets with their covariance, and axes at home.

    `by_arcs` are derivatives of links (position, then rotation from the left) by all arcs' lines, four columns each;
    of those links that the arcs told.
    """

    lines: Lines
    home: Float[np.ndarray, " j"]
    links: dict[int, TargetLink]
    by_arcs: dict[int, Float[np.ndarray, "6 q"]]

    @classmethod
    def grown(
        cls,
        fits: AxisFits,
        home: Float[np.ndarray, " j"],
        poses: PoseData,
        given: Given | None,
        tolerance: float,
    ) -> ArcTree:
        """Link the targets; `tolerance` as of `link_targets`, which see for what is raised."""
        lines = lines_of_fits(fits)
        links = link_targets(poses, lines, given, tolerance)
        derivatives = {}
        for target, link in links.items():
            if link.covariance is None:
                J = _link_derivative(lines, int(poses.targets.min()), target, tolerance)
                derivatives[target] = J
                links[target] = replace(link, covariance=J @ fits.covariance @ J.T)
        return cls(lines, home, links, derivatives)

    def axes(self) -> Axes:
        """Return the axes at home."""
        return axes_at_home(self.lines, self.home, transforms_of(self.links))

    def uncertain(self, fits: AxisFits) -> UncertainAxes:
        """Return the axes with their covariance, from that of the arcs and of the links that these did not tell."""
        T, axes = transforms_of(self.links), self.axes()
        q = len(fits.covariance)
        others = [
            t
            for t, link in self.links.items()
            if t not in self.by_arcs and link.covariance is not None and link.covariance.any()
        ]
        by_target = np.zeros((len(T), 6, q + 6 * len(others)))
        spread = np.zeros((q + 6 * len(others),) * 2)
        spread[:q, :q] = fits.covariance
        for target, J in self.by_arcs.items():
            by_target[target, :, :q] = J
        for k, target in enumerate(others):
            columns = slice(q + 6 * k, q + 6 * k + 6)
            by_target[target, :, columns] = np.eye(6)
            spread[columns, columns] = self.links[target].covariance
        # A link's position moves at its own place, a twist's velocity is the origin's.
        by_target[:, :3] += hats(T[:, :3, 3]) @ by_target[:, 3:]
        twists = home_derivatives(self.lines, self.home, T, by_target, axes)
        bases = axes.bases()
        across = bases.swapaxes(1, 2)
        shift = across @ (twists[:, :3] - hats(axes.points) @ twists[:, 3:])
        J = np.concatenate([shift, across @ twists[:, 3:]], axis=1).reshape(-1, len(spread))
        return UncertainAxes(axes, bases, J @ spread @ J.T)


def _link_derivative(lines: Lines, first: int, target: int, tolerance: float) -> Float[np.ndarray, "6 q"]:
    """Return d(link by arcs) by all lines, by differences."""
    pairs = shared_axes(lines, first, target, tolerance)
    J = np.zeros((6, 4 * len(lines.joints)))
    for arc in np.unique(pairs):
        for k, step in enumerate(np.diag([STEP_MM] * 2 + [STEP_RAD] * 2)):
            ahead, behind = (by_arcs(lines.moved(int(arc), s), pairs) for s in (step, -step))
            change = [*(ahead[:3, 3] - behind[:3, 3]), *so3_log(ahead[:3, :3] @ behind[:3, :3].T)]
            J[:, 4 * arc + k] = np.array(change) / (2.0 * float(step.sum()))
    return J


@dataclass(frozen=True, slots=True)
class UncertainAxes:
    """Axes, and the covariance of four numbers each: the point along two directions across (mm), the direction about
    them (rad); `bases` are these directions.
    """

    axes: Axes
    bases: Float[np.ndarray, "j 3 2"]
    covariance: Float[np.ndarray, "q q"]

    def carry(self, of: Callable[[Axes], Float[np.ndarray, " p"]]) -> Float[np.ndarray, "p p"]:
        """Return the covariance of a function of the axes, by differences."""
        columns = []
        for joint, basis in enumerate(self.bases):
            for k in range(4):
                step = STEP_MM if k < 2 else STEP_RAD
                ahead, behind = (
                    self._moved(joint, sign * step * basis[:, k % 2], k < 2) for sign in (1.0, -1.0)
                )
                columns.append((of(ahead) - of(behind)) / (2.0 * step))
        J = np.column_stack(columns)
        return np.asarray(J @ self.covariance @ J.T)

    def _moved(self, joint: int, by: Float[np.ndarray, "3"], shifted: bool) -> Axes:
        points, directions = self.axes.points.copy(), self.axes.directions.copy()
        if shifted:
            points[joint] += by
        else:
            directions[joint] = so3_exp(by) @ directions[joint]
        return Axes(points, directions)
