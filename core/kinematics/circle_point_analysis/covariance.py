"""Covariance of joint axes at home, and of quantities computed from them.

Every step after the arcs' fits is a smooth function of the arcs' axes, four numbers each. `home_configuration` has the
derivatives of bringing axes home and averaging them. Links of targets by arcs, and common normals, are cheap: central
differences, by steps far below any axis' uncertainty and far above rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from core.geometry import hats, so3_exp
from core.kinematics.circle_point_analysis.common_normals import Axes
from core.kinematics.circle_point_analysis.home_configuration import Lines, axes_at_home, home_derivatives
from core.kinematics.circle_point_analysis.target_registration import (
    STEP_MM,
    STEP_RAD,
    TargetLink,
    link_targets,
)
from core.kinematics.joint_axes import AxisFits, Motion, fit_axes
from core.kinematics.pose_observations import PoseData
from core.kinematics.sweeps import Sweep
from core.numerics import Variances


def axes_from_motions(
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


def axes_from_fits(fits: AxisFits) -> Lines:
    """Return the fitted axes as lines with their information."""
    blocks = [fits.covariance[4 * i : 4 * i + 4, 4 * i : 4 * i + 4] for i in range(len(fits.arcs))]
    return axes_from_motions([arc.motion for arc in fits.arcs], [arc.sweep for arc in fits.arcs], blocks)


def robot_scatter(fits: AxisFits, poses: PoseData) -> Variances:
    """Return the robot's own scatter. Circles carry no information on rotations; where targets are to be linked by
    rotations, the same sweeps are fitted as motions.
    """
    if fits.scatter_rad is not None or poses.rotations is None or len(np.unique(poses.targets)) < 2:
        return fits.variances
    return fit_axes(poses, [arc.sweep for arc in fits.arcs], "combined").variances


def transforms_of(links: Mapping[int, TargetLink]) -> Float[np.ndarray, "t 4 4"]:
    """Return T_first_target of every target by its index; of one without a link that of the first."""
    T = np.tile(np.eye(4), (max(links) + 1, 1, 1))
    for target, link in links.items():
        T[target] = link.T_first_target
    return T


@dataclass(frozen=True, slots=True)
class ArcTree:
    """The chain from arcs to axes: links of targets with their whole covariance, and axes at home. `not_from_arcs` is
    the part of each link's covariance that does not come from the arcs.
    """

    lines: Lines
    home: Float[np.ndarray, " j"]
    links: dict[int, TargetLink]
    not_from_arcs: dict[int, Float[np.ndarray, "6 6"]]

    @classmethod
    def grown(
        cls,
        fits: AxisFits,
        home: Float[np.ndarray, " j"],
        poses: PoseData,
        tolerance: float,
        measured: PoseData | None = None,
    ) -> ArcTree:
        """Link the targets; `tolerance` and `measured` (None: the same as `poses`) as of `link_targets`, which see for
        what is raised.
        """
        lines = axes_from_fits(fits)
        measured = poses if measured is None else measured
        links = link_targets(poses, measured, robot_scatter(fits, poses), lines, tolerance)
        not_from_arcs = {target: link.covariance for target, link in links.items()}
        for target, link in links.items():
            if (J := link.by_arcs) is not None:
                links[target] = replace(link, covariance=link.covariance + J @ fits.covariance @ J.T)
        return cls(lines, home, links, not_from_arcs)

    def axes(self) -> Axes:
        """Return the axes at home."""
        return axes_at_home(self.lines, self.home, transforms_of(self.links))

    def uncertain(self, fits: AxisFits) -> UncertainAxes:
        """Return the axes with their covariance, from that of the arcs and of links from other sources."""
        T, axes = transforms_of(self.links), self.axes()
        q = len(fits.covariance)
        others = [t for t, covariance in self.not_from_arcs.items() if covariance.any()]
        by_target = np.zeros((len(T), 6, q + 6 * len(others)))
        spread = np.zeros((q + 6 * len(others),) * 2)
        spread[:q, :q] = fits.covariance
        for target, link in self.links.items():
            if link.by_arcs is not None:
                by_target[target, :, :q] = link.by_arcs
        for k, target in enumerate(others):
            columns = slice(q + 6 * k, q + 6 * k + 6)
            by_target[target, :, columns] = np.eye(6)
            spread[columns, columns] = self.not_from_arcs[target]
        # A link's position moves at its own place, a twist's velocity is the origin's.
        by_target[:, :3] += hats(T[:, :3, 3]) @ by_target[:, 3:]
        twists = home_derivatives(self.lines, self.home, T, by_target, axes)
        bases = axes.bases()
        across = bases.swapaxes(1, 2)
        shift = across @ (twists[:, :3] - hats(axes.points) @ twists[:, 3:])
        J = np.concatenate([shift, across @ twists[:, 3:]], axis=1).reshape(-1, len(spread))
        return UncertainAxes(axes, bases, J @ spread @ J.T)


@dataclass(frozen=True, slots=True)
class UncertainAxes:
    """Axes, and the covariance of four numbers each: the point along two directions across (mm), the direction about
    them (rad); `bases` are these directions.
    """

    axes: Axes
    bases: Float[np.ndarray, "j 3 2"]
    covariance: Float[np.ndarray, "q q"]

    def propagate_covariance(self, of: Callable[[Axes], Float[np.ndarray, " p"]]) -> Float[np.ndarray, "p p"]:
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
