"""Held-out validation of what sweeps tell: the arcs fitted without a part of their poses, and that part predicted.

Poses are dealt as `validation` deals them. For each fold every arc is fitted again without the fold's poses, begun at
the fit of all; targets are linked, axes brought home and described in the same forms; base and tool are fitted to the
poses that are left, sweeps' and free ones alike. Poses that no such arm explains were left out before, and counted.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from core.errors import DegenerateGeometry, MotionInsufficient, NotConverged
from core.kinematics.arc import AXIS_PARAMETERS
from core.kinematics.arc_fit import ArcProblem
from core.kinematics.axes import LEAST_POSES, AxisFits
from core.kinematics.common_normals import LinkForm, describe
from core.kinematics.dh import Chain, forward
from core.kinematics.home import Lines, axes_at_home
from core.kinematics.identifiability import choose_gauge
from core.kinematics.link_targets import Given, link_targets
from core.kinematics.parameters import ArmState
from core.kinematics.poses import PoseData
from core.kinematics.problem import Observations, Scatter, observations_of, placed
from core.kinematics.refinement import refine, refine_plainly
from core.kinematics.uncertain_axes import lines_of, robot_scatter, transforms_of
from core.kinematics.validation import SAME_CONFIGURATION, Validation, deal, hold_out

_LEFT_OUT = -1  # the fold of poses that are in none


def validate_axes(
    poses: PoseData,
    rested: PoseData,
    method: str,
    fits: AxisFits,
    home: Float[np.ndarray, " j"],
    forms: Sequence[LinkForm],
    chain: Chain,
    nominal: Chain | None,
    given: Given | None,
    tolerance: float,
    folds: int,
) -> Validation | None:
    """Return the held-out errors of a chain that `fits` of the poses told; None where folds leave too little of an arc.

    `poses` are as measured, `rested` as they were fitted; `tolerance` is that of links, rad.
    """
    seen = observations_of(poses)
    whole = placed(chain.as_array(), forward(chain, poses.joint_angles), seen)
    noise = Scatter(fits.variances.position, fits.variances.rotation)
    frames = choose_gauge(whole, seen, noise).free
    frames[: whole.layout.tool.start] = False
    at_best = refine(whole, seen, frames)
    used = at_best.used.copy()
    for arc in fits.arcs:
        used[arc.sweep.poses[~arc.used]] = False
    kept = np.flatnonzero(used)
    if len(kept) < folds:
        return None
    of_fold = np.full(len(poses), _LEFT_OUT)
    of_fold[kept] = deal(
        poses.joint_angles[kept],
        folds,
        [poses.labels[i] for i in kept] if poses.labels else (),
        max(SAME_CONFIGURATION, tolerance),
    )
    if int(of_fold.max()) + 1 < folds:
        return None

    robot = robot_scatter(fits, rested)

    def framed(of: Chain, rest: Observations) -> ArmState:
        """Return a chain with tool and bases by the poses that are left."""
        arm = placed(of.as_array(), forward(of, rest.joint_angles), rest)
        return refine_plainly(arm, rest, frames, at_best.scatter)

    def identified(rest: Observations, fold: int) -> ArmState | None:
        lines = _lines_without(fits, rested, method, of_fold, fold)
        if lines is None or len(np.unique(lines.joints)) < len(home):
            return None
        left = np.flatnonzero((of_fold != fold) & (of_fold != _LEFT_OUT))
        try:
            links = link_targets(rested.take(left), poses.take(left), robot, lines, given, tolerance)
        except MotionInsufficient:
            return None
        axes = axes_at_home(lines, home, transforms_of(links))
        return framed(Chain.from_array(describe(axes, home, forms, nominal).parameters), rest)

    def compared(rest: Observations, _: int) -> ArmState:
        assert nominal is not None
        return framed(nominal, rest)

    return hold_out(
        seen.take(kept),
        of_fold[kept],
        identified,
        compared if nominal is not None else None,
        len(poses) - len(kept),
    )


def _lines_without(
    fits: AxisFits, rested: PoseData, method: str, of_fold: Int[np.ndarray, " n"], fold: int
) -> Lines | None:
    """Return the arcs' axes by the poses that are not of the fold; None where an arc cannot be fitted so."""
    arcs = []
    for arc in fits.arcs:
        left = arc.used & (of_fold[arc.sweep.poses] != fold)
        if int(left.sum()) < LEAST_POSES[method]:
            continue
        problem = ArcProblem.prepared(rested, arc.sweep, method)
        problem.resume(arc.motion, left)
        try:
            problem.refine(fits.variances, fits.shared, robust=False)
        except (DegenerateGeometry, NotConverged):
            return None
        arcs.append(problem)
    blocks = []
    for problem in arcs:
        _, J, _ = problem.whitened()
        unit = 1.0 / np.maximum(np.linalg.norm(J, axis=0), 1e-300)
        inverse = unit[:, None] * np.linalg.pinv((J * unit).T @ (J * unit), hermitian=True) * unit
        blocks.append(inverse[:AXIS_PARAMETERS, :AXIS_PARAMETERS])
    return lines_of([p.motion for p in arcs], [p.sweep for p in arcs], blocks) if arcs else None
