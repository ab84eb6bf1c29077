"""Sweeps, recognised from joint angles: sets of poses at which one joint moves and the others are stationary.

A sweep of joint i is a largest set of poses whose other joints agree within the tolerance, each with each. Nothing is
asked of their order: a joint may have several sweeps at different settings of the others, poses and whole cycles may
repeat, and a home pose belongs to the sweeps of all joints. Free poses belong to none.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from core.errors import InvalidArgument, JointAnglesInconsistent, JointNotExcited
from core.kinematics.pose_observations import PoseData

JOINT_TOLERANCE = math.radians(0.02)
LEAST_POSITIONS = 3
"""Fewer different angles of the joint that moves are no sweep: they leave nothing to judge it by."""
_ROUNDING = 1e-12  # rad: angles written in degrees and read again


@dataclass(frozen=True, slots=True)
class Sweep:
    """Poses at which `joint` (counted from 0) alone moves, in the order of its angle, all seen on one target.

    `setting` (j,) are the joints' mean angles, rad; the moving joint's own is of no meaning.
    """

    joint: int
    poses: Int[np.ndarray, " m"]
    angles: Float[np.ndarray, " m"]
    setting: Float[np.ndarray, " j"]
    target: int

    @property
    def arc(self) -> float:
        """Angle between the first and the last pose, rad."""
        return float(self.angles[-1] - self.angles[0])


def find_sweeps(poses: PoseData, *, tolerance: float = JOINT_TOLERANCE) -> tuple[Sweep, ...]:
    """Return all sweeps there are, joint by joint, those with most poses first.

    `tolerance`, rad, is how far the resting joints may differ within a sweep. A sweep that was seen on two targets is
    two.
    """
    if not (math.isfinite(tolerance) and tolerance > 0.0):
        raise InvalidArgument("The joint tolerance must be a positive angle.", "Use .02°, the default.")
    found = []
    for joint in range(poses.joints):
        others = np.column_stack([np.delete(poses.joint_angles, joint, axis=1), poses.targets])
        of_joint = []
        for members in _agreeing(others, tolerance + _ROUNDING):
            if _positions(poses.joint_angles[members, joint], tolerance) >= LEAST_POSITIONS:
                of_joint.append(_sweep(poses, joint, members))
        found += sorted(of_joint, key=lambda sweep: (-len(sweep.poses), int(sweep.poses[0])))
    return tuple(found)


def named_sweeps(
    poses: PoseData, named: Mapping[int, Sequence[Sequence[str]]], *, tolerance: float = JOINT_TOLERANCE
) -> tuple[Sweep, ...]:
    """Return the sweeps that were named: for each joint (counted from 0) one or more lists of pose labels.

    All poses of a label belong to the sweep.

    Raises InvalidArgument for a joint or label that does not exist, JointAnglesInconsistent where another joint moved
    as well, JointNotExcited where the joint itself did not.
    """
    labels = np.array([poses.label(i) for i in range(len(poses))])
    found = []
    for joint, lists in sorted(named.items()):
        if not 0 <= joint < poses.joints:
            raise InvalidArgument(f"There is no joint {joint + 1}: the poses have {poses.joints} joints.")
        for names in lists:
            unknown = sorted(set(names) - set(labels.tolist()))
            if unknown:
                raise InvalidArgument(f"No pose is named {unknown[0]}.", "Name poses by their pose_id.")
            members = np.flatnonzero(np.isin(labels, list(names)))
            _check_named(poses, joint, members, tolerance)
            for target in np.unique(poses.targets[members]):
                found.append(_sweep(poses, joint, members[poses.targets[members] == target]))
    return tuple(found)


def require_sweeps(sweeps: Sequence[Sweep], joints: int) -> None:
    """Raise JointNotExcited, naming them, unless each joint has a sweep."""
    still = sorted(set(range(joints)) - {sweep.joint for sweep in sweeps})
    if still:
        which = ", ".join(str(joint + 1) for joint in still)
        raise JointNotExcited(
            f"No sweep of joint {which} was found: nowhere are there {LEAST_POSITIONS} different angles of it while "
            "the other joints rest.",
            "Add a sweep of each such joint; or raise the joint tolerance if the others should have rested.",
        )


def _sweep(poses: PoseData, joint: int, members: Int[np.ndarray, " m"]) -> Sweep:
    angles = poses.joint_angles[members, joint]
    order = np.argsort(angles, kind="stable")
    return Sweep(
        joint,
        members[order],
        angles[order],
        poses.joint_angles[members].mean(axis=0),
        int(poses.targets[members[0]]),
    )


def _check_named(poses: PoseData, joint: int, members: Int[np.ndarray, " m"], tolerance: float) -> None:
    angles = poses.joint_angles[members]
    moved = np.ptp(angles, axis=0) > tolerance + _ROUNDING
    moved[joint] = False
    if moved.any():
        other = int(np.argmax(moved))
        spread = math.degrees(float(np.ptp(angles[:, other])))
        raise JointAnglesInconsistent(
            f"In a sweep named for joint {joint + 1}, joint {other + 1} moved by {spread:.3g}°.",
            "Name only poses at which the one joint moved, or raise the joint tolerance.",
        )
    if _positions(angles[:, joint], tolerance) < LEAST_POSITIONS:
        raise JointNotExcited(
            f"In a sweep named for joint {joint + 1} it takes fewer than {LEAST_POSITIONS} different angles."
        )


def _positions(angles: Float[np.ndarray, " m"], tolerance: float) -> int:
    """Return how many different angles there are, those nearer than the tolerance taken for one."""
    return 1 + int(np.count_nonzero(np.diff(np.sort(angles)) > tolerance))


def _agreeing(values: Float[np.ndarray, "n c"], tolerance: float) -> Iterator[Int[np.ndarray, " m"]]:
    """Yield sets of rows, at least `LEAST_POSITIONS` of them, that agree with each other in every column.

    Rows on either side of a gap never agree, which leaves few sets that are too wide; these are cut.
    """
    order = np.argsort(values, axis=0, kind="stable")
    gaps = np.diff(np.take_along_axis(values, order, axis=0), axis=0) > tolerance
    ranks = np.concatenate([np.zeros((1, values.shape[1]), dtype=np.intp), np.cumsum(gaps, axis=0)])
    cell = np.empty_like(ranks)
    np.put_along_axis(cell, order, ranks, axis=0)
    by_cell = np.lexsort(cell.T)
    borders = np.flatnonzero(np.any(np.diff(cell[by_cell], axis=0) != 0, axis=1)) + 1
    waiting = [members for members in np.split(by_cell, borders) if len(members) >= LEAST_POSITIONS]
    while waiting:
        members = waiting.pop()
        spread = np.ptp(values[members], axis=0)
        widest = int(np.argmax(spread))
        if spread[widest] <= tolerance:
            yield np.sort(members)
            continue
        waiting += [
            part for part in _cut(values[members, widest], tolerance, members) if len(part) >= LEAST_POSITIONS
        ]


def _cut(
    column: Float[np.ndarray, " m"], tolerance: float, members: Int[np.ndarray, " m"]
) -> list[Int[np.ndarray, " k"]]:
    """Return the largest set of members within the tolerance in a column, and the rest below and above it."""
    order = np.argsort(column, kind="stable")
    ends = np.searchsorted(column[order], column[order] + tolerance, side="right")
    first = int(np.argmax(ends - np.arange(len(column))))
    return np.split(members[order], [first, int(ends[first])])
