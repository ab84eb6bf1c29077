"""The covariance of joint axes at home, and of what is computed from them, by differences.

Everything after the arcs' fits (links of targets by arcs, bringing axes home, averaging, common normals) is smooth in
the arcs' axes, four numbers each, and cheap: central differences by steps far below any axis' uncertainty and far above
rounding carry the arcs' covariance through.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from core.kinematics.axes import AxisFits
from core.kinematics.common_normals import Axes
from core.kinematics.home import Lines, axes_at_home
from core.kinematics.link_targets import TargetLink, by_arcs
from core.transforms import so3_exp, transform

STEP_MM, STEP_RAD = 1e-4, 1e-7


def lines_of(fits: AxisFits) -> Lines:
    """Return the arcs' axes as lines with their information."""
    arcs = fits.arcs
    roots = []
    for i in range(len(arcs)):
        block = fits.covariance[4 * i : 4 * i + 4, 4 * i : 4 * i + 4]
        unit = np.sqrt(np.diag(block))
        roots.append(np.linalg.inv(np.linalg.cholesky(block / np.outer(unit, unit))) / unit)
    return Lines(
        np.array([arc.point_mm for arc in arcs]),
        np.array([arc.direction for arc in arcs]),
        fits.bases,
        np.array(roots),
        np.array([arc.sweep.joint for arc in arcs]),
        np.array([arc.sweep.setting for arc in arcs]),
        np.array([arc.sweep.target for arc in arcs]),
    )


@dataclass(frozen=True, slots=True)
class ArcTree:
    """What follows from the arcs: links by arcs, and axes at home."""

    lines: Lines
    home: Float[np.ndarray, " j"]
    links: dict[int, TargetLink]
    first: int
    tolerance: float

    def axes(
        self, lines: Lines | None = None, target: int = -1, step: Float[np.ndarray, "6"] | None = None
    ) -> Axes:
        """Return the axes at home; of other lines, or with the link of a target moved by a step."""
        lines = self.lines if lines is None else lines
        T = np.tile(np.eye(4), (max(self.links) + 1, 1, 1))
        for index, link in self.links.items():
            T[index] = link.T_first_target
            if link.covariance is None and lines is not self.lines:
                T[index] = by_arcs(lines, self.first, index, self.tolerance)
            if index == target and step is not None:
                T[index] = transform(so3_exp(step[3:]) @ T[index, :3, :3], T[index, :3, 3] + step[:3])
        return axes_at_home(lines, self.home, T)

    def uncertain(self, fits: AxisFits) -> UncertainAxes:
        """Return the axes with their covariance, from that of the arcs and of the links."""
        axes = self.axes()
        bases = axes.bases()

        def change(ahead: Axes, behind: Axes, step: float) -> Float[np.ndarray, " c"]:
            shift = np.einsum("jia,ji->ja", bases, ahead.points - behind.points)
            turn = np.einsum("jia,ji->ja", bases, np.cross(behind.directions, ahead.directions))
            return np.hstack([shift, turn]).ravel() / (2.0 * step)

        steps = np.diag([STEP_MM] * 2 + [STEP_RAD] * 2)
        columns = []
        for arc in range(len(fits.arcs)):
            for step in steps:
                ahead, behind = (self.axes(self.lines.moved(arc, s)) for s in (step, -step))
                columns.append(change(ahead, behind, float(step.sum())))
        J = np.column_stack(columns)
        covariance = J @ fits.covariance @ J.T
        for target, link in self.links.items():
            if link.covariance is None or not link.covariance.any():
                continue
            columns = []
            for step in np.diag([STEP_MM] * 3 + [STEP_RAD] * 3):
                ahead, behind = (self.axes(None, target, s) for s in (step, -step))
                columns.append(change(ahead, behind, float(step.sum())))
            J = np.column_stack(columns)
            covariance += J @ link.covariance @ J.T
        return UncertainAxes(axes, bases, covariance)


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
