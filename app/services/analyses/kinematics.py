"""A robot's Denavit-Hartenberg parameters from a session's poses, each with its doubt."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float

from app.records.codec import decode_points
from app.services.analyses.documents import advisories
from app.services.analyses.kinematics_documents import (
    add_residuals,
    axes_document,
    identification_document,
)
from app.services.analyses.kinematics_poses import RobotPoses, gather_poses, nominal_chain
from app.services.analyses.kinematics_sweeps import sweeps_of
from app.services.analyses.outcome import CannotAnalyse
from app.services.analyses.snapshot import Snapshot
from core import Advisory, Lens, TargetSpec
from core.errors import EstimationError, JointAnglesInconsistent, NotConverged
from core.kinematics.angle_units import check_angles
from core.kinematics.cpa import identify_from_axes
from core.kinematics.dh import Chain
from core.kinematics.identification import Identification, identify
from core.kinematics.on_points import PointsIdentification, identify_on_points
from core.kinematics.poses import PoseData
from core.kinematics.sweeps import Sweep
from core.kinematics.validation import FOLDS
from core.targets.specification import GridPoints

STARTING_SWEEPS = 2
"""Of each joint on each target: a start needs no more, and every further one takes its time."""

Solved = TypeVar("Solved", Identification, PointsIdentification)


def dh_document(
    snapshot: Snapshot, points: Mapping[str, bytes], settings: Mapping[str, str]
) -> dict[str, Any]:
    """Return what `GET .../dh` answers, but for the fields every analysis has."""
    nominal = nominal_chain(snapshot.robot)
    gathered = gather_poses(snapshot, points, settings, nominal)
    tolerance = math.radians(float(settings["joint_tolerance_deg"]))
    known = sweeps_of(snapshot, gathered.poses, settings, tolerance)
    gathered = replace(gathered, warnings=(*gathered.warnings, *known.warnings))
    sweeps = known.sweeps
    check_angles(gathered.poses, sweeps)
    try:
        if settings["method"] == "global":
            found = _global(snapshot, points, settings, gathered, nominal, sweeps)
        else:
            axes = identify_from_axes(
                gathered.poses, nominal, settings["method"], sweeps=sweeps, tolerance=tolerance, folds=FOLDS
            )
            found = {
                **axes_document(axes, gathered.poses, snapshot, gathered.targets),
                "warnings": advisories((*gathered.warnings, *axes.warnings)),
            }
    except np.linalg.LinAlgError as failure:
        raise CannotAnalyse(
            "degenerate_geometry",
            "The poses leave the robot's geometry undetermined.",
            "Add poses at other joint angles; thirty that move all joints over their range are a sound beginning.",
        ) from failure
    return {
        "estimator": settings["estimator"],
        "method": settings["method"],
        "source": settings["source"],
        "convention": "classic_dh",
        "joint_tolerance_deg": float(settings["joint_tolerance_deg"]),
        "sweeps": list(known.named),
        **found,
    }


def _global(
    snapshot: Snapshot,
    points: Mapping[str, bytes],
    settings: Mapping[str, str],
    gathered: RobotPoses,
    nominal: Chain | None,
    sweeps: Sequence[Sweep],
) -> dict[str, Any]:
    """Identify from all poses at once: on the grid points where one lens took them all, else on the poses."""
    remarks: list[Advisory] = []
    used_poses = np.arange(len(gathered.poses))
    found: Identification | None = None
    if _on_points(settings, gathered):
        try:
            answer = _solve_on_points(snapshot, points, gathered, nominal, sweeps)
        except NotConverged as failure:
            remarks.append(
                Advisory(
                    "identified_from_poses",
                    f"Lens and robot could not be solved for together ({failure.detail}); the figures come from the "
                    "poses, with the lens's doubt carried along.",
                    "Check that no image is of another camera setting (focus_group).",
                )
            )
        else:
            found, used_poses = answer.robot, answer.images
    if found is None:
        found = _identified(gathered, nominal, sweeps)
    document = identification_document(found, snapshot, gathered.targets)
    add_residuals(document["joints"], found, used_poses, sweeps)
    warnings = (*gathered.warnings, *remarks, *found.warnings)
    return {**document, "warnings": advisories(warnings)}


def _identified(gathered: RobotPoses, nominal: Chain | None, sweeps: Sequence[Sweep]) -> Identification:
    return _begun(
        lambda start: identify(gathered.poses, nominal, start=start), gathered.poses, nominal, sweeps
    )


def _begun(
    solve: Callable[[Chain | None], Solved], poses: PoseData, nominal: Chain | None, sweeps: Sequence[Sweep]
) -> Solved:
    """Solve from the nominal robot; from what the sweeps tell where there is none, or where it is too far off.

    Raises JointNotMoved where there is neither.
    """
    if nominal is not None:
        try:
            return solve(None)
        except (NotConverged, JointAnglesInconsistent):
            start = None
            with contextlib.suppress(EstimationError):
                start = _start(poses, nominal, sweeps)
            if start is None:
                raise
            return solve(start)
    return solve(_start(poses, None, sweeps))


def _start(poses: PoseData, nominal: Chain | None, sweeps: Sequence[Sweep]) -> Chain:
    """Return the chain by the largest sweeps of every joint on each target."""
    largest: dict[tuple[int, int], list[Sweep]] = {}
    for sweep in sweeps:
        largest.setdefault((sweep.joint, sweep.target), []).append(sweep)
    chosen = [s for of_joint in largest.values() for s in of_joint[:STARTING_SWEEPS]]
    return identify_from_axes(poses, nominal, "combined", sweeps=chosen).chain


def _on_points(settings: Mapping[str, str], gathered: RobotPoses) -> bool:
    """Tell whether one lens took all images and is to be solved for."""
    return (
        settings["estimator"] == "pooled"
        and gathered.estimate is not None
        and len({e.image.focus_group for e in gathered.images}) == 1
    )


def _solve_on_points(
    snapshot: Snapshot,
    points: Mapping[str, bytes],
    gathered: RobotPoses,
    nominal: Chain | None,
    sweeps: Sequence[Sweep],
) -> PointsIdentification:
    views = _views(snapshot, points, gathered)
    lens = Lens(**snapshot.lens) if snapshot.lens is not None else None

    def solve(start: Chain | None) -> PointsIdentification:
        poses = gathered.poses
        return identify_on_points(
            views,
            poses.joint_angles,
            nominal,
            target=poses.targets,
            start=start,
            lens=lens,
            labels=poses.labels,
        )

    return _begun(solve, gathered.poses, nominal, sweeps)


def _views(snapshot: Snapshot, points: Mapping[str, bytes], gathered: RobotPoses) -> list[GridPoints]:
    """Return every image's grid points, named by the one reading of its board that all images share."""
    assert gathered.estimate is not None
    targets = [TargetSpec(**target) for target in snapshot.targets]
    as_read = {
        e.measurement_id: (group.estimate.rotations[k], group.estimate.positions_mm[k])
        for group in gathered.estimate.groups
        for k, e in enumerate(group.images)
    }
    views = []
    for e in gathered.images:
        target = targets[e.image.target]
        view = decode_points(points[e.measurement_id], [], target, e.image.width_px, e.image.height_px)
        rotation, position = as_read[e.measurement_id]
        views.append(_renamed(view, e.rotation @ rotation.T, e.position_mm, rotation, position))
    return views


def _renamed(
    view: GridPoints,
    back: Float[np.ndarray, "3 3"],
    position: Float[np.ndarray, "3"],
    rotation_as_read: Float[np.ndarray, "3 3"],
    position_as_read: Float[np.ndarray, "3"],
) -> GridPoints:
    """Return the view with its points named in the board's frame that `back` turns the one it was read in to.

    With X' = back (X - s) and both frames' camera in one place, back s = back p - p'.
    """
    if float(np.trace(back)) > 2.0:  # a turn of a board is by 90° or 180°
        return view
    grid = view.target.points_target()
    place = view.row * view.target.columns + view.column
    moved = (grid[place] - position_as_read) @ back.T + position
    nearest = np.argmin(np.linalg.norm(grid[None, :, :2] - moved[:, None, :2], axis=2), axis=1)
    return replace(
        view,
        column=(nearest % view.target.columns).astype(np.intp),
        row=(nearest // view.target.columns).astype(np.intp),
    )
