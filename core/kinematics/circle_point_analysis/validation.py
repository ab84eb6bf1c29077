"""Cross-validation of an identification from sweeps: arcs fitted without a fold of poses, and that fold predicted.

Folds are assigned as in `global_fit.validation`. For each fold every arc is fitted again without the fold's poses,
starting at the fit of all poses. Targets are linked, axes are brought home and described in the same forms. Base and
tool are fitted to the remaining poses, those of sweeps and free ones. Poses that no such arm explains are excluded
beforehand and counted.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from core.errors import DegenerateGeometry, MotionInsufficient, NotConverged
from core.kinematics.arm_model import ArmState
from core.kinematics.circle_point_analysis.common_normals import LinkForm, describe
from core.kinematics.circle_point_analysis.covariance import axes_from_motions, robot_scatter, transforms_of
from core.kinematics.circle_point_analysis.home_configuration import Lines, axes_at_home
from core.kinematics.circle_point_analysis.target_registration import link_targets
from core.kinematics.dh import Chain, forward
from core.kinematics.equal_descriptions import level_with_point
from core.kinematics.global_fit import (
    SAME_CONFIGURATION,
    Observations,
    Validation,
    assign_folds,
    cross_validate,
    fit_frames,
    fix_gauge,
    observations_of,
    placed,
    refine,
)
from core.kinematics.joint_axes import AXIS_PARAMETERS, LEAST_POSES, ArcProblem, AxisFits
from core.kinematics.pose_observations import PoseData

_EXCLUDED = -1  # the fold of poses that are excluded from all folds


def validate_axes(
    poses: PoseData,
    rested: PoseData,
    method: str,
    fits: AxisFits,
    home: Float[np.ndarray, " j"],
    forms: Sequence[LinkForm],
    height_mm: float,
    chain: Chain,
    nominal: Chain | None,
    tolerance: float,
    folds: int,
) -> Validation | None:
    """Return the held-out errors of a chain identified from `fits`; None where a fold leaves too little of an arc.

    `poses` are as measured, `rested` as they were fitted; `tolerance` is that of links, rad, `height_mm` that of
    `describe`.
    """
    seen = observations_of(poses)
    whole = placed(chain.as_array(), forward(chain, poses.joint_angles), seen)
    noise = fits.variances
    gauge = fix_gauge(whole, seen, noise)
    whole = level_with_point(whole, gauge.free, gauge.parallel)
    frames = gauge.free
    frames[: whole.layout.tool.start] = False
    at_best = refine(whole, seen, frames)
    used = at_best.used.copy()
    for arc in fits.arcs:
        used[arc.sweep.poses[~arc.used]] = False
    kept = np.flatnonzero(used)
    if len(kept) < folds:
        return None
    of_fold = np.full(len(poses), _EXCLUDED)
    of_fold[kept] = assign_folds(
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
        return fit_frames(of.as_array(), at_best.arm, rest, frames, at_best.scatter)

    def identified(rest: Observations, fold: int) -> ArmState | None:
        lines = _lines_without(fits, rested, method, of_fold, fold)
        if lines is None or len(np.unique(lines.joints)) < len(home):
            return None
        left = np.flatnonzero((of_fold != fold) & (of_fold != _EXCLUDED))
        try:
            links = link_targets(rested.take(left), poses.take(left), robot, lines, tolerance)
        except MotionInsufficient:
            return None
        axes = axes_at_home(lines, home, transforms_of(links))
        described = describe(axes, home, forms, nominal, height_mm)
        return framed(Chain.from_array(described.parameters), rest)

    def compared(rest: Observations, _: int) -> ArmState:
        assert nominal is not None
        return framed(nominal, rest)

    return cross_validate(
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
    return axes_from_motions([p.motion for p in arcs], [p.sweep for p in arcs], blocks) if arcs else None
