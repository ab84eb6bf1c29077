"""Sweeps among a session's poses, and what an identification starts from.

Sweeps are recognised from joint angles. A joint for which the user lists poses has only these sweeps.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np

from core.errors import (
    Advisory,
    EstimationError,
    JointAnglesInconsistent,
    JointNotExcited,
    NotConverged,
    SweepJointUnknown,
    SweepPoseUnknown,
    listed,
)
from core.kinematics import (
    MIN_JOINT_RANGE,
    Chain,
    Identification,
    PoseData,
    Sweep,
    find_sweeps,
    identify_from_axes,
    named_sweeps,
)
from core.session.model import SessionData, natural

STARTING_SWEEPS = 2
"""Of each joint before each target: a start needs no more, and every further one takes its time."""


@dataclass(frozen=True, slots=True)
class NamedSweep:
    """Poses at which one joint moves alone: `joint` counts from 1, `pose_ids` may hold the wildcards * and ?."""

    joint: int
    pose_ids: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class SessionSweeps:
    """Sweeps, and what to know of them."""

    sweeps: tuple[Sweep, ...]
    warnings: tuple[Advisory, ...]


def select_sweeps(
    data: SessionData, poses: PoseData, named: Sequence[NamedSweep], tolerance: float
) -> SessionSweeps:
    """Return the sweeps among a session's poses; other joints of a sweep agree within `tolerance` (rad).

    Raises SweepJointUnknown, SweepPoseUnknown, and what `core.kinematics.sweeps.named_sweeps` raises where listed
    poses are not a sweep.
    """
    found = find_sweeps(poses, tolerance=tolerance)
    if not named:
        return SessionSweeps(found, ())
    of_session = {image.pose_id for image in data.images} | {pose.pose_id for pose in data.measured}
    serving = frozenset(poses.labels)
    chosen: dict[int, list[tuple[str, ...]]] = {}
    unusable: set[str] = set()
    for sweep in named:
        if sweep.joint > poses.joints:
            raise SweepJointUnknown(
                f"A sweep is named for joint {sweep.joint}; the robot has {poses.joints} joints."
            )
        members = _matching(sweep.pose_ids, of_session)
        unusable |= members - serving
        chosen.setdefault(sweep.joint - 1, []).append(tuple(sorted(members & serving, key=natural)))
    sweeps = [s for s in found if s.joint not in chosen]
    sweeps += named_sweeps(poses, chosen, tolerance=tolerance)
    sweeps.sort(key=lambda s: (s.joint, -len(s.poses), int(s.poses[0])))
    return SessionSweeps(tuple(sweeps), _warnings(unusable))


def _matching(patterns: Sequence[str], pose_ids: set[str]) -> set[str]:
    """Return the poses that names and patterns match; raises SweepPoseUnknown for one that matches no pose."""
    found: set[str] = set()
    for pattern in patterns:
        wild = "*" in pattern or "?" in pattern  # brackets never occur in the name of a pose
        members = {p for p in pose_ids if fnmatchcase(p, pattern)} if wild else {pattern} & pose_ids
        if not members:
            raise SweepPoseUnknown(
                f"No measured pose of the session {'matches' if wild else 'is named'} {pattern}; there are "
                f"{listed(sorted(pose_ids, key=natural))}."
            )
        found |= members
    return found


def _warnings(unusable: set[str]) -> tuple[Advisory, ...]:
    if not unusable:
        return ()
    return (
        Advisory(
            "poses_excluded",
            f"{len(unusable)} poses of the listed sweeps cannot be used and are excluded: "
            f"{listed(sorted(unusable, key=natural))}.",
            "Their measurements failed, or have no joint angles; the list of measurements says which.",
        ),
    )


def solve_with_start(
    solve: Callable[[Chain | None], Identification],
    poses: PoseData,
    nominal: Chain | None,
    sweeps: Sequence[Sweep],
) -> Identification:
    """Solve from the nominal robot; from the sweeps' axes where there is no nominal, or where it is too far off.

    Raises JointNotExcited where there is neither.
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
    try:
        start = _start(poses, None, sweeps)
    except JointNotExcited as failure:
        if np.any(np.ptp(poses.joint_angles, axis=0) < MIN_JOINT_RANGE):
            raise  # a joint at rest is determined from no start
        raise JointNotExcited(
            failure.detail,
            "Give the session its robot, with the maker's Denavit-Hartenberg parameters (PATCH its robot_id): poses of "
            "any kind then suffice. Without one, add a sweep of each such joint, or raise the joint tolerance if the "
            "others should have rested.",
        ) from failure
    return solve(start)


def _start(poses: PoseData, nominal: Chain | None, sweeps: Sequence[Sweep]) -> Chain:
    """Return the chain by the largest sweeps of every joint on each target."""
    largest: dict[tuple[int, int], list[Sweep]] = {}
    for sweep in sweeps:
        largest.setdefault((sweep.joint, sweep.target), []).append(sweep)
    chosen = [s for of_joint in largest.values() for s in of_joint[:STARTING_SWEEPS]]
    return identify_from_axes(poses, nominal, "combined", sweeps=chosen).chain
